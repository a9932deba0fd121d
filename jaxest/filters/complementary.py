"""Passive complementary filter: the orientation of one IMU, with or without a magnetometer.

A resting accelerometer reads specific force, +1 g along the earth's up; gyro rates are about the sensor's axes. The
earth frame has z up; with a magnetometer it is ENU (x east, y magnetic north), without one its heading is the sensor's
own at the first sample. The state's quaternion leads from the sensor to the earth frame.

Source: Santaera 2015, Algorithm 1, after Mahony, Hamel, Pflimlin 2008; the integrator integrates with dt.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxest.filters._state import apart
from jaxest.filters.imu import Imu, Sample, directed, direction, imu, usable
from jaxest.manifolds import quaternion as quat
from jaxest.types import Array, ArrayLike


class Params(NamedTuple):
    """What may be tuned; any leaf may be batched or differentiated."""

    proportional_gain: ArrayLike = 0.74
    """() 1/s, K_p: how fast the attitude follows the vectors."""
    integral_gain: ArrayLike = 0.0012
    """() 1/s^2, K_i: how fast the gyro bias follows."""
    lambda_acc: ArrayLike = 1.0
    """() weight of the accelerometer's direction, without unit."""
    lambda_mag: ArrayLike = 1.0
    """() weight of the magnetometer's direction, without unit."""


class State(NamedTuple):
    """What the next step needs."""

    quaternion: Array
    """(4,) wxyz, sensor to earth."""
    bias: Array
    """(3,) rad/s, gyro bias; minus the integral of Algorithm 1."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""
    initialized: Array
    """() bool, whether an accelerometer sample has set the inclination."""
    heading_initialized: Array
    """() bool, whether a magnetometer sample has set the heading."""


class Info(NamedTuple):
    """The estimate of one step and how it came about."""

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
    """() int32, `OK` or `NON_FINITE`; see `jaxest.types.status_message`."""


def init(params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen no data; the first valid accelerometer sample sets the inclination.

    Args:
        params: the filter's parameters; their dtype (a Python float's is JAX's default) becomes that of the state, in
            which every step computes.
        key: not used.

    Returns:
        The state with index 0. In a live loop, parameters on the device (`jax.device_put(params)`) save a quarter of
        a step's time over Python floats.
    """
    dtype = jnp.result_type(*params)
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    no = jnp.zeros((), bool)
    return apart(State(quat.identity(dtype), jnp.zeros(3, dtype), jnp.zeros((), jnp.int32), no, no))


def exponential(quaternion: Array, rate: Array, dt: Array) -> Array:
    """Turn by a constant rate, exactly.

    Args:
        quaternion: (4,) wxyz, sensor to earth.
        rate: (3,) rad/s, in the sensor frame.
        dt: () s.

    Returns:
        (4,) wxyz, `quaternion * exp(rate dt)`.
    """
    return quat.retract(quaternion, rate * dt)


def projection(quaternion: Array, rate: Array, dt: Array) -> Array:
    """Turn by the paper's first-order step, then project onto the rotations.

    The rotation nearest to R + R [rate dt]x is R times the orthogonal polar factor of I + [rate dt]x: the turn about
    `rate` by atan(|rate| dt). That is what the singular value decomposition gives, without its gradient, which is
    undefined here because two of the singular values are equal.

    Args:
        quaternion: (4,) wxyz, sensor to earth.
        rate: (3,) rad/s, in the sensor frame.
        dt: () s.

    Returns:
        (4,) wxyz.

    Source: Santaera 2015, Algorithm 1, steps 11 and 12, eqs. 14 and 15.
    """
    turn = rate * dt
    cosine = 1 / jnp.sqrt(1 + jnp.sum(turn * turn))
    half = jnp.sqrt((1 + cosine) / 2)
    return quat.normalize(quat.compose(quaternion, jnp.concatenate([half[None], turn * cosine / (2 * half)])))


