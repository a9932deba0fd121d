"""Noise and forgetting of the estimators from logs that are drawn with known values: parts of `tuning.py`.

Each value stands beside the one that logs were drawn with, or is said to be unidentified.
"""

import sys
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics, models, tuning
from jaxest.filters import run
from jaxest.io.report import Row
from jaxest.sensors.proximity import ring
from jaxest.systems import onsite as pairs
from jaxest.systems import onsite_batch, onsite_drift, slam_chain, torque_evidence, torque_model, torque_settings
from jaxest.systems import slam as whole
from jaxest.systems._slam_body import body
from jaxest.systems._slam_simulation import ROOM, simulate

CHAIN = """<mujoco><worldbody><body name="root"><geom size=".03"/><body name="a" pos=".4 0 0"><joint name="ja"
axis="0 0 1"/><geom size=".03"/><body name="b" pos=".4 0 0"><joint name="jb" axis="0 1 0"/><geom size=".03"/></body>
</body></body></worldbody></mujoco>"""
NOISES = 0.01, 0.02, 0.04  # shares of a range
STEPS, SETTLED = 25, 5
ENCODER = 0.005
VARIANCES = np.linspace(np.log(2e-5), np.log(2e-2), 13)
AWAY = np.linspace(-2.5, 2.5, 21)  # logarithms, about the last best


def say(text: str) -> None:
    """Tell on standard error what is being done."""
    print(text, file=sys.stderr, flush=True)


def found_again(
    name: str, objective: tuning.Objective, start: Any, free: Any, recordings: list[Any], true: Any, scale: Any = float
) -> list[Row]:
    """Tune on recordings, and put each value beside the one that they were drawn with."""
    space = tuning.space(start, free)
    problem, batch = tuning.Problem(objective, space), tuning.padded(recordings)
    say(f"{name}: tuning on {len(recordings)} logs")
    point = space.pack(start, jnp.float64)[None]
    found = tuning.minimise(problem, batch, starts=point, evaluations=120)
    rows = []
    leaves = dict(zip(space.paths, jax.tree.leaves(true), strict=True))
    expected = np.concatenate([np.reshape(leaves[one.paths[0]], -1) for one in space.free])
    estimated = tuning.estimates(problem, found.point, tuning.curvature(problem, found.point, batch))
    for row, value in zip(estimated, expected, strict=True):
        told = f"off by {(row.value - value) / row.sd:+.2f} sd" if row.identified else "unidentified, and said so"
        sd = row.sd if np.isfinite(row.sd) else None
        label = f"{name}, from {row.start:.3g}; {told}"
        rows.append(Row(row.name, label, row.value, "1", sd, len(recordings), float(value), "drawn with"))
    return rows


def torque(logs: int, seed: int) -> list[Row]:
    """The noise of a seven-joint arm, each joint's own, from the paper's series of a second."""
    with jax.enable_x64(True):
        robot, model = kinematics.load(models.path("baxter_left_arm")), torque_model.constant(7)
        drawn = []
        for k in range(logs):
            scene = torque_settings.scene(robot, torque_settings.SETTINGS["reachable"], key=jax.random.key(seed + k))
            drawn.append(tuning.recording(torque_evidence.linearized(model, robot, scene.prior, scene.data)))
        sd = np.full(7, np.sqrt(torque_settings.VARIANCE))
        true = torque_evidence.Noise(sd, sd, np.zeros(0), sd)
        start = torque_evidence.Noise(3 * sd, 3 * sd, np.zeros(0), sd / 3)
        objective = tuning.density(partial(torque_evidence.log_evidence, model, scene.prior))
        free = ["position_noise", "velocity_noise", "sensor_noise"]
        return found_again("arm of 7 joints, 100 steps", objective, start, free, drawn, true)


