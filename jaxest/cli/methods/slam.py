"""`--method slam`: whole-body SLAM from encoders and ranging sensors that the config lays out."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.cli import truth
from jaxest.cli.methods import SIZE, Outcome, Request
from jaxest.cli.methods.slam_imu import driven
from jaxest.io import SensorLog, Stream, clouds, to_si
from jaxest.io.clouds import Cloud
from jaxest.io.log import refuse_nan, stream, where
from jaxest.io.report import Row
from jaxest.types import InputError, unknown_name

MAP = "slam_map.ply"
LOST = 0.1  # share of steps flagged as lost above which the result must not be used
WORDS = ("joints", "ranges", "travel_stream", "turn_stream", "imu", "gyroscope_stream", "accelerometer_stream")
POSITIVE = ("noise", "gate")  # the other numbers may be 0


def files(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the files that are written beside the estimate."""
    del settings
    return (MAP,)


def numbers() -> tuple[str, ...]:
    """Return the names of all parameters, in the units that `systems.slam.Params` says."""
    from jaxest.systems.slam import Params

    return Params._fields


def schema() -> dict[str, Any]:
    """Return what may be in the config's table `[slam]`, as `jaxest.io.config` takes it."""
    lengths = dict.fromkeys(("along", "radius", "field_deg", "minimum", "maximum"), float)
    ring = {"frame": str, "frames": list, **lengths, **dict.fromkeys(("count", "rows", "columns"), int)}
    one = {"frame": str, "position": list, "directions": list, "minimum": float, "maximum": float}
    return {
        **dict.fromkeys(WORDS, str), **dict.fromkeys(numbers(), float), "voxel": float, "capacity": int, "points": int,
        "align": bool, "rings": {"*": ring}, "sensors": {"*": one},
    }  # fmt: skip


def estimate(log: SensorLog, request: Request) -> Outcome:
    """Estimate where a robot's links are, and the room about it.

    Args:
        log: streams `joints` (T, n) rad and `ranges` (T, R) m, or those that the config names; NaN or values beyond a
            sensor's limits are zones that say nothing. A free root's odometry may come as `travel` and `turn` (T, 3),
            an IMU on it as `gyroscope` and `accelerometer` (n, 3) at their own times, if `imu` names its frame.
        request: the robot, and the config's table `[slam]` with `[slam.rings.NAME]` and `[slam.sensors.NAME]`, whose
            zones stand in `ranges` one after the other, in the config's order.

    Returns:
        Streams `joints`, `joints_bias`, `joints_deviation`, and for each body `NAME/position` and `NAME/orientation`;
        the map is a PLY file beside the estimate.

    Raises:
        InputError: no robot, no sensor, streams that do not fit.
    """
    import jax

    from jaxest import kinematics
    from jaxest.filters import run
    from jaxest.kinematics.robot import SLIDE
    from jaxest.sensors.proximity import rays

    if request.robot is None:
        raise InputError("the method 'slam' needs a robot: --robot FILE (MJCF or URDF)")
    settings, log = request.settings, to_si(log)
    robot, placed = kinematics.load(request.robot), sensors(settings)
    imu = settings.get("imu")
    system, params = _system(robot, placed, settings)
    time, given, free = _measurements(log, settings, robot, rays(placed), request.nan)
    if imu is not None:
        given = driven(log, settings, given)
    params = jax.tree.map(np.float32, params)
    state, info = run(system.step, params, system.init(params), given)
    if imu is not None:
        state, info = state.inner, info.inner
    info = jax.tree.map(np.asarray, info)
    led = {j for j, _ in robot.topology.couplings}
    kinds = enumerate(zip(robot.joint_names, robot.topology.joint_kind, strict=True))
    names = tuple(name for j, (name, kind) in kinds if kind != "free" and j not in led)
    chart = np.asarray(state.chart.point)[: int(state.chart.used)].astype(float)

    def draw(path: Path, title: str) -> None:
        from jaxest.viz import surroundings

        slides = np.array([robot.topology.joint_kind[robot.joint_names.index(name)] == SLIDE for name in names])
        biases = surroundings.Biases(time, info.bias, info.bias_deviation, slides)
        surroundings.draw(path, chart, info.position[-1], robot.topology.body_parent, biases, title=title)

    stands = ("free" + (", driven by an IMU" if imu else "")) if free else "fixed"
    notes = [f"{len(placed)} sensors, {rays(placed)} zones; the root is {stands}"]
    cloud = Cloud(chart, np.asarray(state.chart.total)[: len(chart), 3].astype(float))
    found = SensorLog(_streams(time, names, info, robot), log.source)
    rows = [*_rows(time, names, info, robot), *_turns(state.mounts)]
    return Outcome(found, rows, notes, _refused(info), draw, {MAP: clouds.encoded(cloud, MAP)})


