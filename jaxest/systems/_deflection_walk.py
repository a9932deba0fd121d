"""How joints that hardly move, move: a random walk, hinges with von Mises or Gaussian noise, others with Gaussian."""

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
from jaxest.kinematics import robot as kinds
from jaxest.kinematics.robot import HINGE
from jaxest.kinematics.space import Space, numbers, origin, put
from jaxest.manifolds import circle
from jaxest.types import Array, PyTree

TABLED = 5.0
"""Concentration whose noise is drawn from a table, ten times faster than by rejection: Sato 2023, Table I."""
SHARE = 0.8
"""A Gaussian of this share of the concentration covers the tails of a von Mises density."""


SLIDE, BALL = 2500.0, 5.0
"""Default concentrations of a step of a slide, 1/m^2, and of a ball's rotation vector, 1/rad^2."""
PRIOR = 1.0
"""That of slides and balls before the first measurement, 1/m^2 or 1/rad^2."""


def von_mises(where: Space) -> particle.Transition:
    """Return the random walk with concentration `params.walk`, () or (d,): von Mises noise of hinges.

    Slides move and balls turn, by a rotation vector, with Gaussian noise of variance 1 / `params.walk`.

    Source: Sato 2023, eq. 30, wrapped.
    """
    hinges = where.kinds.count(HINGE)
    bounded = True if hinges == where.dim else tuple(kind == HINGE for kind in where.kinds)
    return particle.Transition(
        _stay,
        partial(_draw, hinges, where.dim),
        partial(_log_prob, hinges),
        partial(_precision, hinges, where.dim),
        bounded,
    )


def first(where: Space, params: PyTree, key: Array, count: int) -> PyTree:
    """Draw states, leaves (count, ...), of concentration `params.prior` about `params.start`.

    Source: Sato 2023, eq. 29.
    """
    hinges, size = where.kinds.count(HINGE), where.dim
    dtype = jnp.result_type(*jax.tree.leaves(params))
    start, prior = jnp.asarray(params.start, dtype), jnp.asarray(params.prior, dtype)
    if hinges == size:
        return density.sample(key, start, prior, (count, size))
    one, two = jax.random.split(key)
    start, prior = jnp.broadcast_to(start, (size,)), jnp.broadcast_to(prior, (size,))
    turned = density.sample(one, 0.0, prior[:hinges], (count, hinges))
    moved = jax.random.normal(two, (count, size - hinges), dtype) / jnp.sqrt(prior[None, hinges:])
    centre = where.manifold.retract(origin(where, dtype), start)
    return jax.vmap(where.manifold.retract, (None, 0))(centre, jnp.concatenate([turned, moved], axis=1))


def gaussian(where: Space) -> particle.Transition:
    """Return the random walk with Gaussian noise of variance 1 / `params.walk` for all joints.

    Source: Sato 2023, end of section V-A.
    """

    def deviation(params: PyTree, measurement: PyTree) -> Array:
        return 1 / jnp.sqrt(_precision(0, where.dim, params, measurement))

    return particle.gaussian(_stay, deviation)


Read = Callable[[PyTree, PyTree], tuple[Array, Array]]
"""`(params, measurement) -> (d,), (d,)`: what encoders say, and how precise they are, 0 where none reads."""
TETHER = 5.0
"""Concentration by which the first search for a joint that no encoder reads is held to where its particle stands: weak
beside what sensors say, and no more than .45 rad wide where they say nothing, as others search there."""
SURE = 1.0
"""Concentration of an encoder from which it says where a joint is at the first step."""


def guessing(where: Space, transition: particle.Transition, read: Read) -> particle.Transition:
    """Let searches for the most probable angles start where encoders and the walk together would have them.

    Where links are turned far from where a particle stood, a search that hears all sensors at once may end in another
    posture that looks the same to them.
    """
    hinges = where.kinds.count(HINGE)

    def guess(params: PyTree, mean: PyTree, measurement: PyTree) -> Array:
        value, weight = read(params, measurement)
        share = weight / (weight + transition.precision(params, measurement))
        return jnp.where(weight > 0, share * _by_kind(hinges, circle.wrap, lambda way: way, value - numbers(mean)), 0)

    return transition._replace(guess=guess)


