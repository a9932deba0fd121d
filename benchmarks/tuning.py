"""How well tuning by gradient tunes: against a grid, on held-out recordings, against values that are known.

    python benchmarks/tuning.py [--part grid held-out recovery walk torque onsite slam] [--broad FOLDER] [--logs 10]
        [--seed 3] [--prior 20] [--json]

`grid` and `held-out` need the trials of BROAD as NPZ. `grid`: the complementary filter's two gains by `jaxest.tuning`
from eight starts that lie far apart (on windows first, then from each optimum on the whole), beside a grid of 260
settings, on all trials, and on each half tuned on the other.
`held-out`: the attitude filter (ekf) tuned on half of the trials, judged on the other, both ways. `recovery`: the
deflection filter's concentrations and variances from logs drawn with values that it is not told, from Table I's.
`walk`: Table I's walk on a bent arm, the tuned filter's error on other logs beside Table I's, guided and by the
paper's 2048 bootstrap particles, and what the best walk and sensor noise in hindsight would give. `torque`, `onsite`,
`slam`: see `tuning_systems.py`. The command for one's own logs is `jaxest tune`.
"""

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tuning_systems
from tuning_systems import say

from jaxest import kinematics, models, tuning
from jaxest.bench import broad
from jaxest.filters import attitude, run
from jaxest.filters.resampling import systematic
from jaxest.io.report import Row, report, to_json
from jaxest.manifolds import circle
from jaxest.sensors import Sensor
from jaxest.simulate import deflection as bending
from jaxest.systems import deflection, orientation
from jaxest.types import System

GRID = 20, 13  # proportional and integral gains, 260 settings
STARTS, SPREAD = 8, 1.5
PART = tuning.Windows(20, 5000, 1000)
"""Of the trials, on which starts come together: 17 s of each, of which the filter settles over 3.5."""
ROUGH = tuning.lbfgs(tolerance=3e-3, decrease=1e-6)
AT_ONCE = 13
ARM = (
    Sensor("joint_angle", "encoders"),
    Sensor("link_orientation", "imu2", ("site:imu2",)),
    Sensor("link_orientation", "imu3", ("site:imu3",)),
    Sensor("link_position", "tip", ("site:end_effector",)),
)
FREE = ("walk", "sensors.encoders.concentration", ("sensors.imu2.lam", "sensors.imu3.lam"), "sensors.tip.variance")
TRUE = {"walk": 150.0, "encoders": 40.0, "lam": -300.0, "variance": 0.001}
"""Generating values: a step of 0.08 rad, encoders off by 0.16 rad, IMUs by 0.04, the tip by 0.03 m."""
FILTERS = {"bootstrap": (2048, deflection.bootstrap), "guided": (256, deflection.guided)}
PRIOR = 20.0
"""Of all logs and filters of `recovery`, if not said otherwise: they start near home. Of an unknown start (0.1) the
first readings leave several postures where the encoders are not among them, and 128 particles are few for all of them:
the first steps do not count then. What counts is a likelihood still, of the later readings given the first."""
PARTICLES, SETTLED = 128, 5
FADING = 0.97


def recordings(trials: list[broad.Trial]) -> tuning.Recording:
    """Trials as a batch, with the truth."""
    measurements = broad.padded(trials, 6)
    found = []
    for i, trial in enumerate(trials):
        steps = len(trial.movement)
        rows = jax.tree.map(lambda x, i=i, n=steps: np.asarray(x[i][:n]), measurements)
        found.append(tuning.recording(rows, trial.truth.astype(np.float32), trial.movement))
    return tuning.padded(found)


def degrees(objective: tuning.Objective, params: Any, batch: tuning.Recording) -> np.ndarray:
    """Error of each recording, deg."""
    each = jax.jit(lambda params, batch: tuning.each(objective, params, batch))
    return np.rad2deg(np.asarray(each(params, batch)))


