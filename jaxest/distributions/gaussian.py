"""The normal distribution of a vector (d,), with a covariance (d, d), or (d,) variances of independent components."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.distributions._checks import common_dtype
from jaxest.manifolds.base import as_array, normalized
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike

_LOG_TURN = math.log(2 * math.pi)


class Fit(NamedTuple):
    """The maximum-likelihood estimate of a normal distribution."""

    mean: Array
    """(d,)"""
    covariance: Array
    """(d, d), divided by the weights' sum (not by one less)."""
    status: Array
    """() int32: `OK`, `NOT_CONVERGED` (the covariance is singular: no density), or `NON_FINITE`."""


def square(name: str, matrix: Array, size: int | None = None) -> Array:
    """Return a matrix whose shape is (n, n), n being `size` if given; raises ValueError naming it otherwise."""
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or size not in (None, matrix.shape[0]):
        expected = "(n, n)" if size is None else f"({size}, {size})"
        raise ValueError(f"{name}: has shape {matrix.shape}, expected {expected} (vmap adds batch axes)")
    return matrix


def _covariance(covariance: ArrayLike, size: int | None, dtype: jnp.dtype) -> Array:
    array = jnp.asarray(covariance, dtype)
    if array.ndim == 1 and size in (None, array.shape[0]):
        return array
    return square("covariance", array, size)


def log_prob(x: ArrayLike, mean: ArrayLike, covariance: ArrayLike) -> Array:
    """Return the log density.

    Args:
        x: (d,).
        mean: (d,), in the unit of x.
        covariance: (d, d) symmetric positive definite, or (d,) variances.

    Returns:
        (); NaN where the covariance is not positive definite.

    Raises:
        ValueError: a shape is wrong.
    """
    dtype = common_dtype(x, mean, covariance)
    x = as_array("x", jnp.asarray(x, dtype), None)
    residual = x - as_array("mean", jnp.asarray(mean, dtype), x.shape[0])
    covariance = _covariance(covariance, x.shape[0], dtype)
    if covariance.ndim == 1:
        return -0.5 * jnp.sum(residual * residual / covariance + jnp.log(covariance) + _LOG_TURN)
    root = linalg.cholesky(covariance)
    white = linalg.solve_triangular(root, residual)
    return -0.5 * jnp.sum(white * white + _LOG_TURN) - jnp.sum(jnp.log(jnp.diagonal(root)))


def mean(mean: ArrayLike, covariance: ArrayLike) -> Array:
    """Return the mean (d,); raises ValueError for wrong shapes."""
    dtype = common_dtype(mean, covariance)
    centre = as_array("mean", jnp.asarray(mean, dtype), None)
    _covariance(covariance, centre.shape[0], dtype)
    return centre


def entropy(covariance: ArrayLike) -> Array:
    """Return the differential entropy (), nat, of a covariance (d, d) or (d,); raises ValueError for other shapes."""
    covariance = _covariance(covariance, None, common_dtype(covariance))
    diagonal = covariance if covariance.ndim == 1 else jnp.diagonal(linalg.cholesky(covariance)) ** 2
    return 0.5 * jnp.sum(jnp.log(diagonal) + 1 + _LOG_TURN)


def sample(key: Array, mean: ArrayLike, covariance: ArrayLike, shape: tuple[int, ...] | int = ()) -> Array:
    """Draw vectors.

    Args:
        key: random key.
        mean: (d,).
        covariance: (d, d) symmetric positive definite, or (d,) variances.
        shape: how many draws, static.

    Returns:
        (*shape, d), differentiable in the mean and the covariance.

    Raises:
        ValueError: a shape is wrong.
    """
    dtype = common_dtype(mean, covariance)
    centre = as_array("mean", jnp.asarray(mean, dtype), None)
    d = centre.shape[0]
    covariance = _covariance(covariance, d, dtype)
    whole = (shape,) if isinstance(shape, int) else tuple(shape)
    z = jax.random.normal(key, (math.prod(whole), d), dtype)
    if covariance.ndim == 1:
        moved = z * jnp.sqrt(covariance)[None, :]
    else:
        moved = jnp.matmul(z, linalg.cholesky(covariance).T, precision=jax.lax.Precision.HIGHEST)
    return (centre[None, :] + moved).reshape(*whole, d)


