"""The earth's field as the reference of the heading, and how far to trust a reading."""

import jax.numpy as jnp

from jaxest.types import Array, ArrayLike


def trust(tail: ArrayLike, squared: Array, rows: int) -> Array:
    """Return the weight of a residual: 1 inside its covariance, falling like the fourth power of it far outside.

    Args:
        tail: () standard deviations beyond which the weight falls.
        squared: () squared Mahalanobis distance of the residual.
        rows: its number of rows.

    Returns:
        () in (0, 1].
    """
    beyond = jnp.maximum(squared / rows - 1, 0) / tail**2
    return 1 / (1 + beyond) ** 2


def mahalanobis(residual: Array, covariance: Array) -> Array:
    """Return the squared distance () of a residual (3,) in its covariance (3, 3), in closed form for batches."""
    a, b, c = covariance
    adjugate = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])
    determinant = jnp.sum(a * adjugate[0])
    return jnp.sum(residual * jnp.sum(adjugate * residual[None, :], axis=1)) / determinant


def heading_slope(field: Array) -> Array:
    """Return the derivative (3,) by the field (3,) of the rotation about the vertical that brings it to the north."""
    flat = field[0] ** 2 + field[1] ** 2
    there = flat > 0
    slope = jnp.stack([field[1], -field[0], jnp.zeros_like(flat)]) / jnp.where(there, flat, 1)
    return jnp.where(there, slope, 0)


__all__ = ["heading_slope", "mahalanobis", "trust"]