def grid(folder: Path, seed: int) -> list[Row]:
    """Tune the complementary filter, and look the grid over."""
    system = orientation.build(sensors=("gyroscope", "accelerometer"))
    objective = tuning.supervised(system, tuning.errors.inclination)
    start = jax.tree.map(np.float32, system.default_params)
    space = tuning.space(start, {"proportional_gain": None, "integral_gain": None})
    problem = tuning.Problem(objective, space)
    batch = recordings(broad.load(folder))
    points = tuning.disperse(space, STARTS, key=jax.random.key(seed), spread=SPREAD, dtype=np.float32)
    say("tuning on all trials")
    begun = time.perf_counter()
    options = {"windows": PART, "key": jax.random.key(seed + 1), "method": ROUGH, "progress": say}
    optima, rough = tuning.warm_start(problem, batch, points, **options)
    say(f"on windows after {time.perf_counter() - begun:.0f} s: {len(optima)} optima")
    found = tuning.minimise(problem, batch, starts=optima, progress=say)
    took = time.perf_counter() - begun
    say(f"grid of {GRID[0] * GRID[1]}")
    gains = [np.geomspace(lo, hi, n, dtype=np.float32) for lo, hi, n in ((0.05, 5, GRID[0]), (1e-4, 1, GRID[1]))]
    settings = jax.tree.map(lambda x: np.full(GRID[0] * GRID[1], x), start)._replace(
        proportional_gain=np.repeat(gains[0], GRID[1]), integral_gain=np.tile(gains[1], GRID[0])
    )
    some = jax.jit(jax.vmap(lambda params, batch: tuning.each(objective, params, batch), (0, None)))
    errors = np.concatenate([
        np.rad2deg(np.asarray(some(jax.tree.map(lambda x, i=i: x[i : i + AT_ONCE], settings), batch)))
        for i in range(0, GRID[0] * GRID[1], AT_ONCE)
    ])  # fmt: skip
    least = errors.mean(axis=1)
    values, apart = np.rad2deg(found.values), np.rad2deg(rough.values)
    count = errors.shape[1]
    name, where = "inclination RMSE, 6 axes, complementary", f"tuned on all, {STARTS} starts"
    rows = [
        Row(name, where, float(values.min()), "deg", None, count, float(least.min()), "grid of 260 settings"),
        Row("optima that the starts end in", where, float(len(optima)), "1", None, STARTS),
        Row("largest less smallest of the starts", "on windows", float(np.ptp(apart)), "deg", None, STARTS),
        Row("ratio of largest and smallest gain of the starts", "on windows",
            float(np.exp(np.ptp(np.asarray(rough.points)[:, 0]))), "1", None, STARTS),
        Row("run time, compilation included", where, took, "s"),
    ]  # fmt: skip
    halves = [np.arange(i, count, 2) for i in (0, 1)]
    judged, gridded = [], []
    for i, half in enumerate(halves):
        other = halves[1 - i]
        say(f"tuning on half {i}")
        tuned = tuning.minimise(problem, tuning.take(batch, other), starts=optima)
        judged.append(degrees(objective, tuned.params, tuning.take(batch, half)))
        gridded.append(errors[np.argmin(errors[:, other].mean(axis=1)), half])
    held, by_grid = np.concatenate(judged), np.concatenate(gridded)
    rows.append(Row(name, "each half tuned on the other", float(held.mean()), "deg", _error(held - by_grid), count,
                    float(by_grid.mean()), "grid of 260 settings"))  # fmt: skip
    return rows


def held_out(folder: Path, evaluations: int) -> list[Row]:
    """Tune the attitude filter on each half of the trials."""
    system = orientation.build(filter=attitude.ekf, sensors=("gyroscope", "accelerometer"))
    objective = tuning.supervised(system, tuning.errors.inclination, apart=True)
    start = jax.tree.map(np.float32, system.default_params)
    space = tuning.space(start, dict.fromkeys(("misalignment", "speed", "excursion", "move_time")))
    problem = tuning.Problem(objective, space)
    batch = recordings(broad.load(folder))
    count = np.shape(batch.counts)[0]
    halves = [np.arange(i, count, 2) for i in (0, 1)]
    plain = degrees(objective, start, batch)
    tuned = np.zeros(count)
    for i, half in enumerate(halves):
        say(f"tuning on half {1 - i}")
        found = tuning.minimise(problem, tuning.take(batch, halves[1 - i]), evaluations=evaluations, progress=say)
        tuned[half] = degrees(objective, found.params, tuning.take(batch, half))
        say(f"  {dict(zip(space.names, np.asarray(space.values(found.point)).round(4).tolist(), strict=True))}")
    return [Row("inclination RMSE, 6 axes, ekf", "each half tuned on the other", float(tuned.mean()), "deg",
                _error(tuned - plain), count, float(plain.mean()), "its defaults"),
            Row("trials that became better", "each half tuned on the other", float((tuned < plain).sum()), "1", None,
                count)]  # fmt: skip


