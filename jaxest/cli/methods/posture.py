"""`--method posture`: the joints of a robot, a hand or an arm from IMUs on its links."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.cli.methods import SIZE, Outcome, Request, imu_steps, posture_checks
from jaxest.cli.methods.imu_steps import KINDS
from jaxest.cli.methods.orientation import imus as imus_in
from jaxest.cli.truth import joints
from jaxest.io import SensorLog, Stream, to_si
from jaxest.io.log import stream, where
from jaxest.io.report import Row
from jaxest.metrics import circular_error
from jaxest.types import NON_FINITE, InputError, Reading, unknown_name

FILTERS = {
    "ekf": "jaxest.filters.attitude.ekf",
    "decoupled": "jaxest.filters.attitude.decoupled",
    "complementary": "jaxest.filters.complementary",
}
NUMBERS = ("initial_heading", "memory")
SURE = 0.5
"""Share of a coordinate's variance that must have gone for it to count as observed."""
BROKEN = 0.1
"""Share of steps with readings that are not finite above which the result must not be used."""


class Choice(NamedTuple):
    """What is used."""

    imus: dict[str, str]
    """prefix of each IMU's streams, and the frame it is on"""
    kinds: tuple[str, ...]
    filter: str
    zero: tuple[float, float] | None
    """s from the first sample, when the robot stands in its home posture"""
    numbers: dict[str, float]


def estimate(log: SensorLog, request: Request) -> Outcome:
    """Estimate a robot's joint coordinates.

    Args:
        log: a log with `IMU/gyroscope` and `IMU/accelerometer` for each IMU, perhaps `IMU/magnetometer`.
        request: the robot, and settings: `imus` (a table of prefix = frame; by name if absent), `magnetometer`,
            `filter`, `zero_posture` (two times in s), and the numbers `initial_heading`, `memory`.

    Returns:
        Streams `joints` (hinges) and `joints_covariance`, `NAME/orientation` of each ball or free joint, and
        `imu_heading_deviation`; slides, which IMUs' orientations say nothing of, stay at home. Errors, if the log
        carries its own truth (a stream `joints`).

    Raises:
        InputError: no robot, a name that does not exist, readings that cannot be used.
    """
    from jaxest import kinematics

    if request.robot is None:
        raise InputError("the method 'posture' needs a robot: --robot FILE (MJCF or URDF)")
    robot, log = kinematics.load(request.robot), to_si(log)
    choice = choose(log, robot, request)
    notes = [note for imu in choice.imus for note in posture_checks.check(log, imu, choice.kinds)]
    prefixes = [f"{imu}/" for imu in choice.imus]
    steps = imu_steps.merged(log, prefixes, choice.kinds, request.nan)
    time, notes = steps.time, notes + imu_steps.rateless(steps, prefixes)
    params, system, measurements, said = _prepared(robot, choice, time, _measured(steps, choice))
    info = _run(system, params, measurements)
    columns = _hinges(robot)
    names = tuple(columns)
    q_at, v_at = (np.array([at[i] for at in columns.values()], int) for i in (0, 1))
    mean = np.asarray(info.q, np.float64)[:, q_at]
    covariance = np.asarray(info.covariance, np.float64)[:, v_at[:, None], v_at[None, :]]
    known = np.asarray(info.known, np.float64)
    there = np.asarray(info.valid)
    mean = np.where(there[:, None], mean, np.nan)
    streams = {
        "joints": Stream(time, mean, "rad", names=names),
        "joints_covariance": Stream(time, covariance, "rad2", names=names),
        "imu_heading_deviation": Stream(time, np.asarray(info.heading_deviation, np.float64), "rad",
                                        names=tuple(choice.imus)),
        **_turning(robot, time, np.asarray(info.q, np.float64)),
    }  # fmt: skip
    truth = _truth(log, time, names)
    rows = _rows(time, names, mean, covariance, known[:, v_at], truth)
    notes += _left_out(log, robot, choice)
    unsure = [n for n, k in zip(names, known[-1, v_at], strict=True) if k < SURE]
    notes = [f"used {', '.join(f'{imu} on {frame}' for imu, frame in choice.imus.items())} by {choice.filter}", *said,
             *notes]  # fmt: skip
    if unsure:
        notes.append(f"not observed: {', '.join(unsure)}; they keep their start and half a turn of uncertainty")

    def draw(path: Path, title: str) -> None:
        from jaxest.viz import joints as picture

        band = 1.96 * np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0))
        picture.draw(path, time, mean, mean - band, mean + band, names=names, truth=truth, title=title)

    return Outcome(SensorLog(streams, log.source), rows, notes, _refused(info), draw if names else None)


