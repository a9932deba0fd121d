"""`--method deflection`: the posture of a robot that bends, from whatever sensors the config names."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.cli.methods import SIZE, Outcome, Request, deflection_streams
from jaxest.cli.methods.deflection_config import NOISES, PROPOSALS, Described, place, schema, sensors
from jaxest.io import SensorLog, Stream, to_si
from jaxest.io.log import stream, where
from jaxest.io.report import Row
from jaxest.types import OK, InputError, unknown_name

PARTICLES = {"guided": 256, "bootstrap": 2048}
VANISHED = 0.1  # share of steps without a usable particle above which the result must not be used
LOST = 10.0  # effective particles, on average, below which it must not


class Estimated(NamedTuple):
    """What the filter says, NumPy arrays with a leading time axis."""

    mean: NDArray[np.float64]
    """(T, d) rad."""
    covariance: NDArray[np.float64]
    """(T, d, d) rad2."""
    lower: NDArray[np.float64]
    """(T, d) rad."""
    upper: NDArray[np.float64]
    """(T, d) rad."""
    ess: NDArray[np.float64]
    """(T,)."""
    evidence: float
    """Log of the density of all measurements."""
    status: NDArray[np.int32]
    """(T,)."""


def estimate(log: SensorLog, request: Request) -> Outcome:
    """Estimate the effective joint angles of a robot.

    Args:
        log: a log with the streams that the config names.
        request: the robot, and the config's table `[deflection]`.

    Returns:
        Streams `joints`, `joints_covariance`, `joints_lower` and `joints_upper` (95 %), a row for each stamp. Errors,
        if the log carries its own truth (a stream `joints`, or the config's `truth`).

    Raises:
        InputError: no robot, a name that does not exist, readings that cannot be.
    """
    from jaxest import kinematics

    if request.robot is None:
        raise InputError("the method 'deflection' needs a robot: --robot FILE (MJCF or URDF)")
    if request.sensors:
        raise InputError("--sensors: the deflection's sensors are those of the config; leave tables out there")
    settings, log = request.settings, to_si(log)
    described, robot = sensors(settings), kinematics.load(request.robot)
    names = joint_names(robot, settings)
    described = [deflection_streams.on_robot(log, robot, names, one) for one in described]
    steps, measurements, notes = deflection_streams.measurements(log, robot, names, described, request.nan)
    found = _run(robot, names, described, settings, measurements)
    meta = {"kinematics": "effective: a rigid robot with these angles stands as the real one does"}
    written = {
        "joints": Stream(steps.time, found.mean, "rad", names=names, extra=meta),
        "joints_covariance": Stream(steps.time, found.covariance, "rad2", names=names),
        "joints_lower": Stream(steps.time, found.lower, "rad", names=names, extra={"probability": 0.95}),
        "joints_upper": Stream(steps.time, found.upper, "rad", names=names, extra={"probability": 0.95}),
    }
    truth, known = _truth(log, settings, steps.time, names)
    reference = deflection_streams.reference(described, measurements, names)
    rows = _rows(steps.time, names, found, truth, reference, known)

    def draw(path: Path, title: str) -> None:
        from jaxest.viz import joints

        joints.draw(path, steps.time, found.mean, found.lower, found.upper, names=names, reference=reference,
                    truth=truth, title=title)  # fmt: skip

    return Outcome(SensorLog(written, log.source), rows, notes, _refused(found), draw)


def joint_names(robot: Any, settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the joints that are estimated."""
    from jaxest.sensors.joints import chosen

    numbers, _ = chosen(robot, settings.get("joints"))
    return tuple(robot.joint_names[j] for j in numbers)


def _choice(settings: Mapping[str, Any], key: str, choices: Sequence[str]) -> str:
    value = settings.get(key, choices[0])
    if value not in choices:
        raise unknown_name(f"[deflection] {key}", str(value), choices)
    return str(value)


def _number(settings: Mapping[str, Any], key: str, size: int, *, signed: bool = False) -> Any:
    """A number of the config, or one for each joint."""
    value = np.asarray(settings[key])
    good = value.dtype.kind in "if" and value.shape in ((), (size,)) and np.isfinite(value).all()
    if not good or (not signed and (value < 0).any()):
        sign = "" if signed else ", 0 or more"
        raise InputError(f"[deflection] {key}: got {settings[key]}, expected a number{sign}, or one for each joint")
    return value.astype(np.float32)


def system(
    robot: Any, names: tuple[str, ...], described: list[Described], settings: Mapping[str, Any], **options: Any
) -> tuple[Any, Any]:
    """Return the filter that the config describes, and its parameters in float32; `options` go to `build`."""
    import jax

    from jaxest.systems import deflection

    proposal = _choice(settings, "proposal", PROPOSALS)
    count = settings.get("particles", PARTICLES[proposal])
    if count < 1:
        raise InputError(f"[deflection] particles: got {count}, expected at least 1")
    noise = {"von_mises": deflection.von_mises, "gaussian": deflection.gaussian}[_choice(settings, "noise", NOISES)]
    given = {key: _number(settings, key, len(names), signed=key in ("start", "compliance"))
             for key in ("walk", "prior", "start", "compliance") if key in settings}  # fmt: skip
    built = deflection.build(
        robot, [one.sensor for one in described], joints=names, particles=count, noise=noise, sag="compliance" in given,
        proposal={"guided": deflection.guided, "bootstrap": deflection.bootstrap}[proposal], **options,
    )  # fmt: skip
    return built, jax.tree.map(lambda x: np.asarray(x, np.float32), built.default_params._replace(**given))


def _run(
    robot: Any, names: tuple[str, ...], described: list[Described], settings: Mapping[str, Any], measurements: Any
) -> Estimated:
    import jax

    from jaxest.filters import run
    from jaxest.systems import deflection

    built, params = system(robot, names, described, settings)
    key = jax.random.key(settings.get("seed", 0))
    _, history = run(built.step, params, built.init(params, key=key), measurements, key=key,
                     history=deflection.with_interval)  # fmt: skip
    info = history.info
    mean, covariance, ess, evidence = (
        np.asarray(x, np.float64) for x in (info.mean, info.covariance, info.ess, info.log_likelihood)
    )
    lower, upper = mean + np.asarray(history.lower), mean + np.asarray(history.upper)
    return Estimated(mean, covariance, lower, upper, ess, float(evidence.sum()), np.asarray(info.status))


def _truth(
    log: SensorLog, settings: Mapping[str, Any], time: NDArray[np.float64], names: tuple[str, ...]
) -> tuple[NDArray[np.float64] | None, str]:
    """The log's own angles (T, d) at the estimate's times, NaN where unknown, and their stream."""
    name = settings.get("truth", "joints")
    if "truth" not in settings and name not in log.streams:
        return None, ""
    item = stream(log, name)
    columns = deflection_streams.columns(item, f"{where(log)}stream {name!r}", names)
    value = np.full((len(time), len(names)), np.nan)
    for at, column in columns.items():
        angles = np.unwrap(np.asarray(item.value, np.float64).reshape(len(item.time), -1)[:, column])
        value[:, at] = np.interp(time, item.time, angles, left=np.nan, right=np.nan)
    return value, name


def _rows(
    time: NDArray[np.float64], names: tuple[str, ...], found: Estimated, truth: Any, reference: Any, known: str
) -> list[Row]:
    rows = [Row(SIZE[0], "", float(len(time)), "1"), Row(SIZE[1], "", float(time[-1] - time[0]), "s")]
    half = np.rad2deg(found.upper - found.lower) / 2
    rows += [Row("half 95 % interval", name, float(np.nanmean(half[:, j])), "deg", n=len(time))
             for j, name in enumerate(names)]  # fmt: skip
    for what, other in (("from the reading, RMS", reference), (f"error to {known}, RMS", truth)):
        if other is None:
            continue
        away = _wrapped(found.mean - other)
        for j, name in enumerate(names):
            there = np.isfinite(away[:, j])
            if there.any():
                size = float(np.rad2deg(np.sqrt(np.mean(away[there, j] ** 2))))
                rows.append(Row(what, name, size, "deg", n=int(there.sum())))
    if truth is not None:
        away = _wrapped(truth - found.mean)
        inside = (away >= found.lower - found.mean) & (away <= found.upper - found.mean)
        there = np.isfinite(away)
        if there.any():
            rows.append(Row("truth inside 95 % interval", "all joints", 100 * float(inside[there].mean()), "%"))
    rows.append(Row("effective sample size", "mean", float(found.ess.mean()), "1"))
    rows.append(Row("log-evidence", "", found.evidence, "1"))
    return rows


def _wrapped(x: NDArray[np.float64]) -> NDArray[np.float64]:
    return (x + np.pi) % (2 * np.pi) - np.pi


def _refused(found: Estimated) -> list[str]:
    reasons = []
    if not np.isfinite(found.mean).all() or not np.isfinite(found.covariance).all():
        reasons.append("the estimate is not finite")
    bad = float(np.mean(found.status != OK))
    if bad > VANISHED:
        reasons.append(f"no particle fits in {100 * bad:.0f} % of the steps: the sensors contradict each other")
    elif found.ess.mean() < LOST:
        reasons.append(
            f"{found.ess.mean():.1f} effective particles on average, fewer than {LOST:g}; take more, or guided ones"
        )
    return reasons


__all__ = ["estimate", "place", "schema"]
