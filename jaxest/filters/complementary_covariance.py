"""How well the complementary filter knows its orientation: the covariance of its own linearised error.

The filter's gains are fixed, so its covariance does not steer it; it is what those gains, the masks that occurred and
the noise make of the error. With `R_true = R exp(theta)` and `bias_true = bias + beta` a step turns theta against the
motion and adds `-(beta + K_p sum_i lambda_i H_i theta + noise) dt`, and adds `K_i sum_i lambda_i H_i theta dt` to
beta, where H is `1 - u u'` for the accelerometer (u: the predicted up) and `w w'` for the magnetometer (w: normal to
the field in the north-up plane). No direction that no sensor sees is ever corrected: without a magnetometer the
variance of the heading grows.

Noise is given as a density, so that the sampling rate does not matter. Motion is not white: an accelerometer that is
moved about is wrong for as long as the movement lasts. A disturbance of standard deviation s and correlation time T
acts on a slow filter like white noise of density `s sqrt(2 T)`, and that is the number to give.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxest.filters import complementary
from jaxest.filters._state import finite
from jaxest.filters.imu import Imu, Sample, directed, usable
from jaxest.manifolds import quaternion as quat
from jaxest.types import OUT_OF_RANGE, Array, ArrayLike, Step


class Noise(NamedTuple):
    """Effective noise of an IMU in motion; the defaults are those of a consumer-grade sensor indoors."""

    gyroscope: ArrayLike = 2e-4
    """() rad/s/sqrt(Hz), density of the rate noise."""
    scale: ArrayLike = 0.01
    """() without unit, error of the gyro's scale and axes: a rate w is wrong by `scale * w` for `motion_time`."""
    bias_walk: ArrayLike = 2e-5
    """() rad/s/sqrt(s), walk of the gyro bias: 0.01 deg/s in a minute."""
    accelerometer: ArrayLike = 0.01
    """() 1/sqrt(Hz), density of the noise of the specific force's direction at rest, as a fraction of g: 10 mg of bias
    or of a sway that leaves the norm alone, for half a second."""
    motion_time: ArrayLike = 0.1
    """() s, correlation time of movements: for so long the direction is wrong by as much as the norm is off g."""
    magnetometer: ArrayLike = 0.05
    """() 1/sqrt(Hz), density of the noise of the field's direction, as a fraction of the field: 5 % of it for
    half a second. A magnet that moves with the sensor is a bias that no density covers."""
    unseen_rotation: ArrayLike = 1.0
    """() rad/s/sqrt(Hz), density of the rotation that a missing gyro sample hides."""
    initial_inclination: ArrayLike = 0.03
    """() rad, standard deviation about each horizontal axis after the first accelerometer sample."""
    initial_heading: ArrayLike = 0.1
    """() rad, standard deviation of the heading after the first magnetometer sample."""
    initial_bias: ArrayLike = 0.005
    """() rad/s, standard deviation of the gyro bias about each axis before any data: 0.3 deg/s."""
    gravity: ArrayLike = 9.81
    """() m/s^2, norm of the specific force at rest."""


class Params(NamedTuple):
    """The filter's parameters and the noise it is judged by."""

    filter: complementary.Params = complementary.Params()
    noise: Noise = Noise()


class State(NamedTuple):
    """The filter's state and the covariance of its error."""

    filter: complementary.State
    covariance: Array
    """(6, 6) of [attitude in the sensor frame (rad), gyro bias (rad/s)]."""

    @property
    def index(self) -> Array:  # type: ignore[override]  # the contract's name hides a method of tuple
        """() int32, steps seen."""
        return self.filter.index


class Info(NamedTuple):
    """`complementary.Info` with the covariance of the orientation."""

    quaternion: Array
    """(4,) wxyz, sensor to earth, at this sample."""
    bias: Array
    """(3,) rad/s, gyro bias."""
    error_acc: Array
    """(3,) innovation of the accelerometer, sine of an angle about the sensor's axes; 0 where not used."""
    error_mag: Array
    """(3,) innovation of the magnetometer, likewise; 0 where not used."""
    valid: Array
    """() bool, whether each vector sensor has set its part of the orientation yet."""
    status: Array
    """() int32, `OK`, `NON_FINITE`, or `OUT_OF_RANGE` (covariance as before); see `jaxest.types.status_message`."""
    covariance: Array
    """(3, 3) rad^2 of theta in `truth = quaternion * exp(theta)`. Without a magnetometer the heading counts from the
    first sample on, whose heading defines the earth frame; before the first samples nothing is known: pi^2 / 3."""


