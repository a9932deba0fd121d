"""Two IMUs on a rigid rod that is shaken: what they read."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.manifolds import quaternion as quat
from jaxest.types import Array, ArrayLike, Reading

GRAVITY = 9.80665  # m/s2


class Pair(NamedTuple):
    """One sample of two IMUs on one rigid link; any sensor may be missing at any step."""

    gyroscope_a: Reading
    """value (3,) rad/s, in frame A."""
    accelerometer_a: Reading
    """value (3,) m/s2, specific force in frame A."""
    gyroscope_p: Reading
    """value (3,) rad/s, in frame P."""
    accelerometer_p: Reading
    """value (3,) m/s2, specific force in frame P."""
    dt: ArrayLike
    """() s, time since the previous step."""


class Truth(NamedTuple):
    """What simulated measurements come from."""

    position: Array
    """(3,) m, of P in A."""
    quaternion: Array
    """(4,) wxyz, P to A."""
    rate: Array
    """(T, 3) rad/s, in A."""


def pair(gyroscope_a: Any, accelerometer_a: Any, gyroscope_p: Any, accelerometer_p: Any, *, dt: Any) -> Pair:
    """Bundle arrays into a measurement in which every sample is valid.

    Args:
        gyroscope_a: (..., 3) rad/s.
        accelerometer_a: (..., 3) m/s2.
        gyroscope_p: (..., 3) rad/s.
        accelerometer_p: (..., 3) m/s2.
        dt: () or (...) s.

    Returns:
        The measurement with the leading axes of `gyroscope_a`.
    """
    batch = np.shape(gyroscope_a)[:-1]
    there: Any = np.ones(batch, bool) if batch else np.True_
    dt = dt if np.shape(dt) == batch else np.broadcast_to(np.asarray(dt), batch)
    given = (gyroscope_a, accelerometer_a, gyroscope_p, accelerometer_p)
    a, b, c, d = (Reading(x, there) for x in given)
    return Pair(a, b, c, d, dt)


def simulate(
    params: Any,
    *,
    key: Array,
    steps: int = 4000,
    rate_hz: float = 100.0,
    length: float = 0.2,
    speed: float = 1.0,
    slowest: float = 0.5,
    fastest: float = 1.5,
    waves: int = 4,
    shaking: float = 1.0,
    gyroscope: float = 0.01,
    accelerometer: float = 0.05,
    bias: float = 0.0,
) -> tuple[Pair, Truth]:
    """Shake a rod with two IMUs, mounted anyhow, and read them.

    Args:
        params: the system's parameters; their dtype is that of the data.
        key: key of the whole draw.
        steps: number of samples T, static.
        rate_hz: samples per second.
        length: m, distance of the IMUs.
        speed: rad/s, rms of the rate about each axis, a sum of sines.
        slowest: Hz, lower end of the sines' frequencies, drawn uniformly.
        fastest: Hz, upper end.
        waves: sines per axis, static.
        shaking: m/s2, rms of A's acceleration along each of the earth's axes, of the same frequencies.
        gyroscope: rad/s, standard deviation of a sample's white noise.
        accelerometer: m/s2, likewise.
        bias: rad/s, standard deviation of each gyro's bias about each axis.

    Returns:
        Measurements with a leading axis of T, and the truth. Direction of the rod, mounting of P and the attitude at
        the start are drawn uniformly.

    Raises:
        ValueError: there are no steps.
    """
    if steps < 1:
        raise ValueError(f"steps: got {steps}, expected at least 1")
    dtype = jnp.result_type(*(jnp.asarray(x) for x in params))
    keys = jax.random.split(key, 8)
    time = jnp.arange(steps, dtype=dtype) / rate_hz
    span = (slowest, fastest, waves)
    rate, turn = _sines(keys[0], time, span, speed)
    acceleration, _ = _sines(keys[1], time, span, shaking)
    attitude = _attitudes(keys[2], keys[0], steps, rate_hz, span, speed, dtype)
    total = acceleration + jnp.asarray([[0, 0, GRAVITY]], dtype)
    force = jax.vmap(lambda q, f: quat.rotate(quat.inverse(q), f))(attitude, total)
    place = jax.random.normal(keys[3], (3,), dtype)
    place = length * place / jnp.sqrt(jnp.sum(place * place))
    mounting = quat.normalize(jax.random.normal(keys[4], (4,), dtype))
    arm = jnp.broadcast_to(place[None], rate.shape)
    there = force + jnp.cross(rate, jnp.cross(rate, arm)) + jnp.cross(turn, arm)
    seen = jax.vmap(lambda v: quat.rotate(quat.inverse(mounting), v))
    noise = jax.random.normal(keys[5], (4, steps, 3), dtype)
    offset = bias * jax.random.normal(keys[6], (2, 1, 3), dtype)
    readings = (
        rate + gyroscope * noise[0] + offset[0],
        force + accelerometer * noise[1],
        seen(rate) + gyroscope * noise[2] + offset[1],
        seen(there) + accelerometer * noise[3],
    )
    valid = jnp.ones(steps, bool)
    dt = jnp.full((steps,), 1 / rate_hz, dtype).at[0].set(0)
    gyro_a, acc_a, gyro_p, acc_p = (Reading(x, valid) for x in readings)
    return Pair(gyro_a, acc_a, gyro_p, acc_p, dt), Truth(place, mounting, rate)


def _sines(key: Array, time: Array, span: tuple[float, float, int], rms: float) -> tuple[Array, Array]:
    """Sums of sines (T, 3) of a given rms, and their derivatives."""
    slowest, fastest, waves = span
    drawn = jax.random.uniform(key, (3, waves, 3), time.dtype)
    frequency = 2 * np.pi * (slowest + (fastest - slowest) * drawn[0])
    phase, strength = 2 * np.pi * drawn[1], 0.3 + 0.7 * drawn[2]
    strength = rms * strength / jnp.sqrt(jnp.sum(strength**2, axis=0, keepdims=True) / 2)
    angle = frequency[None] * time[:, None, None] + phase[None]
    value = jnp.sum(strength[None] * jnp.sin(angle), axis=1)
    return value, jnp.sum((strength * frequency)[None] * jnp.cos(angle), axis=1)


def _attitudes(
    start: Array, key: Array, steps: int, rate_hz: float, span: tuple[float, float, int], speed: float, dtype: Any
) -> Array:
    """Attitudes (T, 4) that the rates lead through, by four steps to a sample of the rate at their middle."""
    finer = 4
    middle = (jnp.arange(steps * finer, dtype=dtype) + 0.5) / (rate_hz * finer)
    rate, _ = _sines(key, middle, span, speed)
    turns = jax.vmap(quat.exp)(rate / (rate_hz * finer)).reshape(steps, finer, 4)

    def body(q: Array, turn: Array) -> tuple[Array, Array]:
        after = q
        for i in range(finer):
            after = quat.compose(after, turn[i])
        return quat.normalize(after), q

    first = quat.normalize(jax.random.normal(start, (4,), dtype))
    return jax.lax.scan(body, first, turns)[1]


__all__ = ["GRAVITY", "Pair", "Truth", "pair", "simulate"]
