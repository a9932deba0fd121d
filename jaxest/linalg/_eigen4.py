"""Eigenvalues and vectors of a symmetric 4 x 4 matrix by Jacobi rotations.

LAPACK under `vmap` costs microseconds a matrix, and Jacobi's method keeps the relative accuracy of small eigenvalues of
a graded matrix, which LAPACK's does not. Axes behind the two, for a batch, are taken by all but the derivative.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxest.types import Array

SWEEPS = 5  # each squares what is off the diagonal, once it is small


@jax.custom_jvp
def eigen4(a: Array) -> tuple[Array, Array]:
    """Return eigenvalues (4,), in no order, and eigenvectors as columns (4, 4) of a symmetric (4, 4).

    Jacobi's method, two rotations at a time, scanned over scalars: as right as LAPACK, and a batch takes the time of
    its arithmetic. Where eigenvalues coincide, their vectors' derivatives are 0 towards each other.

    Source: Golub and Van Loan 2013 (Matrix Computations), section 8.5.
    """
    scale = jnp.max(jnp.abs(a), axis=(0, 1))
    scaled = a / jnp.where(scale > 0, scale, 1)[None, None]
    values, vectors = _jacobi(scaled) if a.ndim == 2 else _jacobi_scalars(scaled)
    return values * scale[None], vectors


@jax.custom_batching.custom_vmap
def _jacobi(a: Array) -> tuple[Array, Array]:
    """Eigenvalues and vectors of one matrix; carried in one array, for each costs as much as many numbers do."""
    upper = [a[0], a[1, 1:], a[2, 2:], a[3, 3:]]

    def body(x: Array, _: None) -> tuple[Array, None]:
        (upper, vectors), _none = _turn((tuple(x[:10]), tuple(x[10:])), None)
        return jnp.stack([*upper, *vectors]), None

    start = jnp.concatenate([*upper, jnp.eye(4, dtype=a.dtype).reshape(-1)])
    last = jax.lax.scan(body, start, None, length=3 * SWEEPS)[0]
    return jnp.stack([last[0], last[4], last[7], last[9]]), last[10:].reshape(4, 4)


@_jacobi.def_vmap
def _(size: int, batched: Any, a: Array) -> Any:
    return jax.vmap(_jacobi_scalars)(a), (True, True)


def _jacobi_scalars(a: Array) -> tuple[Array, Array]:
    """The same for a batch: a scalar a component, so that the batch lies in a row."""
    upper = tuple(a[i, j] for i in range(4) for j in range(i, 4))
    eye = tuple(jnp.eye(4, dtype=a.dtype)[i, j] + 0 * a[0, 0] for i in range(4) for j in range(4))
    (upper, vectors), _ = jax.lax.scan(_sweep, (upper, eye), None, length=SWEEPS)
    found: Array = jnp.stack(vectors).reshape((4, 4, *a.shape[2:]))
    return jnp.stack([upper[0], upper[4], upper[7], upper[9]]), found


def _sweep(carry: Any, _: None) -> tuple[Any, None]:
    """Three turns, after which the indices have their order again: what is carried needs no copies."""
    for _turned in range(3):
        carry, _ = _turn(carry, None)
    return carry, None


def _turn(carry: Any, _: None) -> tuple[Any, None]:
    """Rotate rows 0, 1 and rows 2, 3 to zero their entries, then put other pairs there."""
    (a, b, c, d, e, f, g, h, i, j), v = carry
    c1, s1, t1 = _rotation(a, e, b)
    c2, s2, t2 = _rotation(h, j, i)
    a, e, h, j = a - t1 * b, e + t1 * b, h - t2 * i, j + t2 * i
    c, d, f, g = c1 * c - s1 * f, c1 * d - s1 * g, s1 * c + c1 * f, s1 * d + c1 * g
    c, d, f, g = c2 * c - s2 * d, s2 * c + c2 * d, c2 * f - s2 * g, s2 * f + c2 * g
    zero = 0 * b
    columns = []
    for row in range(4):
        p, q, r, s = v[4 * row : 4 * row + 4]
        # The next order of the indices is 0, 3, 1, 2: after three steps each pair has met.
        columns += [c1 * p - s1 * q, s2 * r + c2 * s, s1 * p + c1 * q, c2 * r - s2 * s]
    return ((a, d, zero, c, j, g, zero, e, f, h), tuple(columns)), None


def _rotation(p: Array, q: Array, off: Array) -> tuple[Array, Array, Array]:
    """Cosine, sine and tangent of the rotation that zeroes `off` between the diagonal entries p and q."""
    there = off != 0
    ratio = (q - p) / (2 * jnp.where(there, off, 1))
    size = jnp.abs(ratio)
    # Beyond 1 / eps the square would overflow and adds nothing.
    large = size > 1 / float(jnp.finfo(off.dtype).eps)
    root = jnp.where(large, size, jnp.sqrt(1 + jnp.where(large, 0, size) ** 2))
    tangent = jnp.where(ratio < 0, -1, 1) / (size + root)
    tangent = jnp.where(there, tangent, 0)
    cosine = 1 / jnp.sqrt(1 + tangent * tangent)
    return cosine, tangent * cosine, tangent


@eigen4.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> Any:
    values, vectors = eigen4(*primals)
    moved = _product(_product(vectors.T, (tangents[0] + tangents[0].T) / 2), vectors)
    gap = values[None, :] - values[:, None]
    apart = jnp.abs(gap) > 4 * float(jnp.finfo(gap.dtype).eps) * jnp.max(jnp.abs(values))
    turn = jnp.where(apart, moved / jnp.where(apart, gap, 1), 0)
    return (values, vectors), (jnp.diagonal(moved), _product(vectors, turn))


def _product(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


__all__ = ["eigen4"]
