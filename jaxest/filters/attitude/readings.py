"""What an IMU sample offers to a filter: finite values, which of them are there, and whether any was broken."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxest.filters.complementary import Imu
from jaxest.manifolds import quaternion as quat
from jaxest.types import NON_FINITE, OK, Array, Reading


class Sample(NamedTuple):
    """The usable part of a measurement."""

    gyroscope: Reading
    """value (3,) rad/s, 0 where missing."""
    accelerometer: Reading
    """value (3,) m/s^2, 0 where missing; the zero vector (free fall) counts as missing."""
    magnetometer: Reading
    """value (3,) any unit, 0 where missing; the zero vector counts as missing."""
    dt: Array
    """() s, 0 where not finite."""
    status: Array
    """() int32, `NON_FINITE` where a valid value was not finite, else `OK`."""


def usable(measurement: Imu, dtype: Any) -> Sample:
    """Split a measurement into finite values and flags, so that what is missing can add exactly nothing.

    Args:
        measurement: one sample.
        dtype: floating type of the values.

    Returns:
        The sample.

    Raises:
        ValueError: a sensor's value is not (3,), or `valid` or `dt` is not a scalar.
    """
    dt = _shaped("dt", measurement.dt, (), dtype)
    timed = jnp.isfinite(dt)
    dt = jnp.where(timed, dt, 0)
    found, bad = [], [~timed]
    for name in ("gyroscope", "accelerometer", "magnetometer"):
        reading = getattr(measurement, name)
        if reading is None:
            found.append(Reading(jnp.zeros(3, dtype), jnp.zeros((), bool)))
            continue
        value, valid = _shaped(name, reading.value, (3,), dtype), _shaped(f"{name}.valid", reading.valid, (), bool)
        square = jnp.sum(value * value)
        # A square that overflows is of no use either, nor a rate whose turn over the step has one.
        finite = jnp.isfinite(16 * square * dt * dt if name == "gyroscope" else square)
        bad.append(valid & ~finite)
        there = valid & finite & ((square > 0) | (name == "gyroscope"))
        found.append(Reading(jnp.where(there, value, 0), there))
    gyro, acc, mag = found
    return Sample(gyro, acc, mag, dt, jnp.where(jnp.any(jnp.stack(bad)), NON_FINITE, OK).astype(jnp.int32))


def direction(vector: Array) -> Array:
    """Return the unit vector (n,) along a vector (n,), zero for zero."""
    square = jnp.sum(vector * vector)
    there = square > 0
    return jnp.where(there, vector, 0) / jnp.sqrt(jnp.where(there, square, 1))


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


def _shaped(name: str, value: Any, shape: tuple[int, ...], dtype: Any) -> Array:
    array = jnp.asarray(value, dtype)
    if array.shape != shape:
        raise ValueError(f"measurement.{name}: got shape {array.shape}, expected {shape}; vmap or run adds other axes")
    return array


__all__ = ["Sample", "direction", "length", "levelled", "northward", "usable"]