def schema() -> dict[str, Any]:
    """Return what may be in the config's table `[posture]`, as `jaxest.io.config` takes it."""
    numbers = dict.fromkeys(NUMBERS, float)
    return {"imus": {"*": str}, "magnetometer": bool, "filter": str, "zero_posture": list, **numbers}


def choose(log: SensorLog, robot: Any, request: Request) -> Choice:
    """Settle which IMUs sit where.

    Args:
        log: the log.
        robot: the robot.
        request: settings.

    Returns:
        The choice.

    Raises:
        InputError: a frame, stream or filter does not exist, or no IMU's name is that of a frame.
    """
    settings = request.settings
    given: Mapping[str, str] = settings.get("imus", {})
    if not given:
        found = {imu: _frame_of(imu, robot.frame_names) for imu in imus_in(log)}
        given = {imu: frame for imu, frame in found.items() if frame}
    if not given:
        there = ", ".join(imus_in(log))
        if not there:
            raise InputError(
                f"{where(log)}no IMU has a name before its streams ({', '.join(log.streams)}), as in hand/gyroscope; "
                'put into a config which columns are whose: [columns."hand/gyroscope"]'
            )
        raise InputError(
            f"{where(log)}no IMU has the name of a frame (IMUs: {there}); put into a config:\n[posture.imus]\n"
            + "\n".join(f'{json.dumps(imu)} = "FRAME"' for imu in imus_in(log))
        )
    for imu, frame in given.items():
        if frame not in robot.frame_names:
            raise InputError(f"[posture.imus] {imu}: {unknown_name('frame', frame, robot.frame_names)}")
    kinds = KINDS if settings.get("magnetometer", False) else KINDS[:2]
    for imu in given:
        for kind in kinds:
            stream(log, f"{imu}/{kind}")
    name = settings.get("filter", next(iter(FILTERS)))
    if name not in FILTERS:
        raise unknown_name("[posture] filter", str(name), FILTERS)
    zero = settings.get("zero_posture")
    times = [x for x in zero or () if isinstance(x, int | float) and not isinstance(x, bool)]
    if zero is not None and not (len(times) == len(zero) == 2 and 0 <= times[0] < times[1]):
        raise InputError(f"[posture] zero_posture: got {zero}, expected two times in s, as in [0.0, 1.0]")
    numbers = {key: float(settings[key]) for key in NUMBERS if key in settings}
    for key, number in numbers.items():
        if not 0 < number < np.inf:
            raise InputError(f"[posture] {key}: got {number:g}, expected a finite number above 0")
    return Choice(dict(given), kinds, str(name), None if zero is None else (float(zero[0]), float(zero[1])), numbers)


def _frame_of(imu: str, frames: tuple[str, ...]) -> str:
    return next((name for name in (f"site:{imu}", imu) if name in frames), "")


def _measured(steps: Any, choice: Choice) -> Any:
    """The steps of the IMUs' streams as measurements, leaves (T, number of IMUs, ...)."""
    from jaxest.filters.imu import Imu

    readings: list[Any] = [None] * len(KINDS)
    for at, kind in enumerate(choice.kinds):
        found = [steps.readings[f"{imu}/{kind}"] for imu in choice.imus]
        readings[at] = Reading(*(np.stack(parts, axis=1) for parts in zip(*found, strict=True)))  # type: ignore[arg-type]
    return Imu._make([*readings, steps.dt])


def _prepared(robot: Any, choice: Choice, time: NDArray[np.float64], measurements: Any) -> Any:
    """The system, its parameters, and measurements without the gyro bias that a zero posture shows."""
    import importlib

    from jaxest.calibration.mounting import zero_posture
    from jaxest.kinematics import forward
    from jaxest.systems import posture

    frames = tuple(choice.imus.values())
    system = posture.build(robot, frames, magnetic="magnetometer" in choice.kinds,
                           filter=importlib.import_module(FILTERS[choice.filter]))  # fmt: skip
    params = system.default_params._replace(**choice.numbers)
    if choice.zero is None:
        return params, system, measurements, ["no zero posture: mountings as the robot's file has them"]
    rows = (time - time[0] >= choice.zero[0]) & (time - time[0] <= choice.zero[1])
    gyro, acc = measurements.gyroscope, measurements.accelerometer
    if rows.sum() < 10:
        raise InputError(f"[posture] zero_posture: {int(rows.sum())} samples in {choice.zero}, expected at least 10")
    bias = np.empty_like(gyro.value[0])
    for k, imu in enumerate(choice.imus):
        rate, force = gyro.value[rows & gyro.valid[:, k], k], acc.value[rows & acc.valid[:, k], k]
        if len(rate) < 5 or len(force) < 5:
            raise InputError(f"[posture] zero_posture: {imu} has too few samples in {choice.zero}, expected at least 5")
        if rate.std(axis=0).max() > 0.05 or force.std(axis=0).max() > 0.5:
            raise InputError(
                f"[posture] zero_posture: {imu} moves in {choice.zero} (rates scatter by {rate.std(axis=0).max():.2g} "
                "rad/s), expected a rest"
            )
        bias[k] = rate.mean(axis=0)
    carried = np.asarray(forward(robot, robot.home, frames).quaternion)
    force = [acc.value[rows & acc.valid[:, k], k].mean(axis=0) for k in range(len(frames))]
    mounting = np.stack([zero_posture(f, c) for f, c in zip(force, carried, strict=True)])
    value = np.where(gyro.valid[..., None], gyro.value - bias[None], 0).astype(np.float32)
    params = params._replace(mounting=mounting)
    if "initial_heading" not in choice.numbers:
        params = params._replace(initial_heading=0.03)
    return (
        params,
        system,
        measurements._replace(gyroscope=gyro._replace(value=value)),
        [f"zero posture {choice.zero[0]:g} to {choice.zero[1]:g} s: gyro biases and tilts of the mountings from it"],
    )


