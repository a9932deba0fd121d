"""Rest detection: an IMU is at rest when gyroscope and accelerometer have stayed near their own mean for a while.

Source: Laidig, Seel 2023 (VQF), section 3.6, from which the thresholds come.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxest.filters.attitude.vectors import length
from jaxest.filters.imu import Sample
from jaxest.types import Array, ArrayLike


class Rest(NamedTuple):
    """When an IMU counts as resting."""

    rate: ArrayLike = 0.035
    """() rad/s, largest deviation of the rate from its mean, and largest mean: 2 deg/s."""
    force: ArrayLike = 0.5
    """() m/s^2, largest deviation of the specific force from its mean."""
    time: ArrayLike = 1.5
    """() s, how long both must have held."""
    memory: ArrayLike = 0.5
    """() s, time constant of the means."""


class Stillness(NamedTuple):
    """What rest detection remembers."""

    rate: Array
    """(3,) rad/s, mean rate."""
    force: Array
    """(3,) m/s^2, mean specific force."""
    time: Array
    """() s, how long the IMU has been still."""
    started: Array
    """(2,) bool, whether the means of rate and force hold anything."""


def begin(dtype: Any) -> Stillness:
    """Return the memory that has seen no data."""
    zero = jnp.zeros(3, dtype)
    return Stillness(zero, zero, jnp.zeros((), dtype), jnp.zeros(2, bool))


def watch(rest: Rest, memory: Stillness, sample: Sample) -> Stillness:
    """Take in a sample.

    Args:
        rest: thresholds.
        memory: as `begin` or the previous call returned it.
        sample: values and flags. A missing reading changes nothing.

    Returns:
        The memory; the IMU is at rest where `time` is at least `rest.time`.
    """
    share = 1 - jnp.exp(-sample.dt / rest.memory)

    def mean(old: Array, reading: Any, started: Array) -> Array:
        moved = jnp.where(started, old + share * (reading.value - old), reading.value)
        return jnp.where(reading.valid, moved, old)

    rate = mean(memory.rate, sample.gyroscope, memory.started[0])
    force = mean(memory.force, sample.accelerometer, memory.started[1])
    turning = (length(sample.gyroscope.value - rate) > rest.rate) | (length(rate) > rest.rate)
    moving = length(sample.accelerometer.value - force) > rest.force
    disturbed = (sample.gyroscope.valid & turning) | (sample.accelerometer.valid & moving)
    seen = sample.gyroscope.valid & jnp.any(memory.started[1] | sample.accelerometer.valid)
    still = jnp.where(disturbed, 0, memory.time + jnp.where(seen, sample.dt, 0))
    started = memory.started | jnp.stack([sample.gyroscope.valid, sample.accelerometer.valid])
    return Stillness(rate, force, still, started)


__all__ = ["Rest", "Stillness", "begin", "watch"]
