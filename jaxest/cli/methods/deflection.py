"""`--method deflection`: the posture of a robot that bends, from whatever sensors the config names."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.cli.methods import SIZE, Outcome, Request, deflection_joints, deflection_noise, deflection_streams
from jaxest.cli.methods.deflection_config import NOISES, PROPOSALS, Described, place, schema, sensors
from jaxest.cli.methods.deflection_joints import Joints
from jaxest.cli.truth import joints as known_joints
from jaxest.io import SensorLog, to_si
from jaxest.io.log import stream, where
from jaxest.io.report import Row
from jaxest.types import OK, InputError, unknown_name

PARTICLES = {"guided": 256, "bootstrap": 2048}
VANISHED = 0.1  # share of steps without a usable particle above which the result must not be used
LOST = 10.0  # effective particles, on average, below which it must not


class Estimated(NamedTuple):
    """What the filter says, NumPy arrays with a leading time axis."""

    mean: NDArray[np.float64]
    """(T, c) rad and m, of hinges and slides."""
    balls: NDArray[np.float64]
    """(T, b, 4) wxyz."""
    covariance: NDArray[np.float64]
    """(T, d, d) rad2, m2, ..., three coordinates for each ball."""
    lower: NDArray[np.float64]
    """(T, d) lower end of the 95 % interval, from the mean."""
    upper: NDArray[np.float64]
    """(T, d) upper end."""
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
        Streams as `deflection_joints.streams` names them, a row for each stamp. Errors, if the log carries its own
        truth (a stream `joints`, or the config's `truth`).

    Raises:
        InputError: no robot, a name that does not exist, readings that cannot be.
    """
    from jaxest import kinematics

    if request.robot is None:
        raise InputError("the method 'deflection' needs a robot: --robot FILE (MJCF or URDF)")
    settings, log = request.settings, to_si(log)
    described, robot = sensors(settings), kinematics.load(request.robot)
    joints = deflection_joints.chosen(robot, settings)
    described = [deflection_streams.on_robot(log, robot, joints, one) for one in described]
    steps, measurements, notes = deflection_streams.measurements(log, robot, joints, described, request.nan)
    found, scattered = _run(robot, joints, described, settings, measurements)
    truth, known = _truth(log, settings, steps.time, joints)
    reference = deflection_streams.reference(described, measurements, joints)
    rows = _rows(steps.time, joints, found, truth, reference, known)
    more, said = deflection_noise.judged(described, scattered)
    rows, notes = rows + more, notes + said

    def draw(path: Path, title: str) -> None:
        from jaxest.viz import joints as picture

        lower, upper = (found.mean + end[:, : found.mean.shape[1]] for end in (found.lower, found.upper))
        picture.draw(path, steps.time, found.mean, lower, upper, names=joints.numbers, reference=reference,
                     truth=truth, title=title, slides=len(joints.of("slide")))  # fmt: skip

    written = SensorLog(deflection_joints.streams(joints, steps.time, found), log.source)
    return Outcome(written, rows, notes, _refused(found), draw if joints.numbers else None)


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
        raise InputError(
            f"[deflection] {key}: got {settings[key]}, expected a number{sign}, or one for each of {size} coordinates"
        )
    return value.astype(np.float32)


def system(
    robot: Any, joints: Joints, described: list[Described], settings: Mapping[str, Any], **options: Any
) -> tuple[Any, Any]:
    """Return the filter that the config describes, and its parameters in float32; `options` go to `build`."""
    import jax

    from jaxest.systems import deflection

    proposal = _choice(settings, "proposal", PROPOSALS)
    count = settings.get("particles", PARTICLES[proposal])
    if count < 1:
        raise InputError(f"[deflection] particles: got {count}, expected at least 1")
    choice = {"von_mises": deflection.von_mises, "gaussian": deflection.gaussian}
    noise = choice["gaussian" if "filtering" in options else _choice(settings, "noise", NOISES)]
    given = {key: _number(settings, key, joints.size, signed=key in ("start", "compliance"))
             for key in ("walk", "prior", "start", "compliance") if key in settings}  # fmt: skip
    first = len(joints.of("hinge"))
    for key in ("walk", "prior"):
        if (np.broadcast_to(given.get(key, 1.0), joints.size)[first:] == 0).any():
            raise InputError(f"[deflection] {key}: got {settings[key]}, expected more than 0 for slides and balls")
    built = deflection.build(
        robot, [one.sensor for one in described], joints=joints.names, particles=count, noise=noise,
        sag="compliance" in given, proposal={"guided": deflection.guided, "bootstrap": deflection.bootstrap}[proposal],
        **options,
    )  # fmt: skip
    return built, jax.tree.map(lambda x: np.asarray(x, np.float32), built.default_params._replace(**given))


