"""Noise with a memory, and what a real three-axis sensor makes of a true signal."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.types import Array, ArrayLike


class Triad(NamedTuple):
    """How bad a three-axis sensor is; all zero (and no limit) is a perfect one. `u` is the sensor's SI unit."""

    density: ArrayLike = 0.0
    """() u/sqrt(Hz), two-sided density of the white noise: a sample's deviation is density * sqrt(rate). A data
    sheet's one-sided figure is sqrt(2) times this."""
    bias: ArrayLike = 0.0
    """() u, standard deviation of each axis' bias at the start."""
    walk: ArrayLike = 0.0
    """() u/sqrt(s), growth of the bias' standard deviation with the square root of time."""
    scale: ArrayLike = 0.0
    """() standard deviation of each axis' relative scale error."""
    misalignment: ArrayLike = 0.0
    """() rad, standard deviation of the angle between an axis and where it should be, about either other axis."""
    limit: ArrayLike = np.inf
    """() u, readings saturate at plus and minus this."""
    resolution: ArrayLike = 0.0
    """() u, step of the analogue-to-digital converter; 0 for none."""


class Faults(NamedTuple):
    """What was drawn: reading = matrix @ value + bias + white noise, then saturated and rounded."""

    matrix: Array
    """(3, 3) scale and misalignment."""
    bias: Array
    """(T, 3) u."""


def coloured(key: Array, steps: int, size: int, dt: ArrayLike, time: ArrayLike, dtype: Any) -> Array:
    """Draw noise of unit variance whose correlation falls off exponentially, the same from the first sample on.

    Args:
        key: random key.
        steps: T, samples.
        size: n, independent signals.
        dt: () s, between samples.
        time: () s, after which the correlation has fallen to 1 / e.
        dtype: of the noise.

    Returns:
        (T, n).
    """
    decay = jnp.exp(-jnp.asarray(dt, dtype) / jnp.asarray(time, dtype))
    drawn = jax.random.normal(key, (steps, size), dtype)

    def body(value: Array, fresh: Array) -> tuple[Array, Array]:
        value = decay * value + jnp.sqrt(1 - decay * decay) * fresh
        return value, value

    return jnp.concatenate([drawn[:1], jax.lax.scan(body, drawn[0], drawn[1:])[1]])


def corrupt(key: Array, triad: Triad, value: Array, dt: Array) -> tuple[Array, Faults]:
    """Turn a true signal into readings.

    Args:
        key: random key.
        triad: how bad the sensor is.
        value: (T, 3) u, the true signal in the sensor's frame.
        dt: (T,) s, time since the sample before; the first is 0.

    Returns:
        The readings (T, 3), and what they suffer from.
    """
    dtype = value.dtype
    density, bias, walk, scale, misalignment, limit, resolution = (jnp.asarray(x, dtype) for x in triad)
    keys = jax.random.split(key, 5)
    gain = scale * jax.random.normal(keys[0], (3,), dtype)
    tilt = misalignment * jax.random.normal(keys[1], (3, 3), dtype)
    matrix = jnp.eye(3, dtype=dtype) + jnp.diag(gain) + tilt * (1 - jnp.eye(3, dtype=dtype))
    steps = jnp.sqrt(dt)[:, None] * jax.random.normal(keys[2], value.shape, dtype)
    offset = bias * jax.random.normal(keys[3], (1, 3), dtype) + walk * jnp.cumsum(steps, axis=0)
    # A sample's noise is averaged over the interval before it; the first interval is taken to be the second.
    interval = jnp.where(dt > 0, dt, jnp.roll(dt, -1))
    hiss = density / jnp.sqrt(jnp.where(interval > 0, interval, 1))[:, None]
    reading = value @ matrix.T + offset + hiss * jax.random.normal(keys[4], value.shape, dtype)
    step = jnp.where(resolution > 0, resolution, 1)
    reading = jnp.where(resolution > 0, jnp.round(reading / step) * step, reading)
    return jnp.clip(reading, -limit, limit), Faults(matrix, offset)


__all__ = ["Faults", "Triad", "coloured", "corrupt"]