def _system(robot: Any, placed: Any, settings: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return the estimator, with an IMU at a free root where the config names one, and its parameters."""
    from jaxest.mapping import Hashed
    from jaxest.systems import slam, slam_inertial

    told, imu = _told(settings), settings.get("imu")
    options: dict[str, Any] = {
        "layout": Hashed(settings.get("voxel", 0.2)), "capacity": settings.get("capacity", 16384),
        "points": settings.get("points", 128), "align": settings.get("align", False),
    }  # fmt: skip
    if imu is None:
        system = slam.build(robot, placed, **options)
        return system, system.default_params._replace(**told)
    system = slam_inertial.build(robot, placed, imu, **options)
    return system, system.default_params._replace(inner=system.default_params.inner._replace(**told))


def _streams(time: NDArray[Any], names: tuple[str, ...], info: Any, robot: Any) -> dict[str, Stream]:
    """Return what was estimated as streams: joints, and where each body is."""
    streams = {
        "joints": Stream(time, info.joints.astype(float), "rad", names=names),
        "joints_bias": Stream(time, info.bias.astype(float), "rad", names=names),
        "joints_deviation": Stream(time, info.bias_deviation.astype(float), "rad", names=names),
    }
    for k, body in enumerate(robot.topology.body_names):
        streams[f"{body}/position"] = Stream(time, info.position[:, k].astype(float), "m")
        streams[f"{body}/orientation"] = Stream(time, info.quaternion[:, k].astype(float), "1")
    return streams


def _turns(mounts: Any) -> list[Row]:
    """Return how far sensors are found turned from where they are believed to look, where that was asked for."""
    if mounts is None:
        return []
    angle = np.rad2deg(np.linalg.norm(np.asarray(mounts.ring)[:, None] + np.asarray(mounts.turn), axis=2))
    ends = ("mean", float(angle.mean())), ("largest", float(angle.max()))
    return [Row("turn of a sensor", which, value, "deg") for which, value in ends]


def _told(settings: Mapping[str, Any]) -> dict[str, float]:
    """Return the parameters that a config sets; raises InputError for a number that no parameter can be."""
    found = {name: float(settings[name]) for name in numbers() if name in settings}
    for name, value in found.items():
        least = "more than 0" if name in POSITIVE else "at least 0"
        if not np.isfinite(value) or value < 0 or (value == 0 and name in POSITIVE):
            raise InputError(f"[slam] {name}: got {value:g}, expected a finite number, {least}")
    return found


def sensors(settings: Mapping[str, Any]) -> list[Any]:
    """Read the sensors of a config: rings first, then single ones, each in the config's order.

    Raises:
        InputError: there is none, or one has no frame or place.
    """
    from jaxest.sensors.proximity import Proximity, ring

    found: list[Any] = []
    for name, table in settings.get("rings", {}).items():
        frames = table.get("frames", [table["frame"]] if "frame" in table else [])
        if not frames:
            raise InputError(f'[slam.rings.{name}]: has no frame, expected frame = "..." or frames = [...]')
        options = {k: v for k, v in table.items() if k not in ("frame", "frames", "along")}
        for frame in frames:
            found += ring(frame, table.get("along", 0.0), **options)
    for name, table in settings.get("sensors", {}).items():
        missing = [k for k in ("frame", "position", "directions") if k not in table]
        if missing:
            raise InputError(f"[slam.sensors.{name}]: has no {', '.join(missing)}")
        away = np.asarray(table["directions"], float).reshape(-1, 3)
        away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        limits = {k: table[k] for k in ("minimum", "maximum") if k in table}
        found.append(Proximity(table["frame"], np.asarray(table["position"], float), away, **limits))
    if not found:
        raise InputError(
            "[slam] names no sensor; expected a --config with a table for each ring of sensors about links, as in "
            '[slam.rings.arm] frames = ["link1"], or for each sensor, as in [slam.sensors.nose] frame = "hand", '
            "position = [0, 0, 0.1], directions = [[0, 0, 1]]"
        )
    return found


def _measurements(
    log: SensorLog, settings: Mapping[str, Any], robot: Any, zones: int, nan: str
) -> tuple[Any, Any, bool]:
    """Return times (T,), measurements and whether the root is free; one step a row of `ranges`."""
    from jaxest.kinematics.robot import HINGE
    from jaxest.systems import slam
    from jaxest.types import Reading

    ranges = stream(log, settings.get("ranges", "ranges"))
    joints = stream(log, settings.get("joints", "joints"))
    spot = where(log)
    value = np.asarray(ranges.value, float).reshape(len(ranges.time), -1)
    if value.shape[1] != zones:
        raise InputError(f"{spot}stream of ranges has {value.shape[1]} columns, the config's sensors {zones} zones")
    led = {j for j, _ in robot.topology.couplings}
    wanted = [n for j, n in enumerate(robot.joint_names) if robot.topology.joint_kind[j] != "free" and j not in led]
    angles = np.asarray(joints.value, float).reshape(len(joints.time), -1)
    given = list(joints.names) or wanted
    for name in wanted:
        if name not in given:
            raise unknown_name(f"{spot}stream of joints: column", name, given)
    if angles.shape[1] != len(given):
        raise InputError(f"{spot}stream of joints has {angles.shape[1]} columns, expected {len(given)}: {given}")
    columns = [given.index(name) for name in wanted]
    if nan == "error":
        refuse_nan(joints, f"{spot}stream of joints", 'nan = "missing" in a config')
    kinds = [robot.topology.joint_kind[robot.joint_names.index(name)] for name in wanted]
    at = truth.joints(joints, dict(enumerate(columns)), [kind == HINGE for kind in kinds], ranges.time)
    there = np.isfinite(at)
    dt = np.concatenate([[0.0], np.diff(ranges.time)]).astype(np.float32)
    fields: dict[str, Any] = {
        "ranges": Reading(np.nan_to_num(value).astype(np.float32), np.isfinite(value)),
        "joints": Reading(np.where(there, at, 0).astype(np.float32), there),  # type: ignore[arg-type]
        "dt": dt,
    }
    free = robot.topology.joint_kind[:1] == ("free",)
    for name in ("travel", "turn") if free else ():
        known = settings.get(f"{name}_stream", name)
        moved, seen = np.zeros((len(dt), 3), np.float32), np.zeros(len(dt), bool)
        if known in log.streams:
            item = stream(log, known)
            if len(item.time) != len(dt) or not np.allclose(item.time, ranges.time):
                raise InputError(f"{spot}stream {known!r}: expected a row at each of the ranges' {len(dt)} times")
            moved, seen = np.asarray(item.value, np.float32), np.isfinite(item.value).all(axis=1)
            moved = np.nan_to_num(moved)
        fields[name] = Reading(moved, seen)  # type: ignore[arg-type]
    return ranges.time, (slam.Free if free else slam.Fixed)(**fields), free


def _rows(time: NDArray[np.float64], names: tuple[str, ...], info: Any, robot: Any) -> list[Row]:
    from jaxest.systems import slam

    rows = [Row(SIZE[0], "", float(len(time)), "1"), Row(SIZE[1], "", float(time[-1] - time[0]), "s")]
    for j, name in enumerate(names):
        rows.append(Row("bias at the end", name, float(np.rad2deg(info.bias[-1, j])), "deg",
                        float(np.rad2deg(info.bias_deviation[-1, j])), len(time)))  # fmt: skip
    rows.append(
        Row("points that fit the map", "mean", 100 * float(np.mean(info.inliers / np.maximum(info.seen, 1))), "%")
    )
    rows.append(Row("map", "voxels", float(info.voxels[-1]), "1"))
    rows.append(Row("points without room in the map", "", float(info.overflow[-1]), "1"))
    flagged = float(np.mean(info.status == slam.LOST))
    rows.append(Row("steps flagged as lost", "", 100 * flagged, "%"))
    for k, body in enumerate(robot.topology.body_names):
        if np.all(info.link_status[:, k] == slam.UNSEEN):
            rows.append(Row("link without sensors", body, None, "1"))
    return rows


def _refused(info: Any) -> list[str]:
    from jaxest.systems import slam

    reasons = []
    if not np.isfinite(info.position).all():
        reasons.append("the estimate is not finite")
    flagged = float(np.mean(info.status == slam.LOST))
    if flagged > LOST:
        reasons.append(f"points contradict the map in {100 * flagged:.0f} % of the steps")
    return reasons


__all__ = ["estimate", "files", "schema", "sensors"]
