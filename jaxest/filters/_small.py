"""Small matrices without LAPACK: closed forms and scans that stay fast under vmap.

All take, behind the axes that are named, one more for a batch: XLA on CPU makes straight
vector code of a batch whose items lie side by side, and loops of three of one whose components do.
"""

from collections.abc import Callable
from functools import reduce
from operator import add
from typing import Any

import jax
import jax.numpy as jnp

from jaxest.types import Array


def product(a: Array, b: Array) -> Array:
    """Return `a @ b` in full precision.

    Of single matrices by a real matrix product, which XLA does not compute again in every fusion; of a batch that lies
    behind written out, which only pays between `held` pieces of a program.
    """
    if a.ndim == 2 and b.ndim == 2:
        return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)
    return written_out(a, b)


def written_out(a: Array, b: Array) -> Array:
    """Return `a @ b` as sums that fuse with what is around them: faster where little else needs the result."""
    return reduce(add, (a[:, k, None] * b[None, k] for k in range(a.shape[1])))


def applied(a: Array, x: Array) -> Array:
    """Return `a @ x` for a vector."""
    return reduce(add, (a[:, k] * x[None, k] for k in range(a.shape[1])))


def turned_back(a: Array, x: Array) -> Array:
    """Return `a.T @ x` for a vector."""
    return reduce(add, (a[k] * x[None, k] for k in range(a.shape[0])))


def transposed(a: Array) -> Array:
    """Return the transpose of a matrix."""
    return jnp.swapaxes(a, 0, 1)


def sandwich(a: Array, p: Array) -> Array:
    """Return `a p a'`."""
    return product(product(a, p), transposed(a))


def eye(n: int, like: Array) -> Array:
    """Return the identity (n, n), with an axis of 1 for every axis that the scalar `like` has."""
    return jnp.eye(n, dtype=like.dtype).reshape((n, n) + (1,) * like.ndim)


def held(go: Array | None, piece: Callable[..., Any], *args: Any) -> Any:
    """Call a piece of a program so that XLA computes its results once and not in everything that uses them.

    Args:
        go: () bool that is true, which the compiler must not know; None to call the piece as it is.
        piece: of arrays to a pytree of arrays.
        args: its arguments.

    Returns:
        What it returns.
    """
    if go is None:
        return piece(*args)
    shapes = jax.eval_shape(piece, *args)
    return jax.lax.cond(go, piece, lambda *_: jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes), *args)


def outer(a: Array, b: Array) -> Array:
    """Return `a b'`."""
    return a[:, None] * b[None, :]


def trace(a: Array) -> Array:
    """Return the trace () of a (3, 3)."""
    return a[0, 0] + a[1, 1] + a[2, 2]


def inverse3(a: Array) -> Array:
    """Return the inverse of a symmetric positive definite (3, 3) by cofactors; zeros where it is singular.

    The matrix is scaled to a unit diagonal first, so that axes of very different variance keep their digits.
    """
    diagonal = jnp.stack([a[0, 0], a[1, 1], a[2, 2]])
    some = diagonal > 0
    scale = jnp.where(some, 1 / jnp.sqrt(jnp.where(some, diagonal, 1)), 0)
    both = outer(scale, scale)
    m = a * both
    (p, q, r), (s, t), u = m[0], m[1, 1:], m[2, 2]
    x, y, z = s * u - t * t, r * t - q * u, q * t - r * s
    det = p * x + q * y + r * z
    there = det > 4 * float(jnp.finfo(a.dtype).eps)
    found = jnp.stack([x, y, z, y, p * u - r * r, q * r - p * t, z, q * r - p * t, p * s - q * q]).reshape(a.shape)
    return found * (jnp.where(there, 1 / jnp.where(there, det, 1), 0)[None, None] * both)


def largest(values: Array, vectors: Array) -> Array:
    """Return the eigenvector (4,) of the largest eigenvalue, w >= 0."""
    best, found = values[0], vectors[:, 0]
    for k in range(1, 4):
        more = values[k] > best
        best, found = jnp.where(more, values[k], best), jnp.where(more[None], vectors[:, k], found)
    return jnp.where(found[None, 0] < 0, -found, found)


__all__ = [
    "applied", "eye", "held", "inverse3", "largest", "outer", "product", "sandwich", "trace",
    "transposed", "turned_back", "written_out",
]  # fmt: skip
