"""What attitude filters make of the vectors that an IMU sees; each has a derivative where the vector is zero."""

import jax.numpy as jnp

from jaxest.filters.imu import direction
from jaxest.manifolds import quaternion as quat
from jaxest.types import Array


def length(vector: Array) -> Array:
    """Return the length () of a vector (n,), with the derivative zero at zero."""
    square = jnp.sum(vector * vector)
    there = square > 0
    return jnp.where(there, jnp.sqrt(jnp.where(there, square, 1)), 0)


def levelled(accelerometer: Array) -> Array:
    """Return the quaternion (4,) that turns a specific force (3,) upright by the shortest way."""
    return quat.from_two_vectors(direction(accelerometer), jnp.array([0, 0, 1], accelerometer.dtype))


def northward(field: Array) -> Array:
    """Return the rotation (4,) about the vertical that brings a field (3,) into the north-up plane (y north)."""
    flat = direction(field[:2])
    there = jnp.any(flat != 0)
    up = jnp.zeros_like(flat[:1])
    along = jnp.where(there, jnp.concatenate([flat, up]), jnp.array([0, 1, 0], field.dtype))
    return quat.from_two_vectors(along, jnp.array([0, 1, 0], field.dtype))


__all__ = ["length", "levelled", "northward"]
