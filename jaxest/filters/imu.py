"""One sample of an IMU as every filter of one takes it, and what of it may be used."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.filters._time import elapsed
from jaxest.types import NON_FINITE, OK, Array, ArrayLike, Reading


class Imu(NamedTuple):
    """One sample of an IMU; any sensor may be missing at any step."""

    gyroscope: Reading
    """value (3,) rad/s, in the sensor frame."""
    accelerometer: Reading
    """value (3,) m/s^2, specific force in the sensor frame."""
    magnetometer: Reading | None
    """value (3,) in the sensor frame, any unit (only its direction counts); None if there is no such sensor."""
    dt: ArrayLike
    """() s, time since the previous step."""


class Sample(NamedTuple):
    """The usable part of a measurement."""

    gyroscope: Reading
    """value (3,) rad/s, 0 where missing."""
    accelerometer: Reading
    """value (3,) m/s^2, 0 where missing; the zero vector (free fall) counts as missing."""
    magnetometer: Reading
    """value (3,) any unit, 0 where missing; the zero vector counts as missing."""
    dt: Array
    """() s, 0 where negative or not finite: nothing is used then."""
    status: Array
    """() int32, `NON_FINITE` where a valid value was not finite or time ran backwards, else `OK`."""


def imu(gyroscope: Any, accelerometer: Any, magnetometer: Any = None, *, dt: Any) -> Imu:
    """Bundle arrays into a measurement in which every sample is valid.

    Args:
        gyroscope: (..., 3) rad/s.
        accelerometer: (..., 3) m/s^2.
        magnetometer: (..., 3) any unit, or None.
        dt: () or (...) s, time since the previous sample.

    Returns:
        The measurement with the leading axes of `gyroscope`.
    """
    batch = np.shape(gyroscope)[:-1]
    there: Any = np.ones(batch, bool) if batch else np.True_  # a scalar reaches the device sooner
    field = None if magnetometer is None else Reading(magnetometer, there)
    dt = dt if np.shape(dt) == batch else np.broadcast_to(np.asarray(dt), batch)
    return Imu(Reading(gyroscope, there), Reading(accelerometer, there), field, dt)


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
    dt, timely = elapsed(dt)
    found, bad = [], [~timely]
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
        there = timely & valid & finite & ((square > 0) | (name == "gyroscope"))
        found.append(Reading(jnp.where(there, value, 0), there))
    gyro, acc, mag = found
    return Sample(gyro, acc, mag, dt, jnp.where(jnp.any(jnp.stack(bad)), NON_FINITE, OK).astype(jnp.int32))


def directed(sample: Sample) -> Sample:
    """Return the sample with unit vectors of the accelerometer and the magnetometer, 0 where missing."""
    acc, mag = (x._replace(value=direction(x.value)) for x in (sample.accelerometer, sample.magnetometer))
    return sample._replace(accelerometer=acc, magnetometer=mag)


def direction(vector: Array) -> Array:
    """Return the unit vector (n,) along a vector (n,), zero for zero."""
    square = jnp.sum(vector * vector)
    there = square > 0
    return jnp.where(there, vector, 0) / jnp.sqrt(jnp.where(there, square, 1))


def _shaped(name: str, value: Any, shape: tuple[int, ...], dtype: Any) -> Array:
    array = jnp.asarray(value, dtype)
    if array.shape != shape:
        raise ValueError(f"measurement.{name}: got shape {array.shape}, expected {shape}; vmap or run adds other axes")
    return array


__all__ = ["Imu", "Sample", "directed", "direction", "imu", "usable"]
