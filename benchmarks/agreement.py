"""Whether an accelerator gives the numbers that the CPU gives, in float64 and in float32, with random draws and all.

    JAX_PLATFORMS=cuda,cpu python benchmarks/agreement.py [CASE ...] [--json]

Each case runs on the first device and on the CPU, in both precisions, on the same simulated data. Printed is for each
pair the largest difference of any number of the result, relative to the largest entry of its array (or to .001, if that
is larger), and in which array it is. `highest` is float32 with matrix products in full: an accelerator by itself
shortens their inputs. Particle filters draw differently in float32 and float64, so that these two differ by sampling.
"""

import argparse
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics, models
from jaxest.bench import kalman as bodies
from jaxest.bench import slam
from jaxest.bench.deflection import SENSORS
from jaxest.distributions import bingham
from jaxest.filters import attitude, complementary, kalman, run
from jaxest.io.report import Row, report, to_json
from jaxest.simulate import grasp
from jaxest.systems import deflection, onsite, orientation, posture

STEPS, LEAST = 60, 1e-3
Case = Callable[[], tuple[Callable[..., Any], Any]]


def through(system: Any, steps: int = STEPS) -> tuple[Callable[..., Any], Any]:
    """Run a system on what it simulates."""
    key = jax.random.key(3)
    params = jax.tree.map(partial(np.asarray, dtype=np.float64), system.default_params)
    draw = jax.jit(lambda params: system.simulate(params, key=jax.random.key(1), steps=steps)[0])

    def fn(params: Any, measurements: Any) -> Any:
        return run(system.step, params, system.init(params, key=key), measurements, key=key)

    return fn, (params, draw(params))


def filters(module: Any) -> tuple[Callable[..., Any], Any]:
    """Orientation by a filter."""
    return through(orientation.build(filter=module))


def particles(proposal: Any, count: int) -> tuple[Callable[..., Any], Any]:
    """The arm's deflection."""
    robot = kinematics.load(models.path("arm"))
    fn, args = through(deflection.build(robot, SENSORS, particles=count, proposal=proposal), 10)
    return (lambda *args: fn(*args)[1]), args


def smoother() -> tuple[Callable[..., Any], Any]:
    """An error-state filter and its smoother."""
    noise = bodies.Noise()
    samples = jax.tree.map(lambda x: x[0], bodies.simulated(noise, 1, STEPS, jnp.float64))

    def fn(samples: Any) -> Any:
        start = bodies.beginning(noise, samples.dt.dtype)
        return run(kalman.filter_step(bodies.MODEL), noise, start, samples), kalman.smooth(
            bodies.MODEL, noise, start, samples, iterations=2
        )

    return fn, (samples,)


def mechanics() -> tuple[Callable[..., Any], Any]:
    """Kinematics, dynamics and gradients of an arm."""
    robot = kinematics.load(models.path("baxter_left_arm"))
    q, v, a = np.random.default_rng(0).uniform(-2, 2, (3, 256, robot.nq))

    def one(q: Any, v: Any, a: Any) -> Any:
        tip = len(robot.frame_names) - 1
        slope = jax.grad(lambda q: jnp.sum(jnp.sin(kinematics.forward(robot, q, [tip]).position)))
        forces = kinematics.inverse_dynamics(robot, q, v, a), kinematics.forward_dynamics(robot, q, v, a)
        return (kinematics.forward(robot, q), kinematics.jacobian(robot, q, tip), kinematics.mass_matrix(robot, q),
                *forces, slope(q))  # fmt: skip

    return jax.vmap(one), (q, v, a)


def densities() -> tuple[Callable[..., Any], Any]:
    """Bingham's normaliser and moments, and their gradient."""
    lam = -np.sort(np.random.default_rng(0).exponential(30.0, (256, 4)))
    lam[:, 0] = 0.0

    def one(lam: Any) -> Any:
        return bingham.log_normalizer(lam), bingham.second_moments(lam), jax.grad(bingham.log_normalizer)(lam)

    return jax.vmap(one), (lam,)


