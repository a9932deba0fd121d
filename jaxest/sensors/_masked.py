"""What all sensors do with a reading that may be missing."""

from typing import Any

import jax.numpy as jnp

from jaxest.types import Array, Reading


def shown(reading: Reading, like: Array) -> tuple[Array, Array]:
    """Return a reading's value, 0 where it is missing, and the mask broadcast to its shape.

    A missing value may be anything; NaN never reaches arithmetic.

    Args:
        reading: value (...) and valid, () or along the value's leading axes.
        like: gives the dtype.
    """
    value = jnp.asarray(reading.value, like.dtype)
    valid = jnp.asarray(reading.valid, bool)
    wide = jnp.broadcast_to(valid.reshape(valid.shape + (1,) * (value.ndim - valid.ndim)), value.shape)
    return jnp.where(wide, value, 0), wide


def only(valid: Any, value: Array) -> Array:
    """Return the value where it is valid and exactly 0 elsewhere; a mask () serves a whole value."""
    valid = jnp.asarray(valid, bool)
    valid = valid.reshape(valid.shape + (1,) * (value.ndim - valid.ndim))
    return jnp.where(jnp.broadcast_to(valid, value.shape), value, 0)
