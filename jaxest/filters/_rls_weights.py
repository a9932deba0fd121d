"""Covariance of the newest residuals, and how it weighs an observation."""

from collections.abc import Callable

import jax.numpy as jnp

from jaxest.filters._small import eye, inverse3, product
from jaxest.linalg._eigen4 import eigen4
from jaxest.types import Array

Start = Callable[[Array, Array], tuple[Array, Array]]
"""How residuals become a weight; arguments and result as for `patient`."""


def patient(noise: Array, full: Array) -> tuple[Array, Array]:
    """Weigh all alike until the queue is full, then rescale what came so far by the mean variance.

    A covariance of a few residuals, of estimates that those residuals made, would give single steps any weight.

    Args:
        noise: (3, 3) covariance of the residuals.
        full: () bool, whether the queue is.

    Returns:
        The weight (3, 3), and whether it is to be rescaled later.
    """
    return jnp.where(full[None, None], inverse3(noise), eye(3, noise[0, 0])), ~full


def unweighted(noise: Array, full: Array) -> tuple[Array, Array]:
    """Weigh all alike for ever; the covariance is still that of the residuals. Arguments as for `patient`."""
    return eye(3, noise[0, 0]), jnp.ones_like(full)


def pseudo_inverse(noise: Array, full: Array) -> tuple[Array, Array]:
    """Weigh by the pseudo-inverse from the first residual on, as the paper does; arguments as for `patient`."""
    wide = jnp.zeros((4, 4), noise.dtype).at[:3, :3].set(noise)
    values, vectors = eigen4(wide)
    real = values > 1e-3 * jnp.sqrt(jnp.finfo(noise.dtype).eps) * jnp.max(values)
    inverse = product(vectors * jnp.where(real, 1 / jnp.where(real, values, 1), 0)[None, :], vectors.T)
    return inverse[:3, :3], jnp.zeros_like(full)


def noise_of(queue: Array, seen: Array, floor: Array) -> Array:
    """Return the covariance (3, 3) of the residuals in the queue; zeros that pad it at the start do not count."""
    count = jnp.clip(seen, 2, queue.shape[0]).astype(queue.dtype) - 1
    squares = jnp.sum(queue[:, :, None] * queue[:, None, :], axis=0) / count[None, None]
    return squares + (floor * floor)[None, None] * eye(3, squares[0, 0])


def variance_of(queue: Array, seen: Array, floor: Array) -> Array:
    """Return the mean variance () of the residuals in the queue; arguments as for `noise_of`."""
    count = jnp.clip(seen, 2, queue.shape[0]).astype(queue.dtype)
    return jnp.sum(queue * queue, axis=(0, 1)) / (3 * (count - 1)) + floor * floor


__all__ = ["Start", "noise_of", "patient", "pseudo_inverse", "unweighted", "variance_of"]
