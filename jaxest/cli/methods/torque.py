"""`--method torque`: unknown joint torques from measured joint angles, and the noise with them.

By default the torque walks at random and the collapsed sampler draws it with all variances; `torque = "constant"` is
the paper's problem, by particle Gibbs. With `feedforward` the known torque acts too, and what is estimated is the rest:
friction, payload, contact.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.cli.methods import SIZE, Outcome, Request, torque_series
from jaxest.cli.methods.torque_series import Series
from jaxest.io import SensorLog, Stream, to_si
from jaxest.io.report import Row
from jaxest.types import InputError, unknown_name

TORQUES = ("walk", "constant")
SAMPLERS = ("gibbs", "mh", "collapsed")
CHAINS = 4
PIECE = 100  # iterations between two checkpoints
LEAST = 8  # iterations whose chains can still be split
NOISES = {"sensor_noise": None, "position_noise": 1e-5, "velocity_noise": 1e-2, "torque_noise": 0.1}
"""Standard deviations a step that the priors are centred on, of all joints or one for each; the sensor's is read off
the angles."""


class Problem(NamedTuple):
    """What is sought, from what."""

    model: Any
    """Of `systems.torque_model`."""
    prior: Any
    data: Any


class Drawn(NamedTuple):
    """Draws of the torque at each row."""

    mean: NDArray[np.float64]
    """(T, n) N m"""
    lower: NDArray[np.float64]
    """(T, n), 2.5 %"""
    upper: NDArray[np.float64]
    """(T, n), 97.5 %"""
    posterior: Any
    """`systems.torque_posterior.Posterior`."""
    loose: list[bool]
    """Of each variance, whether the data leave it to its prior."""


def schema() -> Mapping[str, Any]:
    """Return the keys of `[torque]`."""
    number = (int, float)
    return {
        "angles": str, "feedforward": str, "compare": str, "torque": str, "sampler": str, "segments": int, "every": int,
        "iterations": int, "seed": int, "passive": bool, "rest": bool, "low": number, "high": number,
        **dict.fromkeys(NOISES, (*number, list)),
    }  # fmt: skip


def estimate(log: SensorLog, request: Request) -> Outcome:
    """Estimate the unknown torques of a robot.

    Args:
        log: a log with joint angles.
        request: the robot, and the config's table `[torque]`.

    Returns:
        Streams `torque`, `torque_lower` and `torque_upper` (95 %), a row for each step; differences to the log's own
        torque, if `compare` names it. Refused where the chains' verdict is that they must not be used.

    Raises:
        InputError: no robot, a stream or a setting that cannot be.
    """
    import jax

    from jaxest import kinematics

    if request.robot is None:
        raise InputError("the method 'torque' needs a robot: --robot FILE (MJCF or URDF)")
    settings, log = request.settings, to_si(log)
    kind = settings.get("torque", TORQUES[0])
    if kind not in TORQUES:
        raise unknown_name("[torque] torque", kind, TORQUES)
    robot = kinematics.load(request.robot)
    names = tuple(robot.joint_names)
    series = torque_series.series(log, settings, names, request.nan)
    with jax.enable_x64(True):
        drawn = _draw(robot, series, request, kind)
    meta = {"probability": 0.95}
    written = {
        "torque": Stream(series.time, drawn.mean, "N m", names=names),
        "torque_lower": Stream(series.time, drawn.lower, "N m", names=names, extra=meta),
        "torque_upper": Stream(series.time, drawn.upper, "N m", names=names, extra=meta),
    }

    def paint(path: Path, title: str) -> None:
        from jaxest.viz import torque

        torque.draw(path, series.time, drawn.mean, drawn.lower, drawn.upper, names=names, logged=series.logged,
                    title=title)  # fmt: skip

    refused = list(drawn.posterior.verdict.reasons)
    return Outcome(SensorLog(written, log.source), _rows(series, names, drawn), series.notes, refused, paint)


def _draw(robot: Any, series: Series, request: Request, kind: str) -> Drawn:
    import jax

    from jaxest.io.chains import sample
    from jaxest.systems import torque_model, torque_posterior, torque_sampler

    settings = request.settings
    n, walks = robot.nv, kind == "walk"
    torque_model.check_robot(robot)
    sampler = settings.get("sampler", "collapsed" if walks else "gibbs")
    if sampler not in SAMPLERS:
        raise unknown_name("[torque] sampler", sampler, SAMPLERS)
    iterations = settings.get("iterations", 400 if walks else 2500)
    if iterations < LEAST:
        raise InputError(f"[torque] iterations: got {iterations}, expected at least {LEAST}")
    model, prior, data = problem(robot, series, settings, kind)
    key = jax.random.key(settings.get("seed", 0))
    request.say("the most probable motion, and warm-up")
    params = torque_sampler.tune(model, robot, prior, data, key=key, iterations=60 if walks else 200)
    start = torque_sampler.start(model, params, data, key=jax.random.fold_in(key, 1), count=CHAINS, spread=0.7)
    kernel = torque_sampler.sampler(sampler, model)
    go = torque_posterior.advance(kernel, params, data, _keep(2 * n))
    _, (history, path) = sample(go, start, iterations, piece=min(PIECE, iterations), folder=request.work,
                                identity=(sampler, kind, settings.get("passive", False), params, data),
                                say=request.say)  # fmt: skip
    found = torque_posterior.collect(model, history, has_path=sampler != "collapsed", labels=tuple(robot.joint_names))
    if walks:
        draws = np.asarray(path)[iterations // 4 :].reshape(-1, len(series.time), n)
    else:
        rows = np.concatenate([[0], np.asarray(data.inputs.segment)])
        draws = found.theta.reshape(-1, settings.get("segments", 1), n)[:, rows]
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    return Drawn(draws.mean(axis=0), low, high, found, torque_posterior.unidentified(prior, found))


def problem(robot: Any, series: Series, settings: Mapping[str, Any], kind: str) -> Problem:
    """Bring a log's series into the form of the samplers; JAX must compute in float64.

    Args:
        robot: the robot.
        series: what is estimated from.
        settings: the config's table `[torque]`.
        kind: one of `TORQUES`.

    Returns:
        Model, prior and data.

    Raises:
        InputError: a setting that cannot be.
    """
    import jax.numpy as jnp

    from jaxest.systems import torque, torque_model
    from jaxest.types import Reading

    segments, passive, walks = settings.get("segments", 1), settings.get("passive", False), kind == "walk"
    model = torque_model.walk(robot.nv, passive) if walks else torque_model.constant(robot.nv, segments, passive)
    steps = np.diff(series.time, prepend=series.time[0])
    angles, valid, known, dt = map(jnp.asarray, (series.angles, series.valid, series.feedforward, steps))
    data = torque.data_of(torque.Measurement(Reading(angles, valid), known, dt), segments)
    return Problem(model, _prior(series, settings, walks, segments), data)


@cache
def _keep(first: int) -> Any:
    """Keep of an iteration what it says of itself, and the torques of the path where they are part of the state."""
    return lambda state, info: (info, state.chain.path[..., first:])


def _prior(series: Series, settings: Mapping[str, Any], walks: bool, segments: int) -> Any:
    """Priors from the config, and from the data where it says nothing."""
    import jax.numpy as jnp

    from jaxest.mcmc.model import Prior

    n = series.angles.shape[1]
    guess = {key: settings.get(key, default) for key, default in NOISES.items()}
    if guess["sensor_noise"] is None:
        bend = np.diff(np.where(series.valid, series.angles, np.nan), 3, axis=0)
        guess["sensor_noise"] = max(float(np.nanmedian(np.abs(bend))) / 3.0, 1e-7)  # sqrt(20) times, 0.67 of it
    for key, value in guess.items():
        try:
            guess[key] = np.broadcast_to(np.asarray(value, float), n)
        except ValueError:
            raise InputError(f"[torque] {key}: got {value}, expected a number, or {n} of them") from None
        if not (guess[key] > 0).all():
            raise InputError(f"[torque] {key}: got {value}, expected a standard deviation above 0")
    blocks = ["position_noise", "velocity_noise", *(["torque_noise"] if walks else []), "sensor_noise"]
    centre = np.concatenate([guess[key] ** 2 for key in blocks])
    first = [np.flatnonzero(series.valid[:, j])[:8] for j in range(n)]
    if any(len(rows) < 2 for rows in first):
        raise InputError("joint angles: a joint has fewer than 2 measurements")
    angle = np.array([series.angles[rows[0], j] for j, rows in enumerate(first)])
    line = [np.polyfit(series.time[rows], series.angles[rows, j], 1)[0] for j, rows in enumerate(first)]
    rest = settings.get("rest", False)
    mean = np.concatenate([angle, np.zeros(n) if rest else line, np.zeros(n if walks else 0)])
    wide = [(3 * guess["sensor_noise"] + 1e-4) ** 2, guess["velocity_noise"] ** 2 if rest else 0.25, 1e4]
    variance = np.concatenate([np.broadcast_to(x, n) for x in wide[: 3 if walks else 2]])
    low, high = settings.get("low", -200.0), settings.get("high", 200.0)
    if not low < high:
        raise InputError(f"[torque] low: {low} is not below high: {high}")
    box = np.ones(0 if walks else n * segments)
    alpha = np.full(len(centre), 2.0)
    return Prior(*map(jnp.asarray, (low * box, high * box, alpha, 3.0 * centre, mean, variance)))


def _rows(series: Series, names: tuple[str, ...], drawn: Drawn) -> list[Row]:
    time, one = series.time, drawn.posterior
    rows = [Row(SIZE[0], "", float(len(time)), "1"), Row(SIZE[1], "", float(time[-1] - time[0]), "s")]
    for j, name in enumerate(names):
        half = float((drawn.upper - drawn.lower)[:, j].mean() / 2)
        rows.append(Row("torque, mean over time", name, float(drawn.mean[:, j].mean()), "N m", half))
        if series.logged is not None:
            away = drawn.mean[:, j] - series.logged[:, j]
            size = float(np.sqrt(np.mean(series.logged[:, j] ** 2)))
            rows.append(Row("from the logged torque, RMS", name, float(np.sqrt(np.mean(away**2))), "N m", n=len(time),
                            reference=size, reference_name="RMS of the logged torque"))  # fmt: skip
    sd = np.sqrt(one.variances.reshape(-1, one.variances.shape[-1]).mean(axis=0))
    called = list(one.summaries)[-len(sd) :]
    rows += [Row("noise", name + (", not identified: its prior" if loose else ""), float(x), "a step")
             for name, x, loose in zip(called, sd, drawn.loose, strict=True)]  # fmt: skip
    every = one.summaries.values()
    rows.append(Row("R-hat, largest", "", max(s.r_hat for s in every), "1"))
    rows.append(Row("bulk effective draws, least", "", min(s.bulk for s in every), "1"))
    return rows


__all__ = ["Problem", "estimate", "problem", "schema"]
