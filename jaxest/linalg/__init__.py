"""Decompositions of small matrices that may be called under `vmap`, on any number of threads and devices.

`cholesky`, `solve_triangular` and `cho_solve` for symmetric positive matrices, `solve`, `solve_and_log_det` and
`inverse` for general ones, `upper` (the R of a QR decomposition) for square roots, `eigh` for symmetric ones. Each is
written for one matrix of a few to some dozens of unknowns. One matrix goes to LAPACK; a batch of small ones is worked
on side by side, another one in turn. The rest of the package calls these and not `jnp.linalg`: batched LAPACK on
two threads may never return, see docs/performance.md.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxest.derivatives import settled
from jaxest.linalg import _behind
from jaxest.linalg._batches import batched
from jaxest.types import Array


def _product(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


_factor = batched(lambda a: (jax.lax.linalg.cholesky(a, symmetrize_input=False),), lambda a: (_behind.cholesky(a),), 16)


def cholesky(a: Array) -> Array:
    """Return the lower triangular root of a symmetric positive definite matrix.

    Args:
        a: (n, n); of what is not symmetric the mean is taken.

    Returns:
        (n, n) L with `L L'` = a; NaN throughout where a is not positive definite.
    """
    return _cholesky((a + a.T) / 2)


@jax.custom_jvp
def _cholesky(a: Array) -> Array:
    return settled(_factor(a)[0])


@_cholesky.defjvp
def _(primals: Any, tangents: Any) -> tuple[Array, Array]:
    root = _cholesky(*primals)
    return root, settled(_root_tangent(root, tangents[0]))


def _root_tangent(root: Array, moved: Array) -> Array:
    """Return how a lower triangular root (n, n) moves where its `L L'` moves by `moved` (n, n), symmetric.

    Source: Murray 2016 (Differentiation of the Cholesky decomposition), eq. 8.
    """
    both = solve_triangular(root, solve_triangular(root, moved).T)
    return _product(root, jnp.tril(both) - jnp.diag(jnp.diagonal(both)) / 2)


def _substitution(upper: bool) -> Any:
    def single(matrix: Array, b: Array) -> tuple[Array]:
        return (jax.lax.linalg.triangular_solve(matrix, b, left_side=True, lower=not upper),)

    return batched(single, lambda matrix, b: (_behind.substitute(matrix, b, upper),), 16, shared=True)


_forwards, _backwards = _substitution(False), _substitution(True)


def solve_triangular(lower: Array, b: Array, *, transposed: bool = False) -> Array:
    """Solve `L x = b` or `L' x = b`.

    Args:
        lower: (n, n) L; what is above its diagonal is not looked at.
        b: (n,) or (n, k).
        transposed: whether L' is meant.

    Returns:
        As b.
    """

    def whole(x: Array) -> Array:
        triangle = jnp.tril(lower)
        return _product(triangle.T if transposed else triangle, x)

    def forwards(_: Any, b: Array) -> Array:
        return _columns(_forwards, lower, b)

    def backwards(_: Any, b: Array) -> Array:
        return _columns(_backwards, lower.T, b)

    there, back = (backwards, forwards) if transposed else (forwards, backwards)
    found: Array = jax.lax.custom_linear_solve(whole, b, there, transpose_solve=back)
    return found


def _columns(solver: Any, matrix: Array, b: Array) -> Array:
    found: Array = solver(matrix, b[:, None])[0][:, 0] if b.ndim == 1 else solver(matrix, b)[0]
    return settled(found)


def cho_solve(lower: Array, b: Array) -> Array:
    """Solve `L L' x = b` for L (n, n) as of `cholesky` and b (n,) or (n, k)."""
    return solve_triangular(lower, solve_triangular(lower, b), transposed=True)


def _lu(a: Array, b: Array) -> tuple[Array, Array]:
    factor, _, order = jax.lax.linalg.lu(a)
    half = jax.lax.linalg.triangular_solve(factor, b[order], left_side=True, lower=True, unit_diagonal=True)
    x = jax.lax.linalg.triangular_solve(factor, half, left_side=True, lower=False)
    return x, jnp.sum(jnp.log(jnp.abs(jnp.diagonal(factor))))


_eliminate = batched(_lu, _behind.solve, 8, shared=True)


def solve(a: Array, b: Array) -> Array:
    """Solve `a x = b`.

    Args:
        a: (n, n), any regular matrix.
        b: (n,) or (n, k).

    Returns:
        As b; not finite where a is singular.
    """

    def there(_: Any, b: Array) -> Array:
        return _columns(_eliminate, a, b)

    def back(_: Any, b: Array) -> Array:
        return _columns(_eliminate, a.T, b)

    found: Array = jax.lax.custom_linear_solve(lambda x: _product(a, x), b, there, transpose_solve=back)
    return found


@jax.custom_jvp
def solve_and_log_det(a: Array, b: Array) -> tuple[Array, Array]:
    """Solve `a x = b` for a (n, n) and b (n, k); return x (n, k) and the logarithm () of |det a|."""
    return settled(_eliminate(a, b))


@solve_and_log_det.defjvp
def _(primals: Any, tangents: Any) -> Any:
    (a, _), (moved, b_moved) = primals, tangents
    x, log_det = solve_and_log_det(*primals)
    return (x, log_det), settled((solve(a, b_moved - _product(moved, x)), jnp.trace(solve(a, moved))))


def inverse(a: Array) -> Array:
    """Return the inverse of a regular matrix (n, n)."""
    return solve(a, jnp.eye(a.shape[0], dtype=a.dtype))


def _reduced(a: Array) -> tuple[Array]:
    r = jnp.linalg.qr(a, mode="r")
    return (jnp.triu(r) * jnp.where(jnp.diagonal(r) < 0, -1, 1).astype(a.dtype)[:, None],)


_orthogonalize = batched(_reduced, lambda a: (_behind.orthogonalize(a, a[:, :0])[0],), 8)


@jax.custom_jvp
def upper(a: Array) -> Array:
    """Return the triangle of a QR decomposition.

    Args:
        a: (m, n), m >= n.

    Returns:
        (n, n) R, upper triangular with a diagonal that is not negative; `R'R = a'a`. Its derivative needs full rank.
    """
    return settled(_orthogonalize(a)[0])


@upper.defjvp
def _(primals: Any, tangents: Any) -> tuple[Array, Array]:
    r = upper(*primals)
    half = _product(tangents[0].T, primals[0])
    return r, settled(_root_tangent(r.T, half + half.T).T)


def eigh(a: Array) -> tuple[Array, Array]:
    """Return eigenvalues (n,), ascending, and eigenvectors as columns (n, n) of a symmetric matrix (n, n).

    Where eigenvalues coincide, their vectors' derivatives are 0 towards each other.
    """
    return _eigh((a + a.T) / 2)


_decompose = batched(lambda a: tuple(jnp.linalg.eigh(a, symmetrize_input=False)))


@jax.custom_jvp
def _eigh(a: Array) -> tuple[Array, Array]:
    return settled(_decompose(a))


@_eigh.defjvp
def _(primals: Any, tangents: Any) -> Any:
    values, vectors = _eigh(*primals)
    moved = _product(_product(vectors.T, tangents[0]), vectors)
    gap = values[None, :] - values[:, None]
    apart = jnp.abs(gap) > 4 * float(jnp.finfo(gap.dtype).eps) * jnp.max(jnp.abs(values))
    turn = jnp.where(apart, moved / jnp.where(apart, gap, 1), 0)
    return (values, vectors), settled((jnp.diagonal(moved), _product(vectors, turn)))


__all__ = [
    "cho_solve", "cholesky", "eigh", "inverse", "solve", "solve_and_log_det", "solve_triangular", "upper",
]  # fmt: skip