def fit(xs: ArrayLike, weights: ArrayLike | None = None) -> Fit:
    """Return the maximum-likelihood estimate from a sample.

    Args:
        xs: (N, d).
        weights: (N,), any scale; all equal if None.

    Returns:
        `Fit`.

    Raises:
        ValueError: a shape is wrong.
    """
    xs = as_array("xs", xs, None, None)
    weights = normalized(weights, xs)
    centre = jnp.sum(weights[:, None] * xs, axis=0)
    apart = xs - centre[None, :]
    covariance = jnp.matmul((weights[:, None] * apart).T, apart, precision=jax.lax.Precision.HIGHEST)
    finite = jnp.all(jnp.isfinite(covariance)) & jnp.all(jnp.isfinite(weights)) & (jnp.sum(weights) > 0)
    regular = jnp.all(jnp.isfinite(linalg.cholesky(covariance)))
    status = jnp.where(finite, jnp.where(regular, OK, NOT_CONVERGED), NON_FINITE)
    return Fit(centre, covariance, status.astype(jnp.int32))


def from_information(information: ArrayLike, precision: ArrayLike) -> tuple[Array, Array]:
    """Return mean (d,) and covariance (d, d) of the density proportional to exp(h . x - x^T P x / 2).

    Args:
        information: (d,) h, precision times mean.
        precision: (d, d) P, symmetric positive definite.

    Returns:
        The mean P^-1 h and the covariance P^-1.

    Raises:
        ValueError: a shape is wrong.
    """
    dtype = common_dtype(information, precision)
    information = as_array("information", jnp.asarray(information, dtype), None)
    precision = square("precision", jnp.asarray(precision, dtype), information.shape[0])
    root = linalg.cholesky(precision)
    covariance = linalg.cho_solve(root, jnp.eye(information.shape[0], dtype=dtype))
    return linalg.cho_solve(root, information), (covariance + covariance.T) / 2


def component_given_rest(x: ArrayLike, mean: ArrayLike, precision: ArrayLike, index: ArrayLike) -> tuple[Array, Array]:
    """Return mean () and standard deviation () of one component given all others, for a Gibbs sweep within bounds.

    Args:
        x: (d,) current values; the component's own does not matter.
        mean: (d,).
        precision: (d, d) inverse covariance.
        index: () which component; may be traced.

    Returns:
        The location and scale that `truncated_normal.sample` takes.

    Raises:
        ValueError: a shape is wrong.
    """
    dtype = common_dtype(x, mean, precision)
    x = as_array("x", jnp.asarray(x, dtype), None)
    mean = as_array("mean", jnp.asarray(mean, dtype), x.shape[0])
    row = square("precision", jnp.asarray(precision, dtype), x.shape[0])[index]
    others = jnp.where(jnp.arange(x.shape[0]) == index, 0.0, x - mean)
    return mean[index] - jnp.sum(row * others) / row[index], 1 / jnp.sqrt(row[index])


def condition(mean: ArrayLike, covariance: ArrayLike, known: tuple[int, ...], value: ArrayLike) -> tuple[Array, Array]:
    """Return the distribution of the other components given some.

    Args:
        mean: (d,).
        covariance: (d, d) symmetric positive definite.
        known: which components are given, static.
        value: (k,) their values, in the same order.

    Returns:
        The mean (d - k,) and covariance (d - k, d - k) of the others, in their order.

    Raises:
        ValueError: a shape is wrong.
    """
    dtype = common_dtype(mean, covariance, value)
    mean = as_array("mean", jnp.asarray(mean, dtype), None)
    covariance = square("covariance", jnp.asarray(covariance, dtype), mean.shape[0])
    value = as_array("value", jnp.asarray(value, dtype), len(known))
    given = np.asarray(known, int)
    rest = np.setdiff1d(np.arange(mean.shape[0]), given)
    root = linalg.cholesky(covariance[given][:, given])
    gain = linalg.solve_triangular(root, covariance[given][:, rest])
    white = linalg.solve_triangular(root, value - mean[given])
    high = jax.lax.Precision.HIGHEST
    centre = mean[rest] + jnp.matmul(gain.T, white, precision=high)
    return centre, covariance[rest][:, rest] - jnp.matmul(gain.T, gain, precision=high)


__all__ = [
    "Fit",
    "component_given_rest",
    "condition",
    "entropy",
    "fit",
    "from_information",
    "log_prob",
    "mean",
    "sample",
]
