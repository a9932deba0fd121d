"""Decompositions of many small matrices at once, the batch in the last axis.

Loops run over rows, and each turn works on whole rows of (width, N): straight vector code, whatever the size is, and
nothing that grows with it when compiled. Sums over middle axes would become scalar loops, unrolled ones be computed
again in everything that uses them.
"""

import jax
import jax.numpy as jnp

from jaxest.types import Array


def cholesky(a: Array) -> Array:
    """Return lower triangular factors (n, n, N) of symmetric matrices (n, n, N); NaN where one is not positive.

    Column after column, each from those before it (left-looking).
    """
    rows = jnp.arange(a.shape[0])[:, None]

    def column(j: Array, done: Array) -> Array:
        def take(k: Array, row: Array) -> Array:
            earlier = done[k]
            return row - earlier * earlier[j][None]

        row = jax.lax.fori_loop(0, j, take, done[j])  # the row of a symmetric matrix is its column
        pivot = row[j]
        # Not y / sqrt(p), of which XLA makes a reciprocal root that is biased in float32.
        return done.at[j].set(jnp.where(rows >= j, row * (jnp.sqrt(pivot) / pivot)[None], 0))

    upper = jax.lax.fori_loop(0, a.shape[0], column, a)
    good = jnp.all(jnp.diagonal(upper) > 0, axis=-1)  # NaN is not
    above = rows[:, :, None] < rows.T[:, :, None]
    return jnp.where(good[None, None] | above, jnp.swapaxes(upper, 0, 1), jnp.nan)


def substitute(matrix: Array, b: Array, upper: bool) -> Array:
    """Solve triangular systems.

    Args:
        matrix: (n, n, N), of which one triangle is looked at.
        b: (n, k, N).
        upper: which triangle.

    Returns:
        (n, k, N).
    """
    n = matrix.shape[0]

    def line(turn: Array, x: Array) -> Array:
        j = n - 1 - turn if upper else turn
        row = matrix[j]

        def take(i: Array, left: Array) -> Array:
            return left - row[i][None] * x[i]

        left = jax.lax.fori_loop(j + 1, n, take, x[j]) if upper else jax.lax.fori_loop(0, j, take, x[j])
        return x.at[j].set(left / row[j][None])

    return jax.lax.fori_loop(0, n, line, b)


def orthogonalize(a: Array, b: Array) -> tuple[Array, Array]:
    """Decompose a = Q R, the columns of Q orthogonal and of length 1, by the modified method of Gram and Schmidt.

    Args:
        a: (m, n, N), m >= n.
        b: (m, k, N).

    Returns:
        (n, n, N) R, upper triangular with a diagonal that is not negative; and (n, k, N) Q'b as backward-stable
        solutions need it, each entry taken from what those before it have left of b.

    Source: Björck 1996 (Numerical methods for least squares problems), sections 2.4.2 and 2.4.4.
    """
    size = jnp.max(jnp.abs(a), axis=0)
    scale = jnp.where(size > 0, size, 1)  # squares of what is left of a column neither vanish nor overflow
    columns = jnp.swapaxes(a / scale[None], 0, 1)
    n, _, many = columns.shape

    def taken(q: Array, end: Array | int, left: Array) -> tuple[Array, Array]:
        def take(k: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
            left, shares = now
            share = jnp.sum(q[k][:, None] * left, axis=0)
            return left - q[k][:, None] * share[None], shares.at[k].set(share)

        return jax.lax.fori_loop(0, end, take, (left, jnp.zeros((n, *left.shape[1:]), left.dtype)))

    def column(j: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        q, r = now
        left, shares = taken(q, j, q[j][:, None])
        square = jnp.sum(left * left, axis=0)
        some = square > 0
        length = jnp.sqrt(square)
        unit = left * jnp.where(some, length / jnp.where(some, square, 1), 0)[None]
        return q.at[j].set(unit[:, 0]), r.at[j].set(shares.at[j].set(length)[:, 0])

    q, r = jax.lax.fori_loop(0, n, column, (columns, jnp.zeros((n, n, many), a.dtype)))
    return jnp.swapaxes(r * scale[:, None], 0, 1), taken(q, n, b)[1]


def solve(a: Array, b: Array) -> tuple[Array, Array]:
    """Solve square systems.

    Args:
        a: (n, n, N).
        b: (n, k, N).

    Returns:
        (n, k, N), and (N,) the logarithms of the determinants' sizes.
    """
    r, turned = orthogonalize(a, b)
    return substitute(r, turned, True), jnp.sum(jnp.log(jnp.diagonal(r)), axis=-1)


__all__ = ["cholesky", "orthogonalize", "solve", "substitute"]
