"""Turns about the vertical, and of covariances, that `posture` is made of."""

import jax.numpy as jnp

from jaxest.types import Array


def turned(matrix: Array, covariance: Array) -> Array:
    """Turn a covariance (3, 3) by a rotation."""
    half = jnp.sum(matrix[:, :, None] * covariance[None, :, :], axis=1)
    return jnp.sum(half[:, None, :] * matrix[None, :, :], axis=2)


def about_up(angle: Array) -> Array:
    """Return the quaternion of a turn about the vertical, rad."""
    zero = jnp.zeros_like(angle)
    return jnp.stack([jnp.cos(angle / 2), zero, zero, jnp.sin(angle / 2)])


def twist(q: Array) -> tuple[Array, Array]:
    """Return sine and cosine of half the turn about the vertical that comes nearest."""
    sign = jnp.where(q[0] < 0, -1, 1)
    some = q[0] ** 2 + q[3] ** 2 > 0
    return jnp.where(some, sign * q[3], 0), jnp.where(some, sign * q[0], 1)


__all__ = ["about_up", "turned", "twist"]
