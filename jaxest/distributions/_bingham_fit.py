"""Maximum-likelihood estimates of Bingham densities, by matching second moments."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.distributions._bingham_normalizer import moment_covariance, second_moments
from jaxest.distributions._bingham_params import Params
from jaxest.distributions._symmetric import eigh, product
from jaxest.manifolds._algebra import solve3
from jaxest.manifolds.base import as_array, normalized
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike

_ITERATIONS = 6


class Fit(NamedTuple):
    """The maximum-likelihood estimate of a Bingham density."""

    params: Params
    """The density; the largest concentration is 0. NaN where the sample is not finite."""
    status: Array
    """() int32: `OK`; `NOT_CONVERGED` where the moments are not matched, also because a direction holds no sample at
    all and the estimate would be infinite; `NON_FINITE` where a number is not finite or no weight is positive."""


def fit(xs: ArrayLike, weights: ArrayLike | None = None) -> Fit:
    """Return the maximum-likelihood density of a sample of quaternions.

    The moments are summed twice, the second time along the principal directions of the first, so that those of a
    concentrated sample keep their digits in float32 too.

    Args:
        xs: (N, 4) unit quaternions wxyz, of either sign.
        weights: (N,), any scale; all equal if None.

    Returns:
        `Fit`.

    Raises:
        ValueError: a shape is wrong.
    """
    xs = as_array("xs", xs, None, 4)
    weights = normalized(weights, xs)
    good = jnp.all(jnp.isfinite(xs)) & jnp.all(jnp.isfinite(weights)) & (jnp.sum(weights) > 0)
    xs, weights = jnp.where(good, xs, 0.5), jnp.where(good, weights, 1.0 / xs.shape[0])
    _, rough = eigh(_moment(xs, weights))
    moments, turn = eigh(_moment(product(xs, rough), weights))
    found = _matched(moments, product(rough, turn))
    lost = jnp.where(good, 0.0, jnp.nan).astype(xs.dtype)
    params = Params(found.params.directions + lost, found.params.lam + lost)
    return Fit(params, jnp.where(good, found.status, NON_FINITE).astype(jnp.int32))


def fit_moment(second_moment: ArrayLike) -> Fit:
    """Return the density with a given second moment, the one of largest entropy.

    Args:
        second_moment: (4, 4) E[q q^T], symmetric, positive definite; scaled to trace 1.

    Returns:
        `Fit`. In float32 an eigenvalue below 1e-5 is known to few digits from a full matrix; `fit` does better.

    Raises:
        ValueError: the shape is wrong.
    """
    matrix = as_array("second_moment", second_moment, 4, 4)
    good = jnp.all(jnp.isfinite(matrix)) & (jnp.trace(matrix) > 0)
    safe = jnp.where(good, (matrix + matrix.T) / 2, jnp.eye(4, dtype=matrix.dtype))
    found = _matched(*eigh(safe))
    lost = jnp.where(good, 0.0, jnp.nan).astype(matrix.dtype)
    params = Params(found.params.directions + lost, found.params.lam + lost)
    return Fit(params, jnp.where(good, found.status, NON_FINITE).astype(jnp.int32))


def _moment(xs: Array, weights: Array) -> Array:
    """Return the weighted sum of x x^T, (4, 4), each entry to a few eps of its own terms."""
    columns = [xs[:, i] for i in range(4)]
    entries = {(i, j): jnp.sum(weights * columns[i] * columns[j]) for i in range(4) for j in range(i, 4)}
    return jnp.stack([jnp.stack([entries[min(i, j), max(i, j)] for j in range(4)]) for i in range(4)])


def _matched(moments: Array, directions: Array) -> Fit:
    """Return the density whose second moments along `directions` are `moments` (4,), scaled to sum to 1."""
    eps = float(jnp.finfo(moments.dtype).eps)
    floor = 16 * eps * eps
    missing = jnp.any(moments <= floor * jnp.sum(moments))
    moments = jnp.maximum(moments, floor * jnp.sum(moments))
    moments = moments / jnp.sum(moments)
    order = (jnp.argmax(moments) + jnp.arange(4)) % 4
    moments, directions = moments[order], directions[:, order]
    lam = _solve(moments)
    error = jnp.max(jnp.abs(second_moments(lam) / moments - 1))
    tolerance = {"float32": 2e-5, "float64": 1e-10}.get(moments.dtype.name, 1e-10)
    status = jnp.where(missing | ~(error <= tolerance), NOT_CONVERGED, OK)
    return Fit(Params(directions, lam), status.astype(jnp.int32))


@jax.jit
def _solve(moments: Array) -> Array:
    """Return lam (4,), the first 0, of moments (4,), the first the largest.

    1 / E[x_i^2] is nearly 2 a_i plus a constant (it is so at uniform, and in the limit of high concentration), which
    gives the start; Newton's method then solves for equal differences of these reciprocals, nearly linear in lam.
    """
    target = 1 / moments - 1 / moments[0]
    zero = jnp.zeros_like(moments[:1])

    def newton(_: int, lam: Array) -> Array:
        m = second_moments(lam)
        excess = (1 / m - 1 / m[0] - target) * m
        scaled = moment_covariance(lam) / (m[:, None] * m[None, :])
        slope = scaled - scaled[:1] * (m / m[0])[:, None]
        step = solve3(slope[1:, 1:], excess[1:]) / m[1:]
        return jnp.minimum(lam + jnp.concatenate([zero, step]), 0.0)

    return jax.lax.fori_loop(0, _ITERATIONS, newton, -target / 2)


__all__ = ["Fit", "fit", "fit_moment"]
