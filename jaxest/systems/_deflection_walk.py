"""How joints that hardly move, move: a random walk with von Mises or Gaussian noise."""

from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.distributions import von_mises as density
from jaxest.filters import particle
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


__all__ = ["gaussian", "von_mises"]