def _error(differences: np.ndarray) -> float:
    """Standard error of a mean of paired differences."""
    return float(differences.std(ddof=1) / np.sqrt(len(differences)))


def arm(particles: int = PARTICLES) -> System:
    """Return the filter that is tuned: guided, whose score scatters least."""
    return deflection.build(
        kinematics.load(models.path("arm")), ARM, particles=particles,
        proposal=deflection.guided, resample=tuning.fading(systematic, FADING),
    )  # fmt: skip


def single(params: Any) -> Any:
    """Return parameters in float32."""
    return jax.tree.map(jnp.float32, params)


def generating(params: Any, prior: float = PRIOR) -> Any:
    """Return Table I's parameters with `TRUE` in their place."""
    sensors, lam = params.sensors, np.array([0.0, TRUE["lam"], TRUE["lam"], 0.0])
    sensors = sensors._replace(
        encoders=sensors.encoders._replace(concentration=TRUE["encoders"]),
        imu2=sensors.imu2._replace(lam=lam), imu3=sensors.imu3._replace(lam=lam),
        tip=sensors.tip._replace(variance=np.full(3, TRUE["variance"])),
    )  # fmt: skip
    return single(params._replace(walk=TRUE["walk"], prior=prior, sensors=sensors))


def space_of(params: Any) -> tuning.Space:
    """Return what is free: walk, encoders, IMUs together, one variance of the tip."""
    equal = tuning.transforms.equal(tuning.transforms.positive)
    paths = {path if isinstance(path, str) else "+".join(path): None for path in FREE}
    paths["sensors.tip.variance"] = equal
    return tuning.space(params, paths)


def tuned_arm(system: System, start: Any, batch: tuning.Recording, evaluations: int, seed: int) -> Any:
    """Tune from given parameters; return the problem and what was found."""
    space = space_of(single(start))
    problem = tuning.Problem(tuning.likelihood(system, random=True), space)
    rate = lambda step: 0.25 / (1 + step / 15)  # noqa: E731
    found = tuning.minimise(problem, batch, method=tuning.adam(rate), evaluations=evaluations,
                            key=jax.random.key(seed), progress=say)  # fmt: skip
    return problem, found


def recovery(logs: int, seed: int, evaluations: int, prior: float = PRIOR, keys: int = 6) -> list[Row]:
    """Draw logs from the model and find its values again."""
    system = arm()
    true = generating(system.default_params, prior)
    counts = np.arange(100) >= (0 if prior >= 1 else SETTLED)
    draw = jax.jit(lambda key: system.simulate(true, key=key, steps=100))
    drawn = [draw(key)[0] for key in jax.random.split(jax.random.key(seed), logs)]
    batch = tuning.padded([tuning.recording(jax.tree.map(np.asarray, one), counts=counts) for one in drawn])
    problem, found = tuned_arm(system, system.default_params._replace(prior=prior), batch, evaluations, seed + 1)
    say("standard errors")
    curvature = tuning.curvature(problem, found.point, batch, jax.random.split(jax.random.key(seed + 2), keys))
    expected = np.asarray(problem.space.values(problem.space.pack(true, np.float32)))
    rows = []
    for row, value in zip(tuning.estimates(problem, found.point, curvature), expected, strict=True):
        if row.sd == 0:  # a concentration that stays 0
            continue
        off = (row.value - value) / row.sd
        rows.append(Row(row.name, f"{logs} logs of 100 steps, from {row.start:g}; off by {off:+.2f} sd", row.value, "1",
                        row.sd, logs, float(value), "generating value"))  # fmt: skip
    say("other logs")
    others, truths = jax.vmap(draw)(jax.random.split(jax.random.key(seed + 3), logs))
    table = system.default_params._replace(prior=prior)
    return rows + _beside("other logs drawn alike", others, truths, table, found.params, seed)[0]


def _beside(
    label: str, others: Any, truths: Any, table: Any, tuned: Any, seed: int
) -> tuple[list[Row], Any]:  # fmt: skip
    """Errors of tuned filters beside those with Table I's parameters; and the function that finds the guided one's."""
    rows, measured = [], {}
    for name, (count, propose) in {
        "bootstrap": (2048, deflection.bootstrap),
        "guided": (256, deflection.guided),
    }.items():
        kind = deflection.build(kinematics.load(models.path("arm")), ARM, particles=count, proposal=propose)
        measured[name] = jax.jit(partial(_errors, kind, others, truths, seed))
        plain, better = (np.rad2deg(np.asarray(measured[name](single(p)))) for p in (table, tuned))
        logs, what = len(plain), f"{label}, {name} {count}"
        rows += [
            Row("joints RMSE", what, float(better.mean()), "deg", _error(better - plain), logs, float(plain.mean()),
                "Table I"),
            Row("error beside Table I's", what, float(better.mean() / plain.mean()), "1", _error(better / plain), logs),
        ]  # fmt: skip
    return rows, measured["guided"]


