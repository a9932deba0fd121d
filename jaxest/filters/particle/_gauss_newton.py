"""Gauss-Newton for all particles at once: each one's most probable next state, and the Gaussian about it."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest import linalg
from jaxest.filters.particle import _cholesky
from jaxest.filters.particle._flat import carried
from jaxest.filters.particle.proposal import Rows
from jaxest.manifolds.base import Manifold
from jaxest.types import Array, ArrayLike, PyTree


class Prior(NamedTuple):
    """What a search for the most probable states starts from."""

    start: Array
    """(d, N), where it starts in the tangent spaces."""
    precision: Array
    """(d, d)."""
    covariance: Array
    """(d, d), its inverse."""
    pull: Array
    """(d, N) precision times mean."""
    energy: Array
    """(N,) mean' precision mean."""


def posterior(
    manifold: Manifold,
    rows: Rows,
    given: tuple[PyTree, PyTree, PyTree],
    prior: Prior,
    iterations: ArrayLike,
    reach: NDArray[np.float64] | float = math.inf,
) -> tuple[Array, Array, Array, Array]:
    """Find each particle's Gaussian by Gauss-Newton.

    Args:
        manifold: where the state lives, dimension d.
        rows: see `Rows`.
        given: parameters, where the tangent spaces are taken (leaves (N, ...)), measurement.
        prior: the Gaussians without the measurement.
        iterations: () how often to linearise.
        reach: () or (d,) how far from the centre, in any coordinate.

    Returns:
        The last equations (d, d + 1, N), their factor (d, d + 1, N) and solution (d, N); and (N,) minus twice the
        logarithm of prior times likelihood there, as the last linearisation has it, but for constants.
    """

    def turn(_: Any, now: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        equations, value, jacobian = linearized(manifold, rows, given, now[2], prior)
        factor = factorized(equations, None, prior)
        at = within(_cholesky.solve(factor, factor[:, -1]), reach)
        # Summed where it is small: a difference of large sums would lose its digits in float32.
        energy = _cholesky.misfit(value, jacobian, at - now[2]) + _quadratic(prior, at)
        return equations, factor, at, jnp.where(jnp.isfinite(energy), energy, jnp.inf)

    size, count = prior.start.shape
    blank = jnp.zeros((size, size + 1, count), prior.start.dtype)
    found: tuple[Array, Array, Array, Array] = jax.lax.fori_loop(
        0, iterations, turn, (blank, blank, prior.start, prior.energy)
    )
    return found


def _quadratic(prior: Prior, v: Array) -> Array:
    """(v - mean)' precision (v - mean) of v (d, N), (N,)."""
    pushed = jnp.matmul(prior.precision, v, precision=jax.lax.Precision.HIGHEST)
    return jnp.sum(v * (pushed - 2 * prior.pull), axis=0) + prior.energy


def within(v: Array, reach: NDArray[np.float64] | float) -> Array:
    """Shorten tangent vectors (d, N) that go farther than that, () or (d,), in a coordinate."""
    limit = np.broadcast_to(reach, v.shape[:1])
    kept = np.flatnonzero(np.isfinite(limit))
    if not kept.size:
        return v
    inside = jnp.asarray(limit[kept, None], v.dtype) / jnp.maximum(jnp.abs(v[kept]), jnp.finfo(v.dtype).tiny)
    return v * jnp.minimum(1, jnp.min(inside, axis=0, keepdims=True))


def factorized(equations: Array, basis: Array | None, prior: Prior) -> Array:
    """Factorise equations in a basis, columns (d, d), or as they are; no pivot of Q^-1 + J'J is below one of Q^-1.

    Rounding must not make it so where J'J is large and of low rank.
    """
    if basis is None:
        return _cholesky.factorize(equations, 1 / jnp.diagonal(prior.covariance))
    variance = jnp.sum(basis * jnp.matmul(prior.covariance, basis, precision=jax.lax.Precision.HIGHEST), axis=0)
    return _cholesky.factorize(_cholesky.turned(equations, basis), 1 / variance)


def split(equations: Array) -> tuple[Array, Array]:
    """Directions in columns (d, d), the best known on average first; and (d,) which are wide.

    A shift s along one turns axes by s, which moves others by about s^2 / 2: too far where that is no less than half
    the deviation of the best known one.
    """
    information, basis = linalg.eigh(jnp.mean(equations[:, :-1], axis=-1))
    return basis[:, ::-1], (information < jnp.sqrt(information[-1]))[::-1]


def linearized(
    manifold: Manifold, rows: Rows, given: tuple[PyTree, PyTree, PyTree], at: Array, prior: Prior
) -> tuple[Array, Array, Array]:
    """Equations (d, d + 1, N) of the Gauss-Newton step from the noise `at` (d, N), and the rows they are made of."""

    def one(params: PyTree, mean: PyTree, measurement: PyTree, v: Array) -> tuple[Array, Array]:
        x = manifold.retract(mean, v)
        value, jacobian = rows(params, x, measurement)
        return value, carried(manifold, jacobian, mean, v)

    value, jacobian = jax.vmap(one, (None, 0, None, 1), out_axes=-1)(*given, at)
    if jacobian.shape != (value.shape[0], *at.shape):
        raise ValueError(f"rows: got shapes {value.shape[:-1]} and {jacobian.shape[:-1]}, expected (m,) and (m, d)")
    equations = _cholesky.normal_equations(value, jacobian, at, prior.precision, prior.pull)
    wide = jnp.broadcast_to(prior.precision[:, :, None], jacobian.shape[1:2] + jacobian.shape[1:])
    alone = jnp.concatenate([wide, prior.pull[:, None]], axis=1)
    finite = jnp.all(jnp.isfinite(equations), axis=(0, 1))
    return jnp.where(finite[None, None], equations, alone), value, jacobian
