"""How time grows with size: particles, joints, chains, robots, IMU pairs, map points; with fitted exponents."""

import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics, mapping, models
from jaxest.bench.deflection import SENSORS
from jaxest.bench.harness import Candidate, Progress, find_peer, race
from jaxest.filters import last, run
from jaxest.io.report import Row
from jaxest.mapping.layout import grid
from jaxest.systems import deflection, onsite, orientation

METRIC, EXPONENT = "time against ", "exponent of "


class Curve(NamedTuple):
    """One study."""

    item: str
    """What is counted."""
    what: str
    """What one call does."""
    sizes: Sequence[int]
    build: Callable[[int], Callable[[], Any]]
    """`size -> call`, compiled by its first call."""
    peer: str = ""
    """Name of the peer, if there is one."""
    beside: Callable[[int], Callable[[], Any] | None] = lambda size: None


def curves(small: bool, peers: bool) -> list[Curve]:
    """Return the studies."""
    sizes = {
        "particles": [2**k for k in range(6, 21, 2)],
        "joints": [4, 7, 12, 20, 35, 60, 100],
        "robots": [4**k for k in range(8)],
        "pairs": [1, 8, 64, 512],
        "points": [2**k for k in range(8, 19, 2)],
        "chains": [1, 8, 64],  # last: they compile for a minute
    }
    if small:
        sizes = {name: list(found[:2]) for name, found in sizes.items() if name != "chains"}
    tree = find_peer("scipy.spatial") if peers else None
    table = {
        "particles": ("a bootstrap step of the packaged arm, 4 sensors, float32", _particles),
        "joints": ("1024 configurations of a serial chain, pose of its tip, float32", _joints),
        "robots": ("a second at 100 Hz of as many complementary filters, float32", _robots),
        "chains": ("4 iterations of guided particle Gibbs, Zakeri 2023's series, float64", _chains),
        "pairs": ("100 samples of as many pairs of IMUs on a rod, float32", _pairs),
        "points": ("5 nearest map points of 1000, float32", _points),
    }
    found = []
    for name, counts in sizes.items():
        what, build = table[name]
        curve = Curve(name, what, counts, build)
        if name == "points" and tree is not None:
            curve = curve._replace(peer="SciPy cKDTree, one thread", beside=partial(_tree, tree))
        found.append(curve)
    return found


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time one call at each size, by itself and compiled, and fit the exponent over the larger half of the sizes.

    Args:
        peers: whether to run SciPy's tree beside the map.
        progress: hears what is being measured.
        small: two sizes of each, without chains, which compile for long.

    Yields:
        Times of calls, and exponents with the standard error of the fit: 1 is a time that grows as the size does.
    """
    for curve in curves(small, peers):
        values = []
        for size in curve.sizes:
            progress(f"{size} {curve.item}")
            candidates = [Candidate("ours", curve.build(size))]
            other = curve.beside(size)
            if other is not None:
                candidates.append(Candidate(curve.peer, other))
            begun = time.perf_counter()
            jax.block_until_ready(candidates[0].call())
            repeats = 2 if small or time.perf_counter() - begun > 5 else 5
            found = race(candidates, repeats=repeats)
            ours, beside = found["ours"], found.get(curve.peer)
            values.append(ours.median)
            reference = None if beside is None else 1e6 * beside.median
            ratio = None if beside is None else float(np.median(beside.seconds / ours.seconds))
            yield Row(METRIC + curve.item, f"{size}: {curve.what}", 1e6 * ours.median, "us", 1e6 * ours.spread,
                      repeats, reference, curve.peer or None, ratio)  # fmt: skip
        slope, error = exponent(curve.sizes, values)
        yield Row(EXPONENT + curve.item, f"from {curve.sizes[len(curve.sizes) // 2]} on", slope, "1", error,
                  len(curve.sizes) - len(curve.sizes) // 2)  # fmt: skip


def exponent(sizes: Sequence[int], values: Sequence[float]) -> tuple[float, float | None]:
    """Return the slope of log time by log size over the larger half, and its standard error where it has one."""
    half = len(sizes) // 2 if len(sizes) > 2 else 0
    x, y = np.log(np.asarray(sizes[half:], float)), np.log(np.asarray(values[half:], float))
    x = x - x.mean()
    slope = float(x @ y / (x @ x))
    rest = y - y.mean() - slope * x
    return slope, float(np.sqrt(rest @ rest / (len(x) - 2) / (x @ x))) if len(x) > 2 else None


def draw(path: Path, found: Iterable[Row]) -> None:
    """Draw the curves of these rows and write the picture."""
    from jaxest.viz import scaling

    series: dict[str, list[tuple[int, float]]] = {}
    slopes: dict[str, float] = {}
    for row in found:
        if row.value is not None and row.metric.startswith(METRIC):
            size = int(row.condition.split(":")[0])
            series.setdefault(row.metric.removeprefix(METRIC), []).append((size, row.value))
        elif row.value is not None and row.metric.startswith(EXPONENT):
            slopes[row.metric.removeprefix(EXPONENT)] = row.value
    scaling.draw(path, series, slopes)


def _particles(size: int) -> Callable[[], Any]:
    robot = kinematics.load(models.path("arm"))
    system = deflection.build(robot, SENSORS, particles=size)
    params = jax.tree.map(jnp.asarray, system.default_params)
    key = jax.random.key(0)
    measurements = jax.jit(lambda key: system.simulate(params, key=key, steps=2, missing=0.0)[0])(key)
    first, second = (jax.tree.map(lambda x, i=i: x[i], measurements) for i in range(2))
    step = jax.jit(lambda state, measurement: system.step(params, state, measurement, key=key))
    state, _ = step(system.init(params, key=key), first)
    return lambda: step(state, second)


def _joints(size: int) -> Callable[[], Any]:
    robot = kinematics.load(models.chain(size))
    q = jnp.asarray(np.random.default_rng(0).uniform(-2, 2, (1024, robot.nq)), jnp.float32)
    tip = [len(robot.frame_names) - 1]
    pose = jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q, tip)))
    return lambda: pose(q)


def _robots(size: int) -> Callable[[], Any]:
    system = orientation.build(sensors=("gyroscope", "accelerometer"))
    params = jax.tree.map(jnp.float32, system.default_params)
    one = jax.jit(lambda key: system.simulate(params, key=key, steps=100, rate_hz=100.0)[0])(jax.random.key(0))
    measurements = _copies(one, size)
    every = jax.jit(
        jax.vmap(lambda one: run(system.step, params, system.init(params), one, history=last)[1].quaternion)
    )
    return lambda: every(measurements)


def _pairs(size: int) -> Callable[[], Any]:
    system = onsite.build()
    params = jax.tree.map(np.float32, system.default_params)
    one = jax.jit(lambda key: system.simulate(params, key=key, steps=100)[0])(jax.random.key(0))
    measurements = _copies(one, size)
    every = jax.jit(jax.vmap(lambda one: run(system.step, params, system.init(params), one, history=last)[1].position))
    return lambda: every(measurements)


def _copies(one: Any, size: int) -> Any:
    """One recording as a batch: what it holds does not matter to its time."""
    return jax.tree.map(lambda x: jnp.repeat(x[None], size, axis=0), one)


def _chains(size: int) -> Callable[[], Any]:
    from jaxest.bench import torque
    from jaxest.systems import torque_posterior, torque_sampler

    with jax.enable_x64(True):
        case = torque.problem(small=True)
        starts = torque_sampler.start(case.model, case.params, case.scene.data, key=jax.random.key(1), count=size)
        go = torque_posterior.advance(torque_sampler.sampler("gibbs", case.model), case.params, case.scene.data)

    def call() -> Any:
        with jax.enable_x64(True):
            return go(starts, 4)

    return call


def _cloud(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (size, 3) of the walls of a room whose floor grows with them, a point in each cell, and 1000 queries."""
    rng = np.random.default_rng(0)
    side = 0.1 * np.sqrt(size)
    points = np.concatenate([rng.uniform(0, side, (size, 2)), rng.normal(0, 0.02, (size, 1))], axis=1)
    asked = np.concatenate([rng.uniform(0, side, (1000, 2)), rng.normal(0, 0.05, (1000, 1))], axis=1)
    return points.astype(np.float32), asked.astype(np.float32)


def _points(size: int) -> Callable[[], Any]:
    points, asked = _cloud(size)
    margin = np.array([0.5, 0.5, 0.5])
    layout = grid(points.min(axis=0) - margin, points.max(axis=0) + margin, voxel=0.1)
    chart = mapping.insert(layout, mapping.empty(layout, size), jnp.asarray(points), jnp.ones(size, bool))
    look, at = jax.jit(lambda chart, at: mapping.nearest(layout, chart, at, cap=0.2)), jnp.asarray(asked)
    return lambda: look(chart, at)


def _tree(spatial: Any, size: int) -> Callable[[], Any]:
    points, asked = _cloud(size)
    tree = spatial.cKDTree(points)
    return lambda: tree.query(asked, k=5, distance_upper_bound=0.2)


__all__ = ["Curve", "curves", "draw", "exponent", "rows"]