def _errors(system: System, others: Any, truths: Any, seed: int, params: Any) -> Any:
    """Root mean square error of each log, rad."""

    def one(both: Any) -> Any:
        measurements, truth = both
        key = jax.random.key(seed + 5)
        _, info = run(system.step, params, system.init(params, key=key), measurements, key=key)
        return jnp.sqrt(jnp.mean(circle.wrap(info.mean - truth)[SETTLED:] ** 2))

    return jax.lax.map(one, (others, truths))


def walk(logs: int, seed: int, evaluations: int) -> list[Row]:
    """Tune on bent arms, and judge on others."""
    system = arm()
    draw = jax.jit(partial(bending.simulate, kinematics.load(models.path("arm")), ARM, duration=5.0, rate_hz=20.0))
    scenes = [draw(key=key) for key in jax.random.split(jax.random.key(seed), 2 * logs)]
    batch = tuning.padded([tuning.recording(jax.tree.map(np.asarray, one)) for one, _ in scenes[:logs]])
    others, truths = (jax.tree.map(lambda *x: jnp.stack(x), *part) for part in zip(*scenes[logs:], strict=True))

    problem, found = tuned_arm(system, system.default_params, batch, evaluations, seed + 1)
    say("other logs")
    label = f"bent arm, {logs} other logs"
    rows, errors = _beside(label, others, truths.angles, system.default_params, found.params, seed)
    say("hindsight")
    best, at = _hindsight(problem, found, errors, evaluations)
    rows.append(Row("joints RMSE", f"{label}, guided, best of {at} settings in hindsight", best, "deg", None, logs,
                    rows[-2].reference, "Table I"))  # fmt: skip
    values = dict(zip(problem.space.names, np.asarray(problem.space.values(found.point)), strict=True))
    return rows + [Row(name, "tuned by likelihood", float(v), "1", None, logs) for name, v in values.items() if v]


def _hindsight(problem: Any, found: Any, errors: Any, count: int) -> tuple[float, int]:
    """Least error, on the judging logs themselves, that a search about the tuned point finds: no setting to use."""
    rng, best, centre = np.random.default_rng(0), np.inf, np.asarray(found.point)
    for i in range(count):
        z = centre + (0 if i == 0 else rng.normal(0, 1.2 if i < count // 2 else 0.4, centre.shape))
        value = float(np.rad2deg(np.asarray(errors(single(problem.space.unpack(jnp.float32(z)))))).mean())
        if value < best:
            best, centre = value, z
    return best, count


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parts = ["grid", "held-out", "recovery", "walk", "torque", "onsite", "slam"]
    parser.add_argument("--part", nargs="+", choices=parts, default=parts)
    parser.add_argument("--broad", type=Path, help="folder with the trials")
    parser.add_argument("--logs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--evaluations", type=int, default=80, help="of the deflection filter's tuning")
    parser.add_argument("--prior", type=float, default=PRIOR, help="concentration about home, of recovery's start")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.broad is None and {"grid", "held-out"} & set(given.part):
        parser.error("--broad FOLDER: the trials of BROAD are needed for grid and held-out")
    rows = []
    for part in given.part:
        made = {
            "grid": lambda: grid(given.broad, given.seed),
            "held-out": lambda: held_out(given.broad, min(given.evaluations, 12)),
            "recovery": lambda: recovery(given.logs, given.seed, given.evaluations, given.prior),
            "walk": lambda: walk(given.logs, given.seed, given.evaluations),
            **{name: partial(getattr(tuning_systems, name), given.logs, given.seed) for name in parts[4:]},
        }[part]()
        rows += made
        for row in made if not given.json else ():
            spread = "" if row.spread is None else f" +- {row.spread:.3g}"
            beside = "" if row.reference is None else f"  ({row.reference_name}: {row.reference:.4g})"
            print(f"{row.metric}: {row.condition}: {row.value:.4g}{spread} {row.unit}{beside}, n = {row.n}", flush=True)
    if given.json:
        print(to_json(report("tuning", rows)))


if __name__ == "__main__":
    main()