def _run(
    robot: Any, joints: Joints, described: list[Described], settings: Mapping[str, Any], measurements: Any
) -> tuple[Estimated, Any]:
    import jax

    from jaxest.filters import run
    from jaxest.kinematics import space
    from jaxest.systems import deflection, deflection_scatter

    built, params = system(robot, joints, described, settings)
    key = jax.random.key(settings.get("seed", 0))
    _, history = run(built.step, params, built.init(params, key=key), measurements, key=key,
                     history=deflection.with_interval)  # fmt: skip
    info = history.info
    parts = info.mean if isinstance(info.mean, space.Joints) else space.Joints(info.mean)
    numbers = [x for x in (parts.hinge, parts.slide) if x is not None]
    mean = np.concatenate([np.zeros((len(info.ess), 0)), *numbers], axis=1)
    balls = np.zeros((len(mean), 0, 4)) if parts.ball is None else parts.ball
    balls, covariance, lower, upper, ess, evidence = (
        np.asarray(x, np.float64)
        for x in (balls, info.covariance, history.lower, history.upper, info.ess, info.log_likelihood)
    )
    scattered = deflection_scatter.scatter(
        robot, [one.sensor for one in described], params, info.mean, info.covariance, measurements, joints=joints.names,
        sag="compliance" in settings,
    )  # fmt: skip
    found = Estimated(mean, balls, covariance, lower, upper, ess, float(evidence.sum()), np.asarray(info.status))
    return found, scattered


def _truth(
    log: SensorLog, settings: Mapping[str, Any], time: NDArray[np.float64], joints: Joints
) -> tuple[NDArray[np.float64] | None, str]:
    """The log's own angles and ways (T, c) at the estimate's times, NaN where unknown, and their stream."""
    name = settings.get("truth", "joints")
    if "truth" not in settings and name not in log.streams:
        return None, ""
    item = stream(log, name)
    columns = deflection_streams.columns(item, f"{where(log)}stream {name!r}", joints.numbers)
    return known_joints(item, columns, joints.hinges, time), name


def _rows(
    time: NDArray[np.float64], joints: Joints, found: Estimated, truth: Any, reference: Any, known: str
) -> list[Row]:
    rows = [Row(SIZE[0], "", float(len(time)), "1"), Row(SIZE[1], "", float(time[-1] - time[0]), "s")]
    half = (found.upper - found.lower) / 2
    rows += [Row("half 95 % interval", name, scale * float(np.nanmean(half[:, j])), unit, n=len(time))
             for j, (name, unit, scale) in enumerate(joints.coordinates)]  # fmt: skip
    for what, other in (("from the reading, RMS", reference), (f"error to {known}, RMS", truth)):
        if other is None:
            continue
        away = deflection_joints.away(joints, found.mean, other)
        for j, (name, unit, scale) in enumerate(joints.coordinates[: away.shape[1]]):
            there = np.isfinite(away[:, j])
            if there.any():
                size = scale * float(np.sqrt(np.mean(away[there, j] ** 2)))
                rows.append(Row(what, name, size, unit, n=int(there.sum())))
    if truth is not None:
        away = deflection_joints.away(joints, truth, found.mean)
        count = away.shape[1]
        inside = (away >= found.lower[:, :count]) & (away <= found.upper[:, :count])
        there = np.isfinite(away)
        if there.any():
            rows.append(Row("truth inside 95 % interval", "all joints", 100 * float(inside[there].mean()), "%"))
    rows.append(Row("effective sample size", "mean", float(found.ess.mean()), "1"))
    rows.append(Row("log-evidence", "", found.evidence, "1"))
    return rows


def _refused(found: Estimated) -> list[str]:
    reasons = []
    if (
        not np.isfinite(found.mean).all()
        or not np.isfinite(found.balls).all()
        or not np.isfinite(found.covariance).all()
    ):
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
