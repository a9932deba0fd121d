"""Small matrices without LAPACK: closed forms and scans that stay fast under vmap.

All but `eigen4`'s derivative take, behind the axes that are named, one more for a batch: XLA on CPU makes straight
vector code of a batch whose items lie side by side, and loops of three of one whose components do.
"""

from collections.abc import Callable
from functools import reduce
from operator import add
from typing import Any

import jax
import jax.numpy as jnp

from jaxest.types import OUT_OF_RANGE, Array

SWEEPS = 5  # of Jacobi: each squares what is off the diagonal, once it is small


def finite(tree: Any) -> Array:
    """Return whether all floating leaves are finite, () bool."""
    leaves = [x for x in jax.tree.leaves(tree) if jnp.issubdtype(x.dtype, jnp.floating)]
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in leaves]))


def within_range(before: Any, after: Any, info: Any) -> tuple[Any, Any]:
    """Take a step where all of its numbers are finite, and otherwise none, with a word.

    Args:
        before: the state that the step began with.
        after: the state that it led to.
        info: what it says; has a `status`.

    Returns:
        The state, which is the one before where a number outgrew the precision, the step being counted; and the info,
        whose status is `OUT_OF_RANGE` there.
    """
    fits = finite((after, info))
    kept = jax.tree.map(lambda new, old: jnp.where(fits, new, old), after, before._replace(index=after.index))
    return kept, info._replace(status=jnp.where(fits, info.status, OUT_OF_RANGE))


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
    moved = product(product(vectors.T, (tangents[0] + tangents[0].T) / 2), vectors)
    gap = values[None, :] - values[:, None]
    apart = jnp.abs(gap) > 4 * float(jnp.finfo(gap.dtype).eps) * jnp.max(jnp.abs(values))
    turn = jnp.where(apart, moved / jnp.where(apart, gap, 1), 0)
    return (values, vectors), (jnp.diagonal(moved), product(vectors, turn))


def largest(values: Array, vectors: Array) -> Array:
    """Return the eigenvector (4,) of the largest eigenvalue, w >= 0."""
    best, found = values[0], vectors[:, 0]
    for k in range(1, 4):
        more = values[k] > best
        best, found = jnp.where(more, values[k], best), jnp.where(more[None], vectors[:, k], found)
    return jnp.where(found[None, 0] < 0, -found, found)


__all__ = [
    "applied", "eigen4", "eye", "finite", "held", "inverse3", "largest", "outer", "product", "sandwich", "trace",
    "transposed", "turned_back", "written_out",
]  # fmt: skip
