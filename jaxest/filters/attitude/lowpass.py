"""Second-order Butterworth low-pass for samples at any times, with a start that is a plain mean."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxest.types import Array, ArrayLike


class Lowpass(NamedTuple):
    """What the filter remembers of n channels."""

    value: Array
    """(n,) filtered."""
    slope: Array
    """(n,) 1/s, its derivative."""
    time: Array
    """() s, for how long there have been samples."""


def begin(channels: int, dtype: Any) -> Lowpass:
    """Return the memory of no sample."""
    zero = jnp.zeros(channels, dtype)
    return Lowpass(zero, zero, jnp.zeros((), dtype))


def lowpass(memory: Lowpass, sample: Array, dt: ArrayLike, tau: ArrayLike) -> Lowpass:
    """Take in a sample.

    The first one is taken as it is; for the next `tau` seconds the value is the mean so far; then follow the poles
    (-1 +- i) / tau of Butterworth's filter with a cutoff of sqrt(2) / tau, which between samples is solved exactly.

    Args:
        memory: as `begin` or the previous call returned it.
        sample: (n,) values since the previous sample.
        dt: () s, time since then.
        tau: () s.

    Returns:
        The memory, whose `value` is the filtered one.
    """
    value, slope, time = memory
    after = time + dt
    mean = value + jnp.where(after > 0, dt / jnp.where(after > 0, after, 1), 1) * (sample - value)
    mean = jnp.where(time > 0, mean, sample)
    turn = dt / tau
    decay, cosine, sine = jnp.exp(-turn), jnp.cos(turn), jnp.sin(turn)
    off = value - sample
    moved = sample + decay * (off * (cosine + sine) + slope * tau * sine)
    sloped = decay * (slope * (cosine - sine) - 2 * off / tau * sine)
    starting = time < tau
    return Lowpass(jnp.where(starting, mean, moved), jnp.where(starting, 0, sloped), after)


__all__ = ["Lowpass", "begin", "lowpass"]
