"""Eigenvalues and eigenvectors of a symmetric 4 x 4 matrix by Jacobi rotations.

LAPACK under `vmap` costs microseconds a matrix. Here every entry is a scalar carry of one scan, which `vmap` turns into
vector code; and Jacobi's method keeps the relative accuracy of small eigenvalues of a graded matrix, which LAPACK's
does not.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.manifolds._algebra import matmul as product
from jaxest.types import Array

_SWEEPS = {"float32": 5, "float64": 6}
_NEXT = (0, 2, 3, 1)  # after each step the rows change places, so that three steps meet all six pairs


def _rotation(app: Array, aqq: Array, apq: Array) -> tuple[Array, Array, Array]:
    """Return t, c, s of the rotation that makes a_pq vanish; none where it is negligible beside both diagonals."""
    eps = float(jnp.finfo(apq.dtype).eps)
    ignorable = jnp.abs(apq) <= 0.01 * eps * jnp.minimum(jnp.abs(app), jnp.abs(aqq))
    off = jnp.where(ignorable, 1.0, apq)
    gap = (aqq - app) * 0.5
    # t = off / (gap + sign(gap) sqrt(gap^2 + off^2)), scaled so that no square overflows or vanishes.
    size = jnp.abs(gap) + jnp.abs(off)
    g, o = gap / size, off / size
    t = o / (jnp.where(g >= 0, 1.0, -1.0) * (jnp.abs(g) + jnp.sqrt(g * g + o * o)))
    t = jnp.where(ignorable, 0.0, t)
    c = jax.lax.rsqrt(1 + t * t)
    return t, c, t * c


def _step(a: dict[tuple[int, int], Array], v: list[list[Array]]) -> tuple[dict[tuple[int, int], Array], list]:
    """Rotate in the planes (0, 1) and (2, 3), then let the rows change places."""
    new = dict(a)
    turned = [list(row) for row in v]
    cosines, sines = {}, {}
    for p, q in ((0, 1), (2, 3)):
        t, cosines[p], sines[p] = _rotation(a[p, p], a[q, q], a[p, q])
        new[p, p], new[q, q] = a[p, p] - t * a[p, q], a[q, q] + t * a[p, q]
        new[p, q] = jnp.zeros_like(a[p, q])
        for row in turned:
            row[p], row[q] = cosines[p] * row[p] - sines[p] * row[q], sines[p] * row[p] + cosines[p] * row[q]
    (c, s), (d, u) = (cosines[0], sines[0]), (cosines[2], sines[2])
    left = {j: (c * a[0, j] - s * a[1, j], s * a[0, j] + c * a[1, j]) for j in (2, 3)}
    for i in (0, 1):
        new[i, 2], new[i, 3] = d * left[2][i] - u * left[3][i], u * left[2][i] + d * left[3][i]
    moved = {(i, j): new[min(p, q), max(p, q)] for (i, j) in a for p, q in [(_NEXT[i], _NEXT[j])]}
    return moved, [[row[k] for k in _NEXT] for row in turned]


def eigh(matrix: Array) -> tuple[Array, Array]:
    """Return the eigenvalues and eigenvectors of a symmetric matrix.

    Args:
        matrix: (4, 4), symmetric; its upper triangle is read.

    Returns:
        Eigenvalues (4,), not sorted, and eigenvectors (4, 4), one per column; `V diag(w) V^T` is the matrix to a few
        eps of its norm. Derivatives are those of the projections where eigenvalues differ; between equal ones the
        eigenvectors' derivative is zero.

    Source: cyclic Jacobi method (Golub and Van Loan, section 8.5), two disjoint planes at a time.
    """
    return _eigh(matrix)


@jax.custom_jvp
def _eigh(matrix: Array) -> tuple[Array, Array]:
    keys = [(i, j) for i in range(4) for j in range(i, 4)]
    eye = np.eye(4, dtype=matrix.dtype)

    def body(carry: tuple, _: None) -> tuple[tuple, None]:
        flat, v = carry
        a, v = _step(dict(zip(keys, flat, strict=True)), v)
        return (tuple(a[key] for key in keys), v), None

    zero = matrix[0, 0] * 0
    start = (tuple(matrix[key] for key in keys), [[zero + eye[i, j] for j in range(4)] for i in range(4)])
    sweeps = _SWEEPS.get(matrix.dtype.name, 6)
    (flat, v), _ = jax.lax.scan(body, start, None, length=3 * sweeps)
    a = dict(zip(keys, flat, strict=True))
    return jnp.stack([a[i, i] for i in range(4)]), jnp.stack([jnp.stack(row) for row in v])


@_eigh.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    w, v = _eigh(*primals)
    moved = inner(v, tangents[0])
    gap = w[None, :] - w[:, None]
    turn = jnp.where(gap == 0, 0.0, moved / jnp.where(gap == 0, 1.0, gap))
    return (w, v), (jnp.diagonal(moved), product(v, turn))


def inner(v: Array, matrix: Array) -> Array:
    """Return v^T matrix v."""
    return product(v.T, product(matrix, v))


def outer(v: Array, values: Array) -> Array:
    """Return v diag(values) v^T."""
    return product(v * values[None, :], v.T)


__all__ = ["eigh", "inner", "outer", "product"]
