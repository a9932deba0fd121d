"""How well the deflection filter estimates: the rows that a person would want to see before trusting it.

    python benchmarks/deflection.py [--part arm noise joints intervals] [--seeds 3] [--seed 11] [--json]
        [--robots panda.xml iiwa.xml chain20]

`arm`: the packaged arm, bent, IMUs on links 2 and 3, encoders, and the end effector now and then; `noise`: data drawn
from the model's own densities (Table I). Both give the effective share of the particles and the Monte-Carlo error of
the posterior mean, in posterior deviations, against 100,000 guided particles. `joints`: the given robots, or a chain of
20 joints, with IMUs on every second link, error beside that of encoders alone. `intervals`: how often the 95 % interval
holds the angle over 500 runs drawn from the model. Speed is `jaxest bench deflection`.
"""

import argparse
import sys
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics, models
from jaxest.filters import run
from jaxest.io.report import Row, report, to_json
from jaxest.manifolds import circle
from jaxest.sensors import Sensor
from jaxest.simulate import deflection as bending
from jaxest.systems import deflection

ARM = (
    Sensor("joint_angle", "encoders"),
    Sensor("link_orientation", "imu2", ("site:imu2",)),
    Sensor("link_orientation", "imu3", ("site:imu3",)),
    Sensor("link_position", "tip", ("site:end_effector",)),
)
CHAIN = "chain20"
MANY, KEYS, STEPS, SETTLED = 100_000, 12, 40, 5
KINDS = {"guided": (256, deflection.guided), "bootstrap": (2048, deflection.bootstrap)}


def say(text: str) -> None:
    """Tell on standard error what is being done."""
    print(text, file=sys.stderr, flush=True)


def single(params: Any) -> Any:
    """Return parameters in float32."""
    return jax.tree.map(jnp.float32, params)


def histories(system: Any, measurements: Any, keys: Any) -> Any:
    """Infos of the same measurements under several keys, leaves (keys, T, ...)."""
    params = single(system.default_params)

    def one(key: Any) -> Any:
        return run(system.step, params, system.init(params, key=key), measurements, key=key)[1]

    return jax.jit(lambda keys: jax.lax.map(one, keys))(keys)


def monte_carlo(name: str, draw: Any, seeds: range) -> list[Row]:
    """Effective share and Monte-Carlo error of the means, (seeds) scenes of `draw(key) -> measurements`."""
    robot = kinematics.load(models.path("arm"))
    systems = {k: deflection.build(robot, ARM, particles=n, proposal=p) for k, (n, p) in KINDS.items()}
    exact = deflection.build(robot, ARM, particles=MANY, proposal=deflection.guided)
    shares: dict[str, list[float]] = {k: [] for k in KINDS}
    errors: dict[str, list[float]] = {k: [] for k in KINDS}
    for seed in seeds:
        say(f"{name}: scene {seed}")
        measurements = draw(jax.random.key(seed))
        say("  the reference")
        best = histories(exact, measurements, jax.random.split(jax.random.key(seed + 1000), 1))
        spread = np.sqrt(np.diagonal(np.asarray(best.covariance[0]), axis1=1, axis2=2))
        for kind, system in systems.items():
            say(f"  {kind}")
            found = histories(system, measurements, jax.random.split(jax.random.key(seed + 2000), KEYS))
            off = np.asarray(circle.wrap(found.mean - best.mean)) / spread
            errors[kind].append(float(np.sqrt(np.mean(off[:, SETTLED:] ** 2))))
            shares[kind].append(float(np.mean(np.asarray(found.ess)[:, SETTLED:])) / KINDS[kind][0])
    rows = []
    for kind, (count, _) in KINDS.items():
        for metric, values, unit in (("effective share", shares, "1"), ("Monte-Carlo error", errors, "posterior sd")):
            rows.append(Row(metric, f"{name}, {kind}, N = {count}", float(np.mean(values[kind])), unit,
                            float(np.std(values[kind])), len(seeds)))  # fmt: skip
    return rows


def arm(seeds: range) -> list[Row]:
    """Measure on the bent arm."""
    robot = kinematics.load(models.path("arm"))
    draw = partial(bending.simulate, robot, ARM, duration=STEPS / 20, rate_hz=20.0)
    return monte_carlo("bent arm", jax.jit(lambda key: draw(key=key)[0]), seeds)


def noise(seeds: range) -> list[Row]:
    """Measure on data drawn from the model."""
    system = deflection.build(kinematics.load(models.path("arm")), ARM, particles=2)
    params = single(system.default_params)
    return monte_carlo("model's noise", jax.jit(lambda k: system.simulate(params, key=k, steps=STEPS)[0]), seeds)