def onsite(logs: int, seed: int) -> list[Row]:
    """Noise and forgetting of a link that drifts, of one that does not, and the window of the live estimate."""
    with jax.enable_x64(True):
        params = jax.tree.map(jnp.float64, onsite_drift.Params())
        system = onsite_drift.build(half_width=7)
        shake = jax.jit(partial(pairs.simulate, params, steps=4000, bias=0.02))
        cut = jax.jit(lambda pair: onsite_drift.rows(pair, onsite_batch.solve(pair, half_width=7), half_width=7))
        shaken = [shake(key=key) for key in jax.random.split(jax.random.key(seed), logs)]
        seen = [cut(pair) for pair, _ in shaken]
        draw = jax.jit(lambda params, key, rows: system.simulate(params, key=key, rows=rows)[0])
        drifting = params._replace(force_noise=0.08, forgetting_rotation=0.999, forgetting_position=0.997)
        rigid = drifting._replace(forgetting_rotation=1.0, forgetting_position=1.0)
        objective, rows = tuning.likelihood(system), []
        for name, true in (("link that drifts", drifting), ("rigid link", rigid)):
            keys = jax.random.split(jax.random.key(seed + 1), logs)
            given = [jax.tree.map(np.asarray, draw(true, key, one)) for key, one in zip(keys, seen, strict=True)]
            free = ["gyroscope_noise", "force_noise", "forgetting_rotation", "forgetting_position"]
            recorded = [tuning.recording(one) for one in given]
            rows += found_again(f"{name}, 40 s", objective, params, free, recorded, true)
        return rows + _windows(shaken)


def _windows(shaken: list[Any]) -> list[Row]:
    """The position's error by the window, and the window that its formal variance takes."""
    every = [onsite_batch.choose(pair) for pair, _ in shaken]
    tried = onsite_batch.half_widths(shaken[0][0].dt)
    away = np.array([
        1e3 * np.linalg.norm(np.asarray(one.all.position) - np.asarray(truth.position), axis=1)
        for one, (_, truth) in zip(every, shaken, strict=True)
    ])  # fmt: skip
    formal = np.array([1e3 * np.sqrt(np.asarray(one.all.formal)) for one in every])
    taken = [tried.index(int(one.half_width)) for one in every]
    rows = []
    for k, half_width in enumerate(tried):
        label = f"window of {2 * half_width + 1} samples, taken in {taken.count(k)} logs"
        rows.append(Row("position error", label, float(away[:, k].mean()), "mm", _error(away[:, k]), len(away),
                        float(formal[:, k].mean()), "formal deviation"))  # fmt: skip
    chosen = away[np.arange(len(away)), taken]
    rows.append(Row("position error", "window by its formal variance", float(chosen.mean()), "mm", _error(chosen),
                    len(away), float(away.mean(axis=0).min()), "best window in hindsight"))  # fmt: skip
    return rows


def _error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def slam(logs: int, seed: int) -> list[Row]:
    """R and Q of the paper's filter.

    Which points count, and beside which plane, changes with the noise: the likelihood jumps, and its maximum says
    nothing. Its slope with the correspondences that a run finds held fixed (what differentiation gives: a match has no
    slope) does not jump: R is where the slope vanishes. The others' profiles are taken at that R; a parabola through
    the mean profile gives value and standard error.
    """
    robot = kinematics.load(CHAIN)
    sensors = [s for frame in ("root", "a", "b") for s in ring(frame, 0.1, rows=3, columns=3)]
    system = slam_chain.build(robot, sensors, points=72, capacity=1500)

    def score(params: Any, measurements: Any) -> tuple[Any, Any]:
        _, (density, count) = run(
            system.step, params, system.init(params), measurements,
            history=lambda _, info: (jnp.sum(info.log_likelihood), jnp.sum(info.inliers)),
        )  # fmt: skip
        return -jnp.sum(density[SETTLED:]), jnp.sum(count[SETTLED:]).astype(density.dtype)

    def slope(params: Any, log: Any, one: Any) -> Any:
        at = lambda log: score(params._replace(variance=jnp.exp(log)), one)  # noqa: E731
        (_, count), (rise, _) = jax.jvp(at, (log,), (jnp.ones_like(log),))
        return rise / count

    each = jax.jit(lambda params, many: jax.lax.map(lambda one: jnp.divide(*score(params, one)), many))
    slopes = jax.jit(lambda params, log, many: jax.lax.map(partial(slope, params, log), many))
    shape, rows = body(robot, sensors), []
    for noise in NOISES:
        many, spread = _scanned(shape, noise, logs, seed)
        params = jax.tree.map(jnp.float32, system.default_params)._replace(encoder=jnp.float32(ENCODER))
        say(f"slam, noise {noise}: variance")
        table = np.array([np.asarray(slopes(params, jnp.float32(log), many)) for log in VARIANCES])
        at, sd = crossing(VARIANCES, table)
        params = params._replace(variance=jnp.float32(np.exp(at)))
        label = f"readings off by {100 * noise:g} %"
        rows.append(Row("variance", label, float(np.exp(at)), "m2", float(sd * np.exp(at)), logs, spread,
                        "mean square distance of points to the true planes"))  # fmt: skip
        for name, drawn in (("encoder", ENCODER), ("bias_walk", 0.0)):
            say(f"slam, noise {noise}: {name}")
            middle = getattr(params, name)
            table = np.array([
                np.asarray(each(params._replace(**{name: middle * np.float32(np.exp(d))}), many)) for d in AWAY
            ])  # fmt: skip
            at, sd = minimum(table)
            sure = sd < tuning.report.LOOSE and abs(at) < AWAY[-1]
            value = float(middle * np.exp(at)) if sure else float(middle)
            told = "" if sure else ", unidentified"
            label = f"readings off by {100 * noise:g} %{told}"
            rows.append(Row(name, label, value, "1", sd * value if sure else None, logs, drawn, "drawn with"))
    return rows