def init(params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen no data.

    Args:
        params: parameters; the filter's dtype becomes that of the state.
        key: not used.

    Returns:
        The state with index 0: attitude unknown, bias as `Noise.initial_bias` says.
    """
    state = complementary.init(params.filter)
    unknown = jnp.full(3, jnp.pi**2 / 3, state.bias.dtype)
    bias = jnp.broadcast_to(jnp.asarray(params.noise.initial_bias, state.bias.dtype) ** 2, (3,))
    return State(state, jnp.diag(jnp.concatenate([unknown, bias])))


@functools.cache  # a new object at every call would have `run` compile again
def with_covariance(step: Step = complementary.step) -> Step:
    """Return a step that carries the covariance of the filter's error beside the filter.

    Args:
        step: `complementary.step`, with whichever update.

    Returns:
        `(Params, State, Imu) -> (State, Info)` of this module; the estimates are those of `step`.
    """

    def stepped(params: Params, state: State, measurement: Imu, *, key: Array | None = None) -> tuple[State, Info]:
        after, info = step(params.filter, state.filter, measurement, key=key)
        dtype = state.covariance.dtype
        noise = Noise._make(jnp.asarray(x, dtype) for x in params.noise)
        moved = _propagate(params.filter, noise, state, measurement)
        covariance = _initialize(noise, state.filter, after, moved, seen=measurement.magnetometer is not None)
        fits = finite(covariance)
        covariance = jnp.where(fits, covariance, state.covariance)
        info = info._replace(status=jnp.where(fits, info.status, OUT_OF_RANGE))
        return State(after, covariance), Info._make([*info, covariance[:3, :3]])

    return stepped


def _propagate(params: complementary.Params, noise: Any, state: State, measurement: Imu) -> Array:
    """One step of the linearised error dynamics; a sum of squares, so it stays positive without further care."""
    dtype = state.covariance.dtype
    k_p, k_i, lambda_acc, lambda_mag = (jnp.asarray(x, dtype) for x in params)
    sample = directed(usable(measurement, dtype))
    gyro = sample.gyroscope
    dt, one = sample.dt, jnp.eye(3, dtype=dtype)
    level, across = _observed(state.filter, sample)
    seen = lambda_acc * level + lambda_mag * across
    shaken = _movement(noise, measurement, sample.accelerometer.valid, dtype)
    inflow = lambda_acc**2 * (noise.accelerometer**2 + shaken) * level + lambda_mag**2 * noise.magnetometer**2 * across
    rate = jnp.where(gyro.valid, gyro.value - state.filter.bias, 0)
    wrong = noise.gyroscope**2 * one + 2 * noise.motion_time * noise.scale**2 * jnp.sum(rate * rate) * one
    wrong = jnp.where(gyro.valid, wrong, noise.unseen_rotation**2 * one)
    back = quat.to_matrix(quat.exp(-rate * dt))
    transition = jnp.block([[back - k_p * dt * seen, -dt * jnp.where(gyro.valid, one, 0)], [k_i * dt * seen, one]])
    driven = jnp.block(
        [
            [wrong + k_p * k_p * inflow, -k_p * k_i * inflow],
            [-k_p * k_i * inflow, k_i * k_i * inflow + noise.bias_walk**2 * one],
        ]
    )
    covariance = _product(_product(transition, state.covariance), transition.T) + dt * driven
    return jnp.where(state.filter.initialized, (covariance + covariance.T) / 2, state.covariance)


def _observed(state: complementary.State, sample: Sample) -> tuple[Array, Array]:
    """The matrices H of accelerometer and magnetometer in the sensor frame, zero where the filter did not use them."""
    back = quat.inverse(state.quaternion)
    up = quat.rotate(back, jnp.array([0, 0, 1], sample.dt.dtype))
    east, north, high = quat.rotate(state.quaternion, sample.magnetometer.value)
    horizontal = east * east + north * north
    length = jnp.sqrt(jnp.where(horizontal > 0, horizontal, 1))
    normal = quat.rotate(back, jnp.stack([jnp.zeros_like(high), -high, jnp.where(horizontal > 0, length, 0)]))
    level = jnp.eye(3, dtype=up.dtype) - jnp.outer(up, up)
    return (
        jnp.where(sample.accelerometer.valid, level, 0),
        jnp.where(sample.magnetometer.valid & state.heading_initialized, jnp.outer(normal, normal), 0),
    )


def _movement(noise: Any, measurement: Imu, used: Array, dtype: Any) -> Array:
    """Squared density that movement adds to the direction of the specific force: 2 T (||a| - g| / max(|a|, g))^2."""
    force = jnp.where(used, jnp.asarray(measurement.accelerometer.value, dtype), jnp.ones(3, dtype))
    norm = jnp.sqrt(jnp.sum(force * force))
    excess = jnp.where(used, (norm - noise.gravity) / jnp.maximum(norm, noise.gravity), 0)
    return 2 * noise.motion_time * excess * excess


def _initialize(
    noise: Any, before: complementary.State, after: complementary.State, moved: Array, *, seen: bool
) -> Array:
    """Replace what the first samples of the vector sensors have set."""
    dtype = moved.dtype
    up = quat.rotate(quat.inverse(after.quaternion), jnp.array([0, 0, 1], dtype))
    vertical = jnp.outer(up, up)
    level = jnp.eye(3, dtype=dtype) - vertical
    unknown = jnp.asarray(jnp.pi**2 / 3 if seen else 0, dtype)  # without a magnetometer the first heading is the zero
    heading = jnp.where(after.heading_initialized, noise.initial_heading**2, unknown)
    start = noise.initial_inclination**2 * level + heading * vertical
    keep = jnp.where(before.initialized, level, jnp.zeros_like(level))
    fresh = jnp.where(before.initialized, heading * vertical, start)
    keep6 = jnp.block([[keep, jnp.zeros_like(keep)], [jnp.zeros_like(keep), jnp.eye(3, dtype=dtype)]])
    reset = _product(_product(keep6, moved), keep6.T) + jnp.pad(fresh, (0, 3))
    now = (after.initialized & ~before.initialized) | (after.heading_initialized & ~before.heading_initialized)
    return jnp.where(now, reset, moved)


def _product(a: Array, b: Array) -> Array:
    """Matrix product as a sum: twice as fast as `dot` in batches, and not rounded to 10 bits on a GPU."""
    return jnp.sum(a[:, :, None] * b[None, :, :], axis=1)


__all__ = ["Info", "Noise", "Params", "State", "init", "with_covariance"]
