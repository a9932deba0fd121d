"""Many small normal equations at once: the batch lies in the last axis, and every loop is over rows of (d, N).

Written for a batch, not for one, for a measured reason: on CPU 256 systems of 4 unknowns and 13 equations take 8 us in
all this way; batched products and LAPACK calls take 200. XLA turns sums over (d, d, N) or over middle axes into scalar
loops, and recomputes what unrolled loops share.
"""

import jax
import jax.numpy as jnp

from jaxest.types import Array

_EXACT = jax.lax.Precision.HIGHEST


def normal_equations(residual: Array, jacobian: Array, at: Array, prior: Array, pull: Array) -> Array:
    """Return the equations whose solution minimises `v' prior v - 2 pull' v + |residual + jacobian (v - at)|^2`.

    Args:
        residual: (m, N) with unit noise.
        jacobian: (m, d, N) its derivative.
        at: (d, N) where the residual was taken.
        prior: (d, d) information.
        pull: (d, N) the prior's information times its mean.

    Returns:
        (d, d + 1, N): prior + J'J, and pull + J'J at - J'r as the last column.
    """
    rows = jnp.concatenate([jacobian, -residual[:, None]], axis=1)

    def line(_: None, now: tuple[Array, Array, Array]) -> tuple[None, Array]:
        i, known, drawn = now

        def add(total: Array, row: Array) -> tuple[Array, None]:
            return total + row * row[i][None], None

        total = jax.lax.scan(add, jnp.zeros_like(rows[0]), rows)[0]
        right = total[-1] + jnp.sum(total[:-1] * at, axis=0) + drawn
        return None, jnp.concatenate([total[:-1] + known[:, None], right[None]])

    return jax.lax.scan(line, None, (jnp.arange(prior.shape[0]), prior, pull))[1]


def misfit(residual: Array, jacobian: Array, step: Array) -> Array:
    """Return |residual + jacobian step|^2, (N,), of residual (m, N), jacobian (m, d, N) and step (d, N)."""

    def square(total: Array, row: tuple[Array, Array]) -> tuple[Array, None]:
        gap = row[0] + jnp.sum(row[1] * step, axis=0)
        return total + gap * gap, None

    return jax.lax.scan(square, jnp.zeros_like(residual[0]), (residual, jacobian))[0]


def factorize(equations: Array, floor: Array) -> Array:
    """Factorise P = L L' and solve L y = b.

    Args:
        equations: (d, d + 1, N), P and b as the last column.
        floor: (d,) what a pivot is raised to where rounding has left less; at least some eps of P's own diagonal, or
            what is left beside it would be divided by nearly nothing.

    Returns:
        (d, d + 1, N): L', and y as the last column.
    """
    numbers = jnp.arange(equations.shape[0])
    noise = 4 * jnp.finfo(equations.dtype).eps * equations[numbers, numbers]

    def column(done: Array, now: tuple[Array, Array, Array]) -> tuple[Array, None]:
        j, row, least = now

        def take(row: Array, earlier: Array) -> tuple[Array, None]:
            return row - earlier * earlier[j][None], None

        row = jax.lax.scan(take, row, done)[0]  # those not done yet are zero
        row = row.at[j].max(least)
        row = jnp.where((jnp.arange(row.shape[0]) >= j)[:, None], row, 0)
        return done.at[j].set(row * jax.lax.rsqrt(row[j])[None]), None

    return jax.lax.scan(column, jnp.zeros_like(equations), (numbers, equations, jnp.maximum(noise, floor[:, None])))[0]


def solve(factor: Array, right: Array) -> Array:
    """Solve L' x = b.

    Args:
        factor: (d, d + 1, N) as `factorize` returns it; its last column is not looked at.
        right: (d, N) b.

    Returns:
        x (d, N).
    """
    numbers = jnp.arange(right.shape[0])

    def back(x: Array, now: tuple[Array, Array, Array]) -> tuple[Array, None]:
        j, row, b = now
        value = (b - jnp.sum(row[:-1] * x, axis=0)) / row[j]  # x is zero up to j yet
        return x.at[j].set(value), None

    return jax.lax.scan(back, jnp.zeros_like(right), (numbers, factor, right), reverse=True)[0]


def turned(equations: Array, basis: Array) -> Array:
    """Return equations (d, d + 1, N) in the coordinates u of v = basis u, basis (d, d)."""
    size, _, count = equations.shape
    half = jnp.matmul(basis.T, equations.reshape(size, -1), precision=_EXACT).reshape(equations.shape)
    information, right = half[:, :-1], half[:, -1:]
    across = jnp.matmul(basis.T, jnp.swapaxes(information, 0, 1).reshape(size, -1), precision=_EXACT)
    return jnp.concatenate([jnp.swapaxes(across.reshape(size, size, count), 0, 1), right], axis=1)


def conditional(factor: Array, white: Array, given: Array, known: Array) -> Array:
    """Draw what is not known of x with L' x = y + white, given what is known.

    Args:
        factor: (d, d + 1, N) as `factorize` returns it.
        white: (d, N) standard normals.
        given: (d, N) the known ones' values.
        known: (d,) bool; those known come last.

    Returns:
        x (d, N).
    """

    def back(x: Array, now: tuple[Array, Array, Array, Array, Array]) -> tuple[Array, None]:
        j, row, z, kept, keep = now
        value = (row[-1] + z - jnp.sum(row[:-1] * x, axis=0)) / row[j]
        return x.at[j].set(jnp.where(keep, kept, value)), None

    rows = (jnp.arange(given.shape[0]), factor, white, given, known)
    return jax.lax.scan(back, jnp.zeros_like(given), rows, reverse=True)[0]


def whiten(factor: Array, value: Array) -> Array:
    """Return L' value: standard normal where the value is an error of the Gaussian that the equations describe.

    Args:
        factor: (d, d + 1, N) as `factorize` returns it; its last column is not looked at.
        value: (d, N).

    Returns:
        (d, N).
    """

    def line(_: None, row: Array) -> tuple[None, Array]:
        return None, jnp.sum(row[:-1] * value, axis=0)

    return jax.lax.scan(line, None, factor)[1]
