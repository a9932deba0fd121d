"""What `jaxest bench scaling` measures: programs whose size can be chosen, each with its arguments."""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics, mapping, models
from jaxest.bench import kalman as attitude
from jaxest.bench import slam
from jaxest.bench.deflection import SENSORS
from jaxest.bench.harness import find_peer
from jaxest.filters import complementary, kalman, last, run
from jaxest.filters.complementary_sweep import sweep
from jaxest.mapping.layout import grid
from jaxest.simulate import grasp
from jaxest.systems import deflection, onsite, orientation, posture

SAMPLES, RECORDINGS = 100, 20


class Program(NamedTuple):
    """What one call runs."""

    fn: Any
    """Jitted, or a plain callable that compiles on its first call."""
    args: tuple[Any, ...]

    def call(self) -> Any:
        """Run it once, and return what is to be waited for."""
        return self.fn(*self.args)


class Curve(NamedTuple):
    """One study."""

    item: str
    """What is counted."""
    what: str
    """What one call does."""
    sizes: Sequence[int]
    build: Callable[[int], Program]
    peer: str = ""
    """Name of the peer, if there is one."""
    beside: Callable[[int], Callable[[], Any] | None] = lambda size: None


def curves(small: bool, peers: bool) -> list[Curve]:
    """Return the studies, in the order in which they are measured."""
    quads = [4**k for k in range(3, 11)]
    batch = [1, *(4**k for k in range(1, 9))]
    found = [
        Curve("particles", "a bootstrap step of the packaged arm, 4 sensors, float32", quads, _bootstrap),
        Curve("guided particles", "the same step, guided", quads[:-1:2], _guided),
        Curve("configurations", "all frames of a chain of 7 joints, float32", quads, _configurations),
        Curve("joints", "1024 configurations of a serial chain, pose of its tip, float32",
              [4, 7, 12, 20, 35, 60, 100], _joints),
        Curve("settings", f"complementary filter over {RECORDINGS} recordings of {2 * SAMPLES} samples, float32",
              [1, 16, 256, 4096], _settings),
        Curve("robots", "a second at 100 Hz of as many complementary filters, float32", batch, _robots),
        Curve("Kalman filters", f"{SAMPLES} steps of as many error-state filters of 6 states, float32", batch[::2],
              _filters),
        Curve("IMU pairs", f"{SAMPLES} samples of as many pairs of IMUs on a rod, float32", [1, 8, 64, 512, 4096],
              _pairs),
        Curve("grippers", f"{SAMPLES} samples of 7 IMUs each, ekf, float32", [1, 8, 64, 512], _grippers),
        Curve("map points", "5 nearest map points of 1000, float32", quads[1:-1], _points),
        Curve("links", "a live step of whole-body SLAM, 128 points a link, float32", [2, 5, 10, 20], _links),
        Curve("chains", "4 iterations of guided particle Gibbs, Zakeri 2023's series, float64", [1, 8, 64], _chains),
    ]  # fmt: skip
    tree = find_peer("scipy.spatial") if peers else None
    if tree is not None:
        found = [one._replace(peer="SciPy cKDTree, one thread", beside=partial(_tree, tree))
                 if one.build is _points else one for one in found]  # fmt: skip
    if small:  # of those that compile for long, none
        long = (_chains, _links, _guided, _grippers)
        found = [one._replace(sizes=one.sizes[:2]) for one in found if one.build not in long]
    return found


def _live(proposal: Any, size: int) -> Program:
    robot = kinematics.load(models.path("arm"))
    system = deflection.build(robot, SENSORS, particles=size, proposal=proposal)
    params = jax.tree.map(jnp.asarray, system.default_params)
    key = jax.random.key(0)
    measurements = jax.jit(lambda key: system.simulate(params, key=key, steps=2, missing=0.0)[0])(key)
    first, second = (jax.tree.map(lambda x, i=i: x[i], measurements) for i in range(2))
    step = jax.jit(lambda state, measurement: system.step(params, state, measurement, key=key))
    state, _ = step(system.init(params, key=key), first)
    return Program(step, (state, second))


_bootstrap, _guided = partial(_live, deflection.bootstrap), partial(_live, deflection.guided)


def _poses(joints: int, count: int, tip: bool) -> Program:
    robot = kinematics.load(models.chain(joints))
    frames = [len(robot.frame_names) - 1] if tip else None
    q = jnp.asarray(np.random.default_rng(0).uniform(-2, 2, (count, robot.nq)), jnp.float32)
    return Program(jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q, frames))), (q,))


def _configurations(size: int) -> Program:
    return _poses(7, size, tip=False)


def _joints(size: int) -> Program:
    return _poses(size, 1024, tip=True)