def joints(seeds: range, robots: list[str]) -> list[Row]:
    """Measure on arms of many joints, each seed with another motion and other noise."""
    rows = []
    for source in robots:
        robot = kinematics.load(models.chain(20) if source == CHAIN else source)
        name = source.rsplit("/", 1)[-1]
        sensors, hinges = equipped(robot)
        columns = np.array([robot.topology.joint_v[robot.joint_names.index(h)] for h in hinges])
        postures = robot.home + np.random.default_rng(0).normal(size=(200, robot.nq))
        torque = jax.vmap(partial(kinematics.gravity_torque, robot))(jnp.asarray(postures, jnp.float32))[:, columns]
        torque = jnp.max(jnp.abs(torque), axis=0)  # so that no joint bends by more than 0.25 rad or so
        faults = bending.Faults(compliance=jnp.minimum(0.033, 0.25 / jnp.maximum(torque, 1e-3)))
        draw = partial(bending.simulate, robot, sensors, joints=hinges, duration=3.0, rate_hz=20.0, faults=faults)
        draw = jax.jit(lambda key, draw=draw: draw(key=key))
        systems = {
            k: deflection.build(robot, sensors, joints=hinges, particles=n, proposal=p) for k, (n, p) in KINDS.items()
        }
        found: dict[str, list[float]] = {"alone": [], "share": [], "guided": [], "bootstrap": []}
        for seed in seeds:
            say(f"{name}: scene {seed}")
            measurements, truth = draw(jax.random.key(seed))
            blind = measurements._replace(**{
                s.name: getattr(measurements, s.name)._replace(valid=jnp.zeros(len(measurements.dt), bool))
                for s in sensors[1:]
            })  # fmt: skip
            key = jax.random.split(jax.random.key(seed + 3000), 1)
            for what, kind, given in (("alone", "guided", blind), ("guided", "guided", measurements),
                                      ("bootstrap", "bootstrap", measurements)):  # fmt: skip
                info = histories(systems[kind], given, key)
                off = np.asarray(circle.wrap(info.mean[0] - truth.angles))
                found[what].append(float(np.rad2deg(np.sqrt(np.mean(off**2)))))
                if what == "guided":
                    found["share"].append(float(np.mean(info.ess)) / 256)
        ratio = np.array(found["alone"]) / np.array(found["guided"])
        count = len(seeds)
        rows.append(
            Row("effective share", name, float(np.mean(found["share"])), "1", float(np.std(found["share"])), count)
        )
        rows.append(
            Row("error under encoders'", f"{name}, mean", float(ratio.mean()), "times", float(ratio.std()), count)
        )
        rows.append(Row("error under encoders'", f"{name}, worst", float(ratio.min()), "times", None, count))
        for what in ("alone", "guided", "bootstrap"):
            label = "guided, encoders alone" if what == "alone" else what
            rows.append(Row("joints RMSE", f"{name}, {label}", float(np.mean(found[what])), "deg",
                            float(np.std(found[what])), count))  # fmt: skip
    return rows


def equipped(robot: Any) -> tuple[tuple[Sensor, ...], list[str]]:
    """Return encoders and an IMU on every second moving link of the longest arm, and its hinges."""
    names, topology = list(robot.joint_names), robot.topology
    hinges = [names[j] for j, kind in enumerate(topology.joint_kind) if kind == "hinge"]
    bodies = [robot.frame_names[topology.joint_body[names.index(h)]] for h in hinges]
    imus = [Sensor("link_orientation", f"imu{i}", (body,)) for i, body in enumerate(bodies, 1) if i % 2 == 0]
    return (Sensor("joint_angle", "encoders"), *imus), hinges


def intervals(seed: int, runs: int = 500) -> list[Row]:
    """Measure how often intervals hold what they say, after the first steps."""
    system = deflection.build(kinematics.load(models.path("arm")), ARM, particles=256, proposal=KINDS["guided"][1])
    params = single(system.default_params)

    def one(key: Any) -> Any:
        draw, own = jax.random.split(key)
        measurements, truth = system.simulate(params, key=draw, steps=20)
        _, found = run(system.step, params, system.init(params, key=own), measurements, key=own,
                       history=deflection.with_interval)  # fmt: skip
        off = circle.wrap(truth - found.info.mean)
        return (off >= found.lower) & (off <= found.upper)

    say(f"intervals: {runs} runs")
    inside = np.asarray(jax.jit(lambda keys: jax.lax.map(one, keys))(jax.random.split(jax.random.key(seed), runs)))
    each = 100 * inside.mean(axis=(1, 2))
    found = [Row("inside the 95 % interval", "all joints and steps", float(each.mean()), "%",
                 float(each.std() / np.sqrt(runs)), runs)]  # fmt: skip
    for j in range(inside.shape[2]):
        found.append(
            Row("inside the 95 % interval", f"joint {j + 1}", float(100 * inside[:, :, j].mean()), "%", n=runs)
        )
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parts = ["arm", "noise", "joints", "intervals"]
    parser.add_argument("--part", nargs="+", choices=parts, default=parts)
    parser.add_argument("--seeds", type=int, default=3, help="scenes of each sort")
    parser.add_argument("--seed", type=int, default=11, help="the first one's")
    parser.add_argument("--robots", nargs="+", default=[CHAIN], help="MJCF or URDF of arms, or chain20")
    parser.add_argument("--iterations", type=int, default=2, help="Gauss-Newton steps of the guided filter")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    KINDS["guided"] = (256, partial(deflection.guided, iterations=given.iterations))
    seeds, rows = range(given.seed, given.seed + given.seeds), []
    for part in given.part:
        made = {
            "arm": lambda: arm(seeds),
            "noise": lambda: noise(seeds),
            "joints": lambda: joints(seeds, given.robots),
            "intervals": lambda: intervals(given.seed),
        }[part]()
        rows += made
        if not given.json:
            for row in made:
                spread = "" if row.spread is None else f" +- {row.spread:.3g}"
                print(
                    f"{row.metric:28s} {row.condition:40s} {row.value:8.3f}{spread} {row.unit}  n = {row.n}", flush=True
                )
    if given.json:
        print(to_json(report("deflection", rows)))


if __name__ == "__main__":
    main()