def _scanned(shape: Any, noise: float, logs: int, seed: int) -> tuple[Any, float]:
    """Logs, and the mean square distance (m2) of their points, in the true pose, to the planes that were hit."""

    def draw(noise: float) -> Any:
        given = jax.tree.map(jnp.float32, whole.Params(noise=noise, encoder=ENCODER))
        one = jax.jit(partial(simulate, shape, whole.Fixed, given, steps=STEPS))
        return jax.lax.map(lambda key: one(key=key), jax.random.split(jax.random.key(seed), logs))

    (many, truth), (exact, _) = draw(noise), draw(0.0)
    origin, direction = (np.asarray(x).reshape(-1, 3) for x in (shape.rays.origin, shape.rays.direction))
    scanned, zone = np.array(shape.scanned), np.argsort(shape.rays.index.reshape(-1), kind="stable")[: shape.readings]
    owner = np.repeat(np.arange(len(scanned)), shape.rays.index.shape[1])
    turn, place = (np.asarray(x)[:, :, scanned][:, :, owner] for x in (truth.rotation, truth.position))
    ray = np.einsum("ltnij,nj->ltni", turn, direction)[:, :, zone]
    from_ = (place + np.einsum("ltnij,nj->ltni", turn, origin))[:, :, zone]
    reach = np.asarray(exact.ranges.value)
    hit = from_ + ray * reach[..., None]
    centers, halves = np.array(ROOM.centers), np.array(ROOM.halves)
    faces = np.concatenate([[ROOM.lower], [ROOM.upper], centers - halves, centers + halves])
    axis = np.abs(hit[..., None, :] - faces).min(axis=-2).argmin(axis=-1)
    slant = np.take_along_axis(ray, axis[..., None], axis=-1)[..., 0]
    off = (np.asarray(many.ranges.value) - reach) * slant
    return many, float(np.mean(off[np.asarray(many.ranges.valid)] ** 2))


def crossing(at: np.ndarray, slopes: np.ndarray) -> tuple[float, float]:
    """Where the mean of slopes (K, logs) at K places turns positive for good, and its standard error over the logs."""
    mean = slopes.mean(axis=1)
    rising = np.flatnonzero((mean[:-1] < 0) & (mean[1:] >= 0))
    if not rising.size or mean[-1] < 0:
        raise ValueError(f"slopes: from {mean[0]:.3g} to {mean[-1]:.3g}, expected a change of sign between")
    k = int(rising[-1])
    share = mean[k] / (mean[k] - mean[k + 1])
    error = _error(slopes[k] + share * (slopes[k + 1] - slopes[k]))
    return float(at[k] + share * (at[k + 1] - at[k])), float(error * (at[k + 1] - at[k]) / (mean[k + 1] - mean[k]))


def minimum(table: np.ndarray) -> tuple[float, float]:
    """Where the mean of profiles (K, logs) is lowest, and its standard error.

    A parabola through the points about the lowest. The error is that of the fit, whose residuals are the jumps, and
    that of leaving each log out; infinite where a parabola does not bend upwards.
    """

    def lowest(profile: np.ndarray) -> tuple[float, float]:
        first = min(max(int(np.argmin(profile)) - 4, 0), len(AWAY) - 9)
        some = slice(first, first + 9)
        (bend, slope, _), spread = np.polyfit(AWAY[some], profile[some], 2, cov=True)
        if bend <= 0:
            return 0.0, np.inf
        by = np.array([slope / (2 * bend**2), -1 / (2 * bend), 0])
        return float(-slope / (2 * bend)), float(by @ spread @ by)

    count = table.shape[1]
    left = np.array([lowest(np.delete(table, k, axis=1).mean(axis=1)) for k in range(count)])
    at, variance = lowest(table.mean(axis=1))
    if not np.isfinite(left).all():
        return 0.0, np.inf
    return at, float(np.sqrt(variance + (count - 1) * np.var(left[:, 0])))
