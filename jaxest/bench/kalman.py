"""The error-state Kalman filter and smoother of an attitude and a gyroscope's bias, beside loops in NumPy."""

from collections.abc import Iterable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.bench.harness import Candidate, Progress, candidate, compare, compile_row, race
from jaxest.bench.kalman_loop import Loop, rotation
from jaxest.filters import kalman, last, run
from jaxest.io.report import Row
from jaxest.manifolds import Euclidean, product, quaternion
from jaxest.types import Reading

DT = 0.01
"""s"""
EARTH = np.array([[0.0, 0.0, 1.0], [0.0, 0.6, -0.8]])
"""Up, and a magnetic field pointing down to the north."""


class Noise(NamedTuple):
    """The model's parameters, standard deviations."""

    turn: Any = 0.02
    """rad/sqrt(s), of the gyroscope"""
    walk: Any = 1e-3
    """rad/s/sqrt(s), of its bias"""
    seen: Any = 0.05
    """of a direction"""
    turned: Any = 0.3
    """rad, of the start"""
    biased: Any = 0.05
    """rad/s, likewise"""


class Attitude(NamedTuple):
    """The state."""

    orientation: Any
    """(4,) sensor to earth"""
    bias: Any
    """(3,) rad/s"""


class Sample(NamedTuple):
    """A measurement."""

    gyroscope: Reading
    """(3,) rad/s"""
    directions: Reading
    """(2, 3) unit vectors along `EARTH`, in the sensor's frame"""
    dt: Any


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time filter and smoother of three-axis attitude and gyroscope bias, float32 and in the peer float64.

    The peer is the same filter or smoother as a loop in NumPy: filters agree to rounding, smoothers to second order
    of the noise, since ours linearises the sensors again where the filter stood.

    Args:
        peers: whether to run the loop.
        progress: hears what is being measured.
        small: a few filters and samples.

    Yields:
        Time of a live step, of a step of one filter, of 256 filters at once, and of the smoother with one and with
        several linearisations; and the times to compile.
    """
    count, steps = (3, 5) if small else (256, 100)
    noise = Noise()
    samples, one = simulated(noise, count, steps), simulated(noise, 1, steps)
    alone = jax.tree.map(lambda x: x[0], one)
    start = beginning(noise, jnp.float32)

    def filtered(measurements: Sample) -> Any:
        return run(kalman.filter_step(MODEL), noise, start, measurements, history=last)[0]

    def smoothed(iterations: int, measurements: Sample) -> Any:
        return kalman.smooth(MODEL, noise, start, measurements, iterations=iterations)[:2]

    step = jax.jit(partial(kalman.filter_step(MODEL), noise))
    first = jax.tree.map(lambda x: x[0], alone)
    programs: tuple[tuple[str, Any, tuple[Any, ...], int], ...] = (
        ("live step", step, (start, first), 1),
        ("filter", jax.jit(filtered), (alone,), steps),
        ("batched filter", jax.jit(jax.vmap(filtered)), (samples,), count * steps),
        ("smoother", jax.jit(partial(smoothed, 1)), (alone,), steps),
        ("batched smoother", jax.jit(jax.vmap(partial(smoothed, 1))), (samples,), count * steps),
        ("iterated smoother", jax.jit(partial(smoothed, 10)), (alone,), steps),
    )
    candidates = []
    for name, program, arguments, items in programs:
        progress(f"compiling {name}")
        candidates.append(candidate(name, program, *arguments, items=items))
    loop = Loop(DT, *noise, EARTH)
    arrays = [np.asarray(x, np.float64) for x in (alone.gyroscope.value, alone.directions.value)]
    if peers:
        candidates.append(Candidate("filter in NumPy", lambda: loop.filter(*arrays), steps))
        candidates.append(Candidate("smoother in NumPy", lambda: loop.smooth(*arrays), steps))
    progress("timing")
    found = race(candidates, repeats=2 if small else 7)
    for name, what in (
        ("live step", "called from Python and waited for"),
        ("filter", f"one filter, {steps} steps"),
        ("batched filter", f"{count} filters x {steps} steps"),
        ("smoother", f"one series of {steps}, one linearisation"),
        ("batched smoother", f"{count} series of {steps}, one linearisation"),
        ("iterated smoother", f"one series of {steps}, linearised until it settles"),
    ):
        peer = found.get("smoother in NumPy" if "smoother" in name else "filter in NumPy")
        yield compare(name, f"{what}, float32, per step", found[name], None if name == "iterated smoother" else peer)
        yield compile_row(f"{name}, {what}", found[name])


def beginning(noise: Noise, dtype: Any) -> kalman.State:
    """Return the state before the first sample."""
    spread = np.repeat([noise.turned**2, noise.biased**2], 3)
    mean = Attitude(quaternion.identity(dtype), jnp.zeros(3, dtype))
    return kalman.init(mean, jnp.diag(jnp.asarray(spread, dtype)))


def simulated(noise: Noise, count: int, steps: int, dtype: Any = jnp.float32) -> Sample:
    """Draw recordings of a sensor that turns at random, (count, steps)."""
    rng = np.random.default_rng(0)
    rates = np.cumsum(rng.normal(scale=0.1, size=(count, steps, 3)), axis=1)
    error = rng.normal(scale=noise.turn / np.sqrt(DT), size=rates.shape)
    bias = rng.normal(scale=noise.biased, size=(count, 1, 3))
    seen = np.zeros((count, steps, 2, 3))
    for track in range(count):
        turn = rotation(rng.normal(scale=noise.turned, size=3))
        for k in range(steps):
            turn = turn @ rotation(rates[track, k] * DT)
            seen[track, k] = EARTH @ turn
    seen += rng.normal(scale=noise.seen, size=seen.shape)
    gyroscope = Reading(jnp.asarray(rates + bias + error, dtype), jnp.ones((count, steps), bool))
    directions = Reading(jnp.asarray(seen, dtype), jnp.ones((count, steps, 2), bool))
    return Sample(gyroscope, directions, jnp.full((count, steps), DT, dtype))


def _dynamics(params: Any, x: Attitude, z: Sample) -> Attitude:
    return Attitude(quaternion.retract(x.orientation, (z.gyroscope.value - x.bias) * z.dt), x.bias)


def _process_noise(params: Noise, x: Attitude, z: Sample) -> Any:
    variances = jnp.repeat(jnp.asarray([params.turn**2, params.walk**2], x.bias.dtype), 3)
    return jnp.diag(variances) * z.dt


def _predicted(params: Any, x: Attitude, z: Sample) -> Any:
    back = quaternion.inverse(x.orientation)
    return jax.vmap(partial(quaternion.rotate, back))(jnp.asarray(EARTH, x.bias.dtype))


def _noise(params: Noise, z: Sample) -> Any:
    return jnp.full(6, params.seen**2, z.directions.value.dtype)


MODEL = kalman.Model(
    product.of(Attitude(quaternion, Euclidean((3,)))),
    _dynamics,
    _process_noise,
    (kalman.sensor("directions", _predicted, _noise),),
)
