"""`--method slam`: whole-body SLAM from encoders and ranging sensors that the config lays out."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxest.cli.methods import Outcome, Request, slam_figures, slam_streams
from jaxest.cli.methods.slam_config import options, schema, sensors, told
from jaxest.cli.methods.slam_imu import driven
from jaxest.io import SensorLog, clouds, to_si
from jaxest.io.clouds import Cloud
from jaxest.types import InputError

MAP = "slam_map.ply"


def files(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the files that are written beside the estimate."""
    del settings
    return (MAP,)


def estimate(log: SensorLog, request: Request) -> Outcome:
    """Estimate where a robot's links are, and the room about it.

    Args:
        log: streams `joints` (n, k) rad, or m of slides, and `ranges` (T, R) m, or those that the config names; NaN or
            values beyond a sensor's limits are zones that say nothing. A free root's odometry may come as `travel` and
            `turn` (T, 3), an IMU on it as `gyroscope` and `accelerometer` (n, 3) at their own times, if `imu` names
            its frame.
        request: the robot, and the config's table `[slam]` with `[slam.rings.NAME]` and `[slam.sensors.NAME]`, whose
            zones stand in `ranges` one after the other, in the config's order.

    Returns:
        Streams `joints` and `slides`, where there are such, each with `_bias` and `_deviation`, and for each body
        `NAME/position` and `NAME/orientation`; of each step `status` and `link_status`, as `systems.slam.Info` has
        them, and `driven` where there is an IMU; the map is a PLY file beside the estimate.

    Raises:
        InputError: no robot, no sensor, streams that do not fit or of which nothing could be used.
    """
    import jax

    from jaxest import kinematics
    from jaxest.filters import run
    from jaxest.sensors.proximity import rays

    if request.robot is None:
        raise InputError("the method 'slam' needs a robot: --robot FILE (MJCF or URDF)")
    settings, log = request.settings, to_si(log)
    robot, placed = kinematics.load(request.robot), sensors(settings)
    imu = settings.get("imu")
    system, params = _system(robot, placed, settings)
    time, given, free = slam_streams.measurements(log, settings, robot, placed, request.nan)
    if imu is not None:
        given = driven(log, settings, given)
    params = jax.tree.map(np.float32, params)
    state, info = run(system.step, params, system.init(params), given)
    drove = None if imu is None else np.asarray(info.driven)
    if imu is not None:
        state, info = state.inner, info.inner._replace(status=info.status)
    info = jax.tree.map(np.asarray, info)
    joints = slam_streams.encoded(robot)
    chart = np.asarray(state.chart.point)[: int(state.chart.used)].astype(float)

    def draw(path: Path, title: str) -> None:
        from jaxest.viz import surroundings

        biases = surroundings.Biases(time, info.bias, info.bias_deviation, ~joints.hinges)
        surroundings.draw(path, chart, info.position[-1], robot.topology.body_parent, biases, title=title)

    stands = ("free" + (", driven by an IMU" if imu else "")) if free else "fixed"
    notes = [f"{len(placed)} sensors, {rays(placed)} zones; the root is {stands}"]
    unused = [name for name in slam_streams.ODOMETRY if imu is not None and name in log.streams]
    notes += [f"not used beside an IMU: {', '.join(unused)}"] if unused else []
    cloud = Cloud(chart, np.asarray(state.chart.total)[: len(chart), 3].astype(float))
    found = SensorLog(slam_figures.streams(time, joints, info, robot, drove), log.source)
    rows = [*slam_figures.rows(time, joints, info, robot, drove), *slam_figures.turns(state.mounts, placed, robot)]
    refused = slam_figures.refused(info, int(given.ranges.valid.sum()))
    return Outcome(found, rows, notes, refused, draw, {MAP: clouds.encoded(cloud, MAP)})


def _system(robot: Any, placed: Any, settings: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return the estimator, with an IMU at a free root where the config names one, and its parameters."""
    from jaxest.systems import slam, slam_inertial

    given, sizes, imu = told(settings), options(settings), settings.get("imu")
    if imu is None:
        system = slam.build(robot, placed, **sizes)
        return system, system.default_params._replace(**given)
    system = slam_inertial.build(robot, placed, imu, **sizes)
    return system, system.default_params._replace(inner=system.default_params.inner._replace(**given))


__all__ = ["estimate", "files", "schema"]
