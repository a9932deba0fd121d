"""`--method onsite` of a robot of joint modules: every link whose place is not known, and the robot as a file."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.cli.methods import SIZE, Outcome, onsite_config
from jaxest.cli.methods import onsite_poses as poses
from jaxest.cli.methods.onsite_imus import AXES, axes_off, calibrations, recording, single
from jaxest.io import SensorLog, Stream
from jaxest.io.report import Row
from jaxest.types import InputError

FILES = ("robot.xml", "robot.urdf")


def estimate(log: SensorLog, settings: Mapping[str, Any], nan: str) -> Outcome:
    """Estimate the links of a robot whose places the config does not say.

    Args:
        log: the log, in SI units.
        settings: the config's table `[onsite]`, with `modules`.
        nan: `error`, or `missing`.

    Returns:
        Streams of each link, of joint in joint, and the robot's files by the names in `FILES`.

    Raises:
        InputError: as `onsite.estimate`.
    """
    import jax

    from jaxest.filters import run
    from jaxest.kinematics import to_mjcf, to_urdf
    from jaxest.systems import onsite_chain
    from jaxest.systems.onsite_recording import refuse_loose

    described = onsite_config.modules(settings)
    names = [name for ends in described.imus for name in ends]
    known, notes = calibrations(settings, names)
    links: Any = [tuple(recording(log, name, nan, known) for name in ends) for ends in described.imus]
    links, said = _agreed(described.imus, links)
    bias, moving = _biases(described.imus, links)
    time, samples = onsite_chain.samples(links)
    step = float(np.median(np.diff(time)))
    system = onsite_chain.build(described.assembly, half_width=max(2, round(0.08 / step)))
    limits = {"position_limit": float(settings.get("position_limit", 0.005)),
              "rotation_limit": math.radians(float(settings.get("rotation_limit_deg", 0.1)))}  # fmt: skip
    params = system.default_params._replace(bias=bias, **limits)
    axes = dict(zip(AXES, axes_off(settings, names, known, max), strict=True))
    params = params._replace(pair=params.pair._replace(gyroscope_bias=0.3 if moving else 0.003, **axes))
    params, samples = single((params, samples))
    info = jax.tree.map(np.asarray, run(system.step, params, system.init(params), samples)[1])
    final = jax.tree.map(lambda x: x[-1], info)
    for ends, (a, p), left in zip(described.imus, links, final.imus.residual, strict=True):
        # Behind few joints rates lie in a plane, and those of a wrong sign look turned: the forces tell.
        refuse_loose(ends, "forces", a.accelerometer, p.accelerometer, float(left))
    robot = onsite_chain.rebuild(described.assembly, final)
    modules = described.assembly.modules
    joints = [(modules[k + 1].name, modules[k].name) for k in described.assembly.unknown]
    streams, rows = _told(time, joints, info, final)
    refused = [] if info.done.any() else [_open([name for name, _ in joints], final, limits, axes[AXES[0]])]

    def draw(path: Path, title: str) -> None:
        from jaxest.viz import onsite as picture

        curves = {f"{n} in {b}": (info.position[:, k], info.covariance[:, k]) for k, (n, b) in enumerate(joints)}
        picture.draw(path, time, curves, {}, None, title=title)

    texts = dict(zip(FILES, (to_mjcf(robot), to_urdf(robot)), strict=True))
    return Outcome(SensorLog(streams, log.source), rows, notes + said + moving, refused, draw, texts)


def _agreed(names: Sequence[tuple[str, str]], links: Any) -> tuple[Any, list[str]]:
    """Links whose IMUs agree, each on its first IMU's clock, and notes; others are refused."""
    from jaxest.systems.onsite_recording import checked, refuse_loose

    found: list[Any] = []
    notes: list[str] = []
    for ends, (a, p) in zip(names, links, strict=True):
        offset, late, said = checked(a, p, ends)
        if offset:
            refuse_loose(ends, "rates", a.gyroscope, p.gyroscope, offset.residual)
        found.append((a, p._replace(time=p.time - late)))
        notes += said
    return found, notes


def _biases(names: Sequence[tuple[str, str]], links: Any) -> tuple[NDArray[np.float64], list[str]]:
    """Biases of the gyros (links, 2, 3) as they are at rest, rad/s, and which have no rest."""
    from jaxest.calibration import imu_static

    bias, notes = np.zeros((len(links), 2, 3)), []
    for k, ends in enumerate(names):
        for e, name in enumerate(ends):
            try:
                bias[k, e] = imu_static.calibrate(*links[k][e][:3]).gyroscope_bias
            except InputError:
                notes.append(f"{name}: no rest in the recording, its gyro's bias is estimated along")
    return bias, notes


def _told(
    time: NDArray[np.float64], joints: Sequence[tuple[str, str]], info: Any, final: Any
) -> tuple[dict[str, Stream], list[Row]]:
    """Streams and figures of the links, each between a joint and the one before."""
    streams: dict[str, Stream] = {}
    rows = [Row(SIZE[0], "", float(len(time)), "1"), Row(SIZE[1], "", float(time[-1] - time[0]), "s")]
    for k, (name, parent) in enumerate(joints):
        link = f"{name} in {parent}"
        extra = {"of": name, "tangent": "rotation in the next joint, then position in the joint before: rad, m"}
        place, turn, spread = (x[:, k].astype(float) for x in (info.position, info.quaternion, info.covariance))
        streams |= poses.streams(f"{name}/", time, place, turn, spread, parent, extra)
        rows += poses.rows(link, final.position[k], final.quaternion[k], final.covariance[k].astype(float))
        rows.append(Row("95 %, position", link, 1e3 * float(final.spread[k, 1]), "mm"))
        rows.append(Row("95 %, rotation", link, math.degrees(float(final.spread[k, 0])), "deg"))
    if info.done.any():
        rows.append(Row("known to the limits after", "", float(time[int(np.argmax(info.done))] - time[0]), "s"))
    return streams, rows


def _open(names: list[str], final: Any, limits: Mapping[str, float], axes: float) -> str:
    worst = [
        f"{name} to {1e3 * float(s[1]):.1f} mm and {math.degrees(float(s[0])):.2f} deg"
        for name, s in zip(names, final.spread, strict=True)
    ]
    # Turned evenly about all axes, a link's rotation is off about each by the entry's deviation.
    least = 2 * math.sqrt(3) * axes
    advice = "swing more joints, longer or harder"
    if least > limits["rotation_limit"]:
        advice = (
            f"gyros whose axes are off by {100 * axes:.2g} % leave {math.degrees(least):.2f} deg however long they "
            "swing: calibrate them (jaxest.calibration.tumble), or say gyroscope_axes in the config"
        )
    return (
        f"known at 95 % {', '.join(worst)}; expected {1e3 * limits['position_limit']:g} mm and "
        f"{math.degrees(limits['rotation_limit']):g} deg: {advice}"
    )


__all__ = ["FILES", "estimate"]