def opening(where: Space, transition: particle.Transition, read: Read) -> particle.Opening:
    """Return the law of the joints at the first step: the prior and one step of a `von_mises` walk together.

    Searches for joints that no encoder reads start at the particles, which stand for the prior, and stay near. With
    balls, whose law is not known in closed form, such joints keep to their particle's way, and so do the balls.
    """
    hinges, balls = where.kinds.count(HINGE), kinds.BALL in where.kinds

    def law(params: PyTree, dtype: Any) -> list[Array]:
        return [
            jnp.broadcast_to(jnp.asarray(x, dtype), (where.dim,)) for x in (params.start, params.prior, params.walk)
        ]

    def known(params: PyTree, measurement: PyTree) -> tuple[Array, Array]:
        value, weight = read(params, measurement)
        return value, weight >= SURE

    def centre(params: PyTree, x: PyTree, measurement: PyTree) -> PyTree:
        value, sure = known(params, measurement)
        return put(where, x, value, sure)

    def mean(params: PyTree, x: PyTree, measurement: PyTree) -> PyTree:
        return put(where, x, law(params, jnp.result_type(measurement.dt))[0], known(params, measurement)[1])

    def precision(params: PyTree, measurement: PyTree) -> Array:
        sure = known(params, measurement)[1]
        _, prior, walk = law(params, jnp.result_type(measurement.dt))
        drawn = prior * walk / (prior + walk)
        near = transition.precision(params, measurement) if balls else jnp.maximum(drawn, TETHER)
        return jnp.where(sure, drawn, near)

    def log_prob(params: PyTree, x: PyTree, moved: PyTree, v: Array, measurement: PyTree) -> Array:
        start, prior, walk = law(params, v.dtype)
        drawn = _by_kind(hinges, _convolved, _added, numbers(moved) - start, prior, walk)
        return jnp.sum(jnp.where(known(params, measurement)[1], drawn, _each(hinges, v, walk)) if balls else drawn)

    def scattered(params: PyTree, measurement: PyTree) -> Array:
        return ~jnp.all(known(params, measurement)[1])

    return particle.Opening(centre, mean, precision, log_prob, None if balls else scattered)


def _by_kind(hinges: int, turning: Callable, moving: Callable, *arrays: Array) -> Array:
    """Apply one function to the hinges' coordinates of arrays (d,), another to those of slides and balls."""
    size = arrays[0].shape[0]
    first = [turning(*(x[:hinges] for x in arrays))] if hinges else []
    last = [moving(*(x[hinges:] for x in arrays))] if hinges < size else []
    return jnp.concatenate([*first, *last])


def _normal(v: Array, precision: Array) -> Array:
    """Log-density of a Gaussian about 0."""
    return (jnp.log(precision) - math.log(2 * math.pi) - precision * v * v) / 2


def _added(v: Array, one: Array, two: Array) -> Array:
    """Log-density of the sum of two Gaussians about 0 of these precisions."""
    return _normal(v, one * two / (one + two))


def _convolved(v: Array, one: Array, two: Array) -> Array:
    """Log-density of the sum of two von Mises angles about 0: I0 of the length of one + two e^iv, over theirs.

    In logarithms of e^-k I0(k), with the length short of one + two by a difference that keeps its digits.
    """
    v = circle.wrap(v)
    square = 4 * one * two * jnp.sin(v / 2) ** 2
    length = jnp.sqrt(jnp.maximum((one + two) ** 2 - square, jnp.finfo(v.dtype).tiny))
    short = square / (one + two + length)
    return log_i0e(length) - short - log_i0e(one) - log_i0e(two) - math.log(2 * math.pi)


def _stay(params: PyTree, x: PyTree, measurement: PyTree) -> PyTree:
    return x


def _each(hinges: int, v: Array, walk: Array) -> Array:
    """Log-density (d,) of each coordinate of the noise."""
    return _by_kind(hinges, lambda v, k: density.log_prob(v, 0.0, k), _normal, v, walk)


def _log_prob(hinges: int, params: PyTree, v: Array, measurement: PyTree) -> Array:
    return jnp.sum(_each(hinges, v, jnp.broadcast_to(jnp.asarray(params.walk, v.dtype), v.shape)))


def _precision(hinges: int, size: int, params: PyTree, measurement: PyTree) -> Array:
    """Precisions (d,) of Gaussians like the noise, of which the first `hinges` are von Mises."""
    share = np.where(np.arange(size) < hinges, SHARE, 1.0)
    walk = jnp.asarray(params.walk)
    return jnp.asarray(share, walk.dtype) * walk


def _draw(hinges: int, size: int, params: PyTree, measurement: PyTree, key: Array, count: int) -> Array:
    """Draw noise (count, d): hinges by table where the concentration is the tabled one, else by exact rejection."""
    walk = jnp.asarray(params.walk)
    turning, moving = jnp.split(jnp.broadcast_to(walk, (size,)), [hinges]) if hinges < size else (walk, walk)

    def tabled(key: Array) -> Array:
        sampler = density.FastSampler(jnp.asarray(_table(walk.dtype.name)))
        return density.sample_fast(key, sampler, 0.0, (count, hinges))

    def rejected(key: Array) -> Array:
        return density.sample(key, 0.0, turning, (count, hinges))

    def turned(key: Array) -> Array:
        every: Array = jnp.all(turning == jnp.asarray(TABLED, walk.dtype))
        return jax.lax.cond(every, tabled, rejected, key)

    if hinges == size:
        return turned(key)
    one, two = jax.random.split(key)
    moved = jax.random.normal(two, (count, size - hinges), walk.dtype) / jnp.sqrt(moving)[None]
    return jnp.concatenate([turned(one), moved], axis=1) if hinges else moved


@cache
def _table(dtype: str) -> Any:
    with jax.ensure_compile_time_eval():
        return np.asarray(density.fast_sampler(TABLED, dtype).coefficients)


__all__ = ["BALL", "PRIOR", "SLIDE", "first", "gaussian", "guessing", "opening", "von_mises"]
