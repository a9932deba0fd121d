"""The inverse-Wishart distribution of a covariance matrix (p, p); one matrix, `vmap` adds batches."""

import math

import jax
import jax.numpy as jnp
from jax.scipy.special import digamma, multigammaln

from jaxest import linalg
from jaxest.distributions._checks import common_dtype
from jaxest.distributions.gaussian import square
from jaxest.types import Array, ArrayLike


def _arguments(dof: ArrayLike, scale: ArrayLike) -> tuple[Array, Array]:
    dtype = common_dtype(dof, scale)
    if jnp.ndim(dof):
        raise ValueError(f"dof: has shape {jnp.shape(dof)}, expected () (vmap adds batch axes)")
    return jnp.asarray(dof, dtype), square("scale", jnp.asarray(scale, dtype))


def _log_det(root: Array) -> Array:
    return 2 * jnp.sum(jnp.log(jnp.diagonal(root)))


def log_prob(x: ArrayLike, dof: ArrayLike, scale: ArrayLike) -> Array:
    """Return the log density with respect to the p (p + 1) / 2 entries of the upper triangle.

    Args:
        x: (p, p) symmetric positive definite.
        dof: () degrees of freedom, above p - 1.
        scale: (p, p) symmetric positive definite, in the unit of x.

    Returns:
        (); NaN where a matrix is not positive definite.

    Raises:
        ValueError: a shape is wrong.
    """
    dof, scale = _arguments(dof, scale)
    x = square("x", jnp.asarray(x, scale.dtype), scale.shape[0])
    p = scale.shape[0]
    root, other = linalg.cholesky(x), linalg.cholesky(scale)
    trace = jnp.sum(linalg.solve_triangular(root, other) ** 2)
    constant = dof / 2 * (_log_det(other) - p * math.log(2)) - multigammaln(dof / 2, p)
    return constant - (dof + p + 1) / 2 * _log_det(root) - trace / 2


def mean(dof: ArrayLike, scale: ArrayLike) -> Array:
    """Return the mean scale / (dof - p - 1) (p, p); infinite for dof <= p + 1; raises ValueError for wrong shapes."""
    dof, scale = _arguments(dof, scale)
    rest = dof - scale.shape[0] - 1
    return jnp.where(rest > 0, scale / jnp.where(rest > 0, rest, 1.0), jnp.inf)


def entropy(dof: ArrayLike, scale: ArrayLike) -> Array:
    """Return the differential entropy (), nat, over the upper triangle; raises ValueError for wrong shapes."""
    dof, scale = _arguments(dof, scale)
    p = scale.shape[0]
    half_log_det = _log_det(linalg.cholesky(scale)) - p * math.log(2)
    digammas = jnp.sum(digamma((dof - jnp.arange(p, dtype=scale.dtype)) / 2))
    return multigammaln(dof / 2, p) + (p + 1) / 2 * half_log_det - (dof + p + 1) / 2 * digammas + dof * p / 2


def sample(key: Array, dof: ArrayLike, scale: ArrayLike, shape: tuple[int, ...] | int = ()) -> Array:
    """Draw covariance matrices.

    Args:
        key: random key.
        dof: () degrees of freedom, above p - 1.
        scale: (p, p) symmetric positive definite.
        shape: how many draws, static.

    Returns:
        (*shape, p, p), symmetric positive definite.

    Raises:
        ValueError: a shape is wrong.

    Source: Bartlett's decomposition of a Wishart matrix, inverted by one triangular solve.
    """
    dof, scale = _arguments(dof, scale)
    p, dtype = scale.shape[0], scale.dtype
    whole = (shape,) if isinstance(shape, int) else tuple(shape)
    key_gamma, key_normal = jax.random.split(key)
    halves = jnp.broadcast_to((dof - jnp.arange(p, dtype=dtype)) / 2, (*whole, p))
    diagonal = jnp.sqrt(2 * jax.random.gamma(key_gamma, halves, dtype=dtype))
    below = jnp.tril(jax.random.normal(key_normal, (*whole, p, p), dtype), -1)
    bartlett = below + diagonal[..., None] * jnp.eye(p, dtype=dtype).reshape((1,) * len(whole) + (p, p))
    root = linalg.cholesky(scale).T
    columns = jax.vmap(linalg.solve_triangular, (0, None))(bartlett.reshape(-1, p, p), root).reshape(bartlett.shape)
    return jnp.einsum("...ki,...kj->...ij", columns, columns, precision=jax.lax.Precision.HIGHEST)


def posterior(dof: ArrayLike, scale: ArrayLike, scatter: ArrayLike, count: ArrayLike) -> tuple[Array, Array]:
    """Return the conditional of a covariance given normal residuals: again inverse-Wishart.

    Args:
        dof: () the prior's degrees of freedom.
        scale: (p, p) the prior's scale.
        scatter: (p, p) sum of r r^T over the residuals.
        count: () their number.

    Returns:
        () dof + count and (p, p) scale + scatter.

    Raises:
        ValueError: a shape is wrong.
    """
    dof, scale = _arguments(dof, scale)
    scatter = square("scatter", jnp.asarray(scatter, scale.dtype), scale.shape[0])
    return dof + jnp.asarray(count, scale.dtype), scale + scatter


__all__ = ["entropy", "log_prob", "mean", "posterior", "sample"]
