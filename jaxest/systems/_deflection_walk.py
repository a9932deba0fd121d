"""How joints that hardly move, move: a random walk with von Mises or Gaussian noise."""

import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.distributions import von_mises as density
from jaxest.distributions._bessel import log_i0e
from jaxest.filters import particle
from jaxest.manifolds import circle
from jaxest.types import Array, PyTree

TABLED = 5.0
"""Concentration whose noise is drawn from a table, ten times faster than by rejection: Sato 2023, Table I."""
SHARE = 0.8
"""A Gaussian of this share of the concentration covers the tails of a von Mises density."""


def von_mises(size: int) -> particle.Transition:
    """Return the random walk of `size` angles with von Mises noise of concentration `params.walk`, () or (d,).

    Source: Sato 2023, eq. 30, wrapped.
    """
    return particle.Transition(_stay, partial(_draw, size), _log_prob, partial(_precision, SHARE, size))


def gaussian(size: int) -> particle.Transition:
    """Return the random walk of `size` angles with Gaussian noise of variance 1 / `params.walk`.

    Source: Sato 2023, end of section V-A.
    """

    def deviation(params: PyTree, measurement: PyTree) -> Array:
        return 1 / jnp.sqrt(_precision(1.0, size, params, measurement))

    return particle.gaussian(_stay, deviation)


Read = Callable[[PyTree, PyTree], tuple[Array, Array]]
"""`(params, measurement) -> (d,), (d,)`: angles that encoders say, and their concentrations, 0 where none reads."""
SURE = 1.0
"""Concentration of an encoder from which it says where a joint is at the first step."""


def guessing(transition: particle.Transition, read: Read) -> particle.Transition:
    """Let searches for the most probable angles start where encoders and the walk together would have them.

    Where links are turned far from where a particle stood, a search that hears all sensors at once may end in another
    posture that looks the same to them.
    """

    def guess(params: PyTree, mean: Array, measurement: PyTree) -> Array:
        angle, weight = read(params, measurement)
        share = weight / (weight + transition.precision(params, measurement))
        return jnp.where(weight > 0, share * circle.wrap(angle - mean), 0)

    return transition._replace(guess=guess)


def opening(transition: particle.Transition, read: Read) -> particle.Opening:
    """Return the law of the angles at the first step: the prior and one step of a von Mises walk together.

    Joints that no encoder reads keep to their particle's way.
    """

    def law(params: PyTree, dtype: Any) -> tuple[Array, Array, Array]:
        return jnp.asarray(params.start, dtype), jnp.asarray(params.prior, dtype), jnp.asarray(params.walk, dtype)

    def known(params: PyTree, measurement: PyTree) -> tuple[Array, Array]:
        angle, weight = read(params, measurement)
        return angle, weight >= SURE

    def centre(params: PyTree, x: Array, measurement: PyTree) -> Array:
        angle, sure = known(params, measurement)
        return jnp.where(sure, angle, x)

    def mean(params: PyTree, x: Array, measurement: PyTree) -> Array:
        return jnp.where(known(params, measurement)[1], law(params, x.dtype)[0], x)

    def precision(params: PyTree, measurement: PyTree) -> Array:
        sure = known(params, measurement)[1]
        _, prior, walk = law(params, jnp.result_type(measurement.dt))
        return jnp.where(sure, prior * walk / (prior + walk), transition.precision(params, measurement))

    def log_prob(params: PyTree, x: Array, moved: Array, measurement: PyTree) -> Array:
        start, prior, walk = law(params, x.dtype)
        stepped = density.log_prob(moved, x, walk)
        drawn = _convolved(circle.wrap(moved - start), prior, walk)
        return jnp.sum(jnp.where(known(params, measurement)[1], drawn, stepped))

    return particle.Opening(centre, mean, precision, log_prob)


def _convolved(v: Array, one: Array, two: Array) -> Array:
    """Log-density of the sum of two von Mises angles about 0: I0 of the length of one + two e^iv, over theirs.

    In logarithms of e^-k I0(k), with the length short of one + two by a difference that keeps its digits.
    """
    square = 4 * one * two * jnp.sin(v / 2) ** 2
    length = jnp.sqrt(jnp.maximum((one + two) ** 2 - square, jnp.finfo(v.dtype).tiny))
    short = square / (one + two + length)
    return log_i0e(length) - short - log_i0e(one) - log_i0e(two) - math.log(2 * math.pi)


def _stay(params: PyTree, x: Array, measurement: PyTree) -> Array:
    return x


def _log_prob(params: PyTree, v: Array, measurement: PyTree) -> Array:
    return jnp.sum(density.log_prob(v, 0.0, jnp.asarray(params.walk, v.dtype)))


def _precision(share: float, size: int, params: PyTree, measurement: PyTree) -> Array:
    walk = jnp.asarray(params.walk)
    return jnp.broadcast_to(share * walk, (size,))


def _draw(size: int, params: PyTree, measurement: PyTree, key: Array, count: int) -> Array:
    """Draw by table where the concentration is the tabled one, by exact rejection where it is another."""
    walk = jnp.asarray(params.walk)

    def tabled(key: Array) -> Array:
        sampler = density.FastSampler(jnp.asarray(_table(walk.dtype.name)))
        return density.sample_fast(key, sampler, 0.0, (count, size))

    def rejected(key: Array) -> Array:
        return density.sample(key, 0.0, walk, (count, size))

    return jax.lax.cond(jnp.all(walk == jnp.asarray(TABLED, walk.dtype)), tabled, rejected, key)


@cache
def _table(dtype: str) -> Any:
    with jax.ensure_compile_time_eval():
        return np.asarray(density.fast_sampler(TABLED, dtype).coefficients)


__all__ = ["gaussian", "guessing", "opening", "von_mises"]
