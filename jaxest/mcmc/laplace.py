"""The normal density that fits another one at its mode (Laplace), found by Newton's method."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters.kalman.gaussian import product
from jaxest.types import Array

_STEP = 0.1  # of the scale, to either side: differences of exact slopes, so that few digits are lost
_NEAR = 0.5  # standard deviations between two places that have the same curvature


class Normal(NamedTuple):
    """A normal density."""

    mean: Array
    """(d,)"""
    root: Array
    """(d, d) lower triangular root of the covariance."""
    good: Array
    """() bool; False where the density is not curved downwards: do not use the others."""


def fit(log_density: Callable[[Array], Array], start: Array, scale: Array) -> Normal:
    """Take one Newton step towards the mode, with the curvature at the start.

    Args:
        log_density: `(d,) -> ()`, up to a constant; differentiable.
        start: (d,) where most of the density is.
        scale: (d,) about its standard deviations.

    Returns:
        The normal density of that curvature, and of the mode that it tells.
    """
    d = len(start)
    away = _STEP * jnp.diag(scale)
    # One slope after the other: the second derivative would compile for longer than all of them take.
    places = start[None] + jnp.concatenate([jnp.zeros((1, d), start.dtype), away, -away])
    slopes = jax.lax.map(jax.grad(log_density), places)
    bend = (slopes[d + 1 :] - slopes[1 : d + 1]) / (2 * _STEP)
    information = scale[None] * (bend + (bend * scale[None] / scale[:, None]).T) / 2  # in units of the scales
    # Where it bends upwards, the size of the bend still tells how far to go (Dauphin et al. 2014).
    value, vector = linalg.eigh(information)
    size = jnp.maximum(jnp.abs(value), 1e-6 * jnp.max(jnp.abs(value)))
    covariance = product(vector / size[None], vector.T)
    moved = scale * product(covariance, scale * slopes[0])
    root = scale[:, None] * linalg.cholesky(covariance)
    good = jnp.all(value > 0) & jnp.all(jnp.isfinite(root)) & jnp.all(jnp.isfinite(moved))
    return Normal(start + moved, root, good)


def climb(log_density: Callable[[Array], Array], start: Array, scale: Array, steps: int = 20) -> Normal:
    """Fit again and again, until the mode is about where the curvature was taken.

    Args:
        log_density: as in `fit`, of positive coordinates.
        start: (d,) positive.
        scale: (d,) how far the first step may go.
        steps: fits at most; static.

    Returns:
        The normal density; `good` only where the mode was found.
    """

    def going(now: tuple[Array, Normal]) -> Array:
        return (now[0] < steps) & ~now[1].good

    def step(now: tuple[Array, Normal]) -> tuple[Array, Normal]:
        count, before = now
        reach = jnp.sqrt(jnp.sum(before.root**2, axis=1))
        found = fit(log_density, before.mean, reach)
        width = jnp.where(found.good, jnp.sqrt(jnp.sum(found.root**2, axis=1)), reach)
        moved = jnp.where(jnp.isfinite(found.mean), found.mean - before.mean, 0)
        near = found.good & jnp.all(jnp.abs(moved) < _NEAR * width) & jnp.all(found.mean > 0)
        # Far from the mode a step goes no farther than a deviation or a third of the way to 0.
        most = jnp.minimum(jnp.maximum(reach, width), before.mean / 3)
        mean = before.mean + jnp.where(near, moved, jnp.clip(moved, -most, most))
        root = jnp.where(found.good, found.root, before.root)
        return count + 1, Normal(mean, root, near)

    first = Normal(start, jnp.diag(scale), jnp.zeros((), bool))
    return jax.lax.while_loop(going, step, (jnp.zeros((), jnp.int32), first))[1]


__all__ = ["Normal", "climb", "fit"]
