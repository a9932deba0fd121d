"""The normal density that fits another one at its mode: Laplace's approximation by finite differences.

A quadratic is all that is asked of the density, so that differences over a tenth of its width lose a few digits of
float64's sixteen, and nothing has to be differentiated, which would compile for longer than this takes to run.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters.kalman.gaussian import product
from jaxest.types import Array

_STEP = 0.1  # of the scale
_FAR = 3.0  # scales that the mode may lie away from the start: farther, the density is no quadratic there


class Normal(NamedTuple):
    """A normal density."""

    mean: Array
    """(d,)"""
    root: Array
    """(d, d) lower triangular root of the covariance."""
    good: Array
    """() bool; False where the density is not curved downwards or its mode lies far off: do not use the others."""


def fit(log_density: Callable[[Array], Array], start: Array, scale: Array) -> Normal:
    """Take one Newton step towards the mode, with the curvature at the start.

    Args:
        log_density: `(d,) -> ()`, up to a constant.
        start: (d,) where most of the density is.
        scale: (d,) about its standard deviations.

    Returns:
        The normal density of that mode and curvature.
    """
    d = len(start)
    steps = _STEP * scale
    first, second = np.triu_indices(d, 1)
    eye = jnp.eye(d, dtype=start.dtype)
    away = jnp.concatenate([jnp.zeros((1, d), start.dtype), eye, eye[first] + eye[second]])
    away = jnp.stack([away, -away], axis=1) * steps[None, None]
    values = jax.lax.map(lambda x: jax.lax.map(log_density, start[None] + x), away)
    both = jnp.sum(values, axis=1) - 2 * values[0, 0]  # f(x) + f(-x) - 2 f(0)
    own, pairs = both[1 : d + 1], both[d + 1 :]
    mixed = (pairs - own[first] - own[second]) / 2
    half = jnp.zeros((d, d), start.dtype).at[first, second].set(mixed)
    # In units of the steps, which puts all entries at one size.
    information = -(half + half.T + jnp.diag(own))
    slope = (values[1 : d + 1, 0] - values[1 : d + 1, 1]) / 2
    covariance = jnp.linalg.inv(information)
    moved = product(covariance, slope) * steps
    root = jnp.linalg.cholesky((covariance + covariance.T) / 2) * steps[:, None]
    downwards = jnp.all(jnp.isfinite(jnp.linalg.cholesky(information)))
    good = downwards & jnp.all(jnp.isfinite(root)) & jnp.all(jnp.abs(moved) < _FAR * scale)
    return Normal(start + moved, root, good)


__all__ = ["Normal", "fit"]