def _orientations(size: int, steps: int) -> tuple[Any, Any, Any]:
    system = orientation.build(sensors=("gyroscope", "accelerometer"))
    params = jax.tree.map(jnp.float32, system.default_params)
    one = jax.jit(lambda key: system.simulate(params, key=key, steps=steps, rate_hz=100.0)[0])(jax.random.key(0))
    return system, params, _copies(one, size)


def _settings(size: int) -> Program:
    measurements = _orientations(RECORDINGS, 2 * SAMPLES)[2]
    gains = (np.geomspace(0.05, 5.0, size), np.geomspace(1e-5, 1e-1, size), np.ones(size), np.ones(size))
    return Program(sweep, (complementary.Params(*(jnp.asarray(x, jnp.float32) for x in gains)), measurements))


def _ends(system: Any, params: Any, measurements: Any, leaf: str) -> Program:
    """Run as many filters as there are recordings; a leaf of each one's last info."""

    def end(one: Any) -> Any:
        return getattr(run(system.step, params, system.init(params), one, history=last)[1], leaf)

    return Program(jax.jit(jax.vmap(end)), (measurements,))


def _robots(size: int) -> Program:
    return _ends(*_orientations(size, SAMPLES), "quaternion")


def _filters(size: int) -> Program:
    noise = attitude.Noise()
    measurements = _copies(jax.tree.map(lambda x: x[0], attitude.simulated(noise, 1, SAMPLES)), size)
    start, step = attitude.beginning(noise, jnp.float32), kalman.filter_step(attitude.MODEL)
    ends = jax.jit(jax.vmap(lambda one: run(step, noise, start, one, history=last)[0]))
    return Program(ends, (measurements,))


def _pairs(size: int) -> Program:
    return _simulated(onsite.build(), size, "position")


def _grippers(size: int) -> Program:
    gripper = kinematics.load(models.path("gripper"))
    return _simulated(posture.build(gripper, grasp.SITES, magnetic=True), size, "quaternion")


def _simulated(system: Any, size: int, leaf: str) -> Program:
    params = jax.tree.map(np.float32, system.default_params)
    one = jax.jit(lambda key: system.simulate(params, key=key, steps=SAMPLES)[0])(jax.random.key(0))
    return _ends(system, params, _copies(one, size), leaf)


def _copies(one: Any, size: int) -> Any:
    """One recording as a batch: what it holds does not matter to its time."""
    return jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[None], size, axis=0), one)


def _links(size: int) -> Program:
    system, given = slam.problem(size, points=128)
    params = jax.tree.map(jnp.float32, system.default_params)
    first, measurement = (jax.tree.map(lambda x, i=i: x[i], given) for i in (0, -1))
    step = jax.jit(system.step, donate_argnums=1)
    state, _ = step(params, system.init(params), first)
    return Program(slam.live(step, params, state, measurement), ())


@cache
def _series() -> Any:
    from jaxest.bench import torque

    return torque.problem(small=True)


def _chains(size: int) -> Program:
    from jaxest.systems import torque_posterior, torque_sampler

    with jax.enable_x64(True):
        case = _series()
        starts = torque_sampler.start(case.model, case.params, case.scene.data, key=jax.random.key(1), count=size)
        go = torque_posterior.advance(torque_sampler.sampler("gibbs", case.model), case.params, case.scene.data)

    def call(chains: Any) -> Any:
        with jax.enable_x64(True):
            return go(chains, 4)

    return Program(call, (starts,))


def _cloud(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (size, 3) of the walls of a room whose floor grows with them, a point in each cell, and 1000 queries."""
    rng = np.random.default_rng(0)
    side = 0.1 * np.sqrt(size)
    points = np.concatenate([rng.uniform(0, side, (size, 2)), rng.normal(0, 0.02, (size, 1))], axis=1)
    asked = np.concatenate([rng.uniform(0, side, (1000, 2)), rng.normal(0, 0.05, (1000, 1))], axis=1)
    return points.astype(np.float32), asked.astype(np.float32)


def _points(size: int) -> Program:
    points, asked = _cloud(size)
    margin = np.array([0.5, 0.5, 0.5])
    layout = grid(points.min(axis=0) - margin, points.max(axis=0) + margin, voxel=0.1)
    chart = mapping.insert(layout, mapping.empty(layout, size), jnp.asarray(points), jnp.ones(size, bool))
    return Program(jax.jit(lambda chart, at: mapping.nearest(layout, chart, at, cap=0.2)), (chart, jnp.asarray(asked)))


def _tree(spatial: Any, size: int) -> Callable[[], Any]:
    points, asked = _cloud(size)
    tree = spatial.cKDTree(points)
    return lambda: tree.query(asked, k=5, distance_upper_bound=0.2)


__all__ = ["Curve", "Program", "curves"]