def _run(system: Any, params: Any, measurements: Any) -> Any:
    import jax

    from jaxest.filters import run

    params = jax.tree.map(np.float32, params)
    return run(system.step, params, system.init(params), measurements)[1]


def _hinges(robot: Any) -> dict[str, tuple[int, int]]:
    """Names of hinges, and their places in q and v."""
    topology = robot.topology
    parts = zip(topology.joint_names, topology.joint_kind, topology.joint_q, topology.joint_v, strict=True)
    return {name: (q, v) for name, kind, q, v in parts if kind == "hinge"}


def _left_out(log: SensorLog, robot: Any, choice: Choice) -> list[str]:
    """What of the log and the robot takes no part."""
    idle = [name for name in imus_in(log) if name not in choice.imus]
    slides = [n for n, kind in zip(robot.joint_names, robot.topology.joint_kind, strict=True) if kind == "slide"]
    notes = (
        [f"left out: {', '.join(idle)}, no frame of the robot has that name; [posture.imus] says where"] if idle else []
    )
    return [*notes, f"slides stay at home: {', '.join(slides)}"] if slides else notes


def _turning(robot: Any, time: NDArray[np.float64], q: NDArray[np.float64]) -> dict[str, Stream]:
    topology = robot.topology
    found = {}
    for name, kind, at in zip(topology.joint_names, topology.joint_kind, topology.joint_q, strict=True):
        if kind in ("ball", "free"):
            start = at + (3 if kind == "free" else 0)
            found[f"{name}/orientation"] = Stream(time, q[:, start : start + 4], "1", extra={"order": "wxyz"})
    return found


def _truth(log: SensorLog, time: NDArray[np.float64], names: tuple[str, ...]) -> NDArray[np.float64] | None:
    if "joints" not in log.streams:
        return None
    item = log.streams["joints"]
    columns = {k: item.names.index(name) for k, name in enumerate(names) if name in item.names}
    return joints(item, columns, [True] * len(names), time) if columns else None


def _rows(
    time: NDArray[np.float64], names: tuple[str, ...], mean: Any, covariance: Any, known: Any, truth: Any
) -> list[Row]:
    rows = [Row(SIZE[0], "", float(len(time)), "1"), Row(SIZE[1], "", float(time[-1] - time[0]), "s")]
    for k, name in enumerate(names):
        deviation = float(np.rad2deg(np.sqrt(np.mean(np.maximum(covariance[:, k, k], 0)))))
        condition = name if np.median(known[:, k]) >= SURE else f"{name}, not observed"
        rows.append(Row("standard deviation", condition, deviation, "deg", n=len(time)))
        if truth is not None and np.isfinite(truth[:, k]).any():
            error = circular_error(mean[:, k], truth[:, k])
            size = float(np.rad2deg(np.sqrt(np.nanmean(error**2))))
            rows.append(Row("error to joints, RMS", condition, size, "deg", n=int(np.isfinite(error).sum())))
    return rows


def _refused(info: Any) -> list[str]:
    reasons = []
    if not np.asarray(info.valid).any():
        reasons.append("some IMU never had a usable accelerometer sample")
    if not np.isfinite(np.asarray(info.q)).all():
        reasons.append("the estimate is not finite")
    if np.mean(np.asarray(info.status) == NON_FINITE) > BROKEN:
        reasons.append("too many readings are not finite")
    return reasons


__all__ = ["FILTERS", "choose", "estimate", "schema"]