def step(
    params: Params, state: State, measurement: Imu, *, key: Array | None = None, update: Any = exponential
) -> tuple[State, Info]:
    """Take in one sample.

    The magnetic reference is the measured field itself, turned about the vertical into the north-up plane, so that it
    speaks of the heading alone. What is masked or not finite adds exactly nothing; a missing gyro sample counts as no
    rotation. The first accelerometer sample sets the inclination, the first magnetometer sample the heading. As in the
    paper a sample is compared with the attitude one step earlier; predicting first is no better on real recordings.

    Args:
        params: gains and weights.
        state: as `init` or the previous step returned it; its dtype is that of the computation.
        measurement: one sample.
        key: not used.
        update: `exponential` or `projection`, static.

    Returns:
        The next state and the info.

    Raises:
        ValueError: a sensor's value is not (3,), or `valid` or `dt` is not a scalar.

    Source: Santaera 2015, Algorithm 1 (I_n = -bias), step 8 with dt in place of 1/dt; Mahony 2008, eqs. 32 and 48.
    """
    dtype = state.quaternion.dtype
    k_p, k_i, lambda_acc, lambda_mag = (jnp.asarray(x, dtype) for x in params)
    sample = directed(usable(measurement, dtype))
    error_acc, error_mag = _errors(state, sample)
    error = lambda_acc * error_acc + lambda_mag * error_mag
    bias = state.bias - k_i * error * sample.dt
    rate = jnp.where(sample.gyroscope.valid, sample.gyroscope.value - bias, 0) + k_p * error
    moved = update(state.quaternion, rate, sample.dt)
    quaternion, initialized, heading_initialized = _initialize(state, moved, sample)
    valid = initialized if measurement.magnetometer is None else initialized & heading_initialized
    next_state = State(quaternion, bias, state.index + 1, initialized, heading_initialized)
    return next_state, Info(quaternion, bias, error_acc, error_mag, valid, sample.status)


def _errors(state: State, sample: Sample) -> tuple[Array, Array]:
    """Innovations in the sensor frame, measured x predicted (steps 3 to 6)."""
    acc, mag = sample.accelerometer, sample.magnetometer
    back = quat.inverse(state.quaternion)
    up = quat.rotate(back, jnp.array([0, 0, 1], sample.dt.dtype))
    error_acc = jnp.cross(acc.value, up)
    field = quat.rotate(state.quaternion, mag.value)
    square = field[0] * field[0] + field[1] * field[1]
    there = square > 0
    north = jnp.where(there, jnp.sqrt(jnp.where(there, square, 1)), 0)
    reference = jnp.stack([jnp.zeros_like(north), north, field[2]])
    error_mag = jnp.cross(mag.value, quat.rotate(back, reference))
    return (
        jnp.where(state.initialized & acc.valid, error_acc, 0),
        jnp.where(state.initialized & state.heading_initialized & mag.valid, error_mag, 0),
    )


def _initialize(state: State, moved: Array, sample: Sample) -> tuple[Array, Array, Array]:
    """The next quaternion, set by the first samples of the vector sensors instead of moved."""
    acc, mag = sample.accelerometer, sample.magnetometer
    level = quat.from_two_vectors(acc.value, jnp.array([0, 0, 1], moved.dtype))
    initialized = state.initialized | acc.valid
    quaternion = jnp.where(state.initialized, moved, jnp.where(acc.valid, level, state.quaternion))
    east, north, _ = quat.rotate(quaternion, mag.value)
    horizontal = direction(jnp.stack([east, north, jnp.zeros_like(east)]))
    heading = quat.from_two_vectors(horizontal, jnp.array([0, 1, 0], moved.dtype))
    first = ~state.heading_initialized & initialized & mag.valid & jnp.any(horizontal != 0)
    quaternion = jnp.where(first, quat.compose(heading, quaternion), quaternion)
    return quaternion, initialized, state.heading_initialized | first


__all__ = [
    "Imu",
    "Info",
    "Params",
    "State",
    "exponential",
    "imu",
    "init",
    "projection",
    "step",
]
