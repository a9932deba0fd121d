"""Square roots of covariances, singular ones included: `L L'` is the covariance, L lower triangular.

A scan over columns, as `root` needs for singular matrices, takes 3 to 8 times as long as `linalg.cholesky` from 6 x 6
on; it runs once a step.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters.kalman.gaussian import product
from jaxest.types import Array


@jax.custom_jvp
def root(covariance: Array) -> Array:
    """Return a lower triangular L (n, n) with `L L'` = covariance, which may be singular: a zero pivot gives zeros."""
    n = covariance.shape[0]
    rows = jnp.arange(n)
    least = n * jnp.finfo(covariance.dtype).eps * jnp.diagonal(covariance)

    def column(rest: Array, j: Array) -> tuple[Array, Array]:
        pivot = rest[j, j]
        there = pivot > least[j]
        found = rest[:, j] / jnp.sqrt(jnp.where(there, pivot, 1))
        found = jnp.where(there & (rows >= j), found, 0)
        return rest - found[:, None] * found[None, :], found

    return jax.lax.scan(column, covariance, rows)[1].T


@jax.custom_jvp
def triangular(wide: Array) -> Array:
    """Return a lower triangular L (n, n) with `L L' = wide wide'`, for `wide` (n, k).

    Every row is joined by an entry eps below its own length, so that no pivot vanishes; the covariance changes by
    eps^2 of itself, below rounding.
    """
    limits = jnp.finfo(wide.dtype)
    least = 1e-3 * limits.eps * jnp.sqrt(jnp.sum(wide * wide, axis=1)) + jnp.sqrt(limits.tiny)
    return linalg.upper(jnp.concatenate([wide, jnp.diag(least)], axis=1).T).T


def _turn(lower: Array, moved: Array) -> Array:
    """Derivative of L where `L L'` moves by `moved`; directions without variance are left where they are."""
    n = lower.shape[0]
    pivot = jnp.abs(jnp.diagonal(lower))
    there = pivot > 10 * n * jnp.finfo(lower.dtype).eps * jnp.sqrt(jnp.sum(lower * lower, axis=1))
    regular = lower + jnp.diag(jnp.where(there, 0, 1 - jnp.diagonal(lower)))
    left = linalg.solve_triangular(regular, moved)
    both = linalg.solve_triangular(regular, left.T)
    half = jnp.tril(both) - jnp.diag(jnp.diagonal(both)) / 2
    return jnp.where(there[None, :], product(regular, half), 0)


@root.defjvp
def _(primals: Any, tangents: Any) -> tuple[Array, Array]:
    lower = root(*primals)
    return lower, _turn(lower, (tangents[0] + tangents[0].T) / 2)


@triangular.defjvp
def _(primals: Any, tangents: Any) -> tuple[Array, Array]:
    lower = triangular(*primals)
    moved = product(tangents[0], primals[0].T)
    return lower, _turn(lower, moved + moved.T)


def solve(lower: Array, b: Array, *, transposed: bool = False) -> Array:
    """Return `L^-1 b`, or `L'^-1 b`, for b (n,) or (n, k)."""
    return linalg.solve_triangular(lower, b, transposed=transposed)


__all__ = ["root", "solve", "triangular"]