def body() -> tuple[Callable[..., Any], Any]:
    """Whole-body SLAM of five links."""
    system, given = slam.problem(5, points=128)
    measurements = jax.tree.map(lambda x: np.asarray(x)[:12], given)
    params = jax.tree.map(partial(np.asarray, dtype=np.float64), system.default_params)

    def fn(params: Any, measurements: Any) -> Any:
        return run(system.step, params, system.init(params), measurements)[1]

    return fn, (params, measurements)


CASES: dict[str, Case] = {
    "mechanics": mechanics,
    "densities": densities,
    "complementary": partial(filters, complementary),
    "ekf": partial(filters, attitude.ekf),
    "decoupled": partial(filters, attitude.decoupled),
    "smoother": smoother,
    "onsite": lambda: through(onsite.build()),
    "posture": lambda: through(posture.build(kinematics.load(models.path("gripper")), grasp.SITES, magnetic=True)),
    "bootstrap": partial(particles, deflection.bootstrap, 2048),
    "guided": partial(particles, deflection.guided, 256),
    "slam": body,
}


def cast(tree: Any, dtype: Any) -> Any:
    """Return the tree with floating leaves of a type."""
    return jax.tree.map(
        lambda x: np.asarray(x, dtype if np.issubdtype(np.asarray(x).dtype, np.floating) else None), tree
    )


def result(fn: Any, args: Any, device: Any, dtype: Any, precision: str | None = None) -> Any:
    """Run a case somewhere and return its numbers."""
    with jax.enable_x64(dtype == np.float64), jax.default_device(device), jax.default_matmul_precision(precision):
        # A lambda each: a compiled program is kept by its function and would ignore the precision.
        return jax.tree.map(np.asarray, jax.jit(lambda *args: fn(*args))(*cast(args, dtype)))


def difference(found: Any, expected: Any) -> tuple[float, str]:
    """Return the largest relative difference, and where."""
    worst, place = 0.0, ""
    pairs = zip(jax.tree_util.tree_leaves_with_path(found), jax.tree.leaves(expected), strict=True)
    for (path, a), b in pairs:
        if not np.issubdtype(a.dtype, np.floating) or not a.size:
            continue
        both = np.isfinite(a) & np.isfinite(b)
        off = np.inf if np.any(np.isfinite(a) != np.isfinite(b)) else 0.0
        if both.any():
            scale = max(LEAST, float(np.abs(b[both]).max()))
            off = max(off, float(np.abs(a[both].astype(float) - b[both]).max()) / scale)
        if off >= worst:
            worst, place = off, jax.tree_util.keystr(path)
    return worst, place


def rows(name: str) -> list[Row]:
    """Run a case everywhere and compare."""
    here, cpu = jax.devices()[0], jax.devices("cpu")[0]
    with jax.enable_x64(True), jax.default_device(cpu):
        fn, args = CASES[name]()
        args = jax.tree.map(np.asarray, args)
    known: dict[str, Any] = {"CPU, float64": result(fn, args, cpu, np.float64)}
    found = []

    def compare(one: str, other: str) -> None:
        off, place = difference(known[one], known[other])
        found.append(Row(name, f"{one} beside {other}, worst in {place}", off, "1"))

    known["float64"] = result(fn, args, here, np.float64)
    compare("float64", "CPU, float64")
    known["CPU, float32"] = result(fn, args, cpu, np.float32)
    compare("CPU, float32", "CPU, float64")
    for precision in (None, "highest"):
        key = "float32" if precision is None else "float32, highest"
        known[key] = result(fn, args, here, np.float32, precision)
        compare(key, "CPU, float64")
        compare(key, "CPU, float32")
    return found


def main(arguments: list[str]) -> int:
    """Run the cases."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", nargs="*", choices=[*CASES, []])
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    every = []
    for name in given.cases or CASES:
        for row in rows(name):
            every.append(row)
            print(f"{row.metric:14s} {row.value:9.2e}  {row.condition}", file=sys.stderr, flush=True)
    if given.json:
        print(to_json(report("agreement", every)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
