"""Parameters, state and info of the filter `decoupled`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters._state import apart
from jaxest.filters.attitude import lowpass as low
from jaxest.filters.attitude import rest as resting
from jaxest.manifolds import quaternion as quat
from jaxest.types import Array, ArrayLike


class Params(NamedTuple):
    """Time constants and noise; one setting for people, robots and tools indoors."""

    tau: ArrayLike = 3.0
    """() s, time constant of the inclination."""
    bias_motion: ArrayLike = 1.75e-3
    """() rad/s, standard deviation of the gyro bias that movements leave: 0.1 deg/s."""
    bias_rest: ArrayLike = 5e-4
    """() rad/s, standard deviation of the gyro bias that rest leaves: 0.03 deg/s."""
    bias_walk: ArrayLike = 1.75e-4
    """() rad/s/sqrt(s), walk of the gyro bias: 0.1 deg/s in 100 s."""
    initial_bias: ArrayLike = 0.01
    """() rad/s, standard deviation of the gyro bias about each axis before any data: 0.6 deg/s."""
    misalignment: ArrayLike = 0.005
    """() without unit, error of the gyro's scale and axes: a fraction of the rate, for `turn_time`."""
    turn_time: ArrayLike = 0.1
    """() s, correlation time of turns."""
    field: ArrayLike = 0.07
    """() standard deviation of each component of the magnetometer's readings, as a fraction of the field: rooms."""
    field_time: ArrayLike = 1.0
    """() s, correlation time of that."""
    field_walk: ArrayLike = 0.001
    """() 1/sqrt(s), walk of each component of the field that the heading counts from, as a fraction of the field."""
    tail: ArrayLike = 3.0
    """() standard deviations beyond which a magnetometer reading loses its weight."""
    rejection_time: ArrayLike = 60.0
    """() s of rejected readings after which the field is learned anew."""
    excursion: ArrayLike = 0.2
    """() m, standard deviation of movements along each horizontal axis; enters the covariance only."""
    hold: ArrayLike = 0.25
    """() s, longest time that one rate stands for; behind a longer gap the low-pass starts anew."""
    unseen_rotation: ArrayLike = 1.0
    """() rad/s/sqrt(Hz), density of the rotation that a missing rate hides; enters covariances only."""
    gravity: ArrayLike = 9.81
    """() m/s^2; enters the covariance only."""
    rest: resting.Rest = resting.Rest()
    """When the IMU counts as resting."""


class State(NamedTuple):
    """What the next step needs."""

    gyration: Array
    """(4,) wxyz, sensor to the frame that the gyroscope keeps."""
    upright: Array
    """(4,) wxyz, from that frame to one that is upright."""
    averages: low.Lowpass
    """15 channels: specific force in the frame of `gyration`, matrix to the upright frame, turned bias."""
    bias: Array
    """(3,) rad/s, gyro bias."""
    bias_covariance: Array
    """(3, 3)"""
    field: Array
    """(3,) in the upright frame, as a multiple of the first reading's norm."""
    field_covariance: Array
    """(3, 3)"""
    tilt_variance: Array
    """() rad^2 about each horizontal axis, beside what movements add."""
    stillness: resting.Stillness
    """Memory of the rest detection."""
    acc_age: Array
    """() s since the last accelerometer sample."""
    mag_age: Array
    """() s since the last magnetometer sample."""
    doubt: Array
    """() s for which magnetometer readings have been rejected."""
    unit: Array
    """() norm of the first magnetometer reading."""
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
    quaternion_6: Array
    """(4,) wxyz, the same without the magnetometer: its heading is the gyroscope's own."""
    bias: Array
    """(3,) rad/s, gyro bias."""
    weight_mag: Array
    """() weight in [0, 1] of this magnetometer sample; 0 where there is none."""
    rest: Array
    """() bool, whether the IMU is at rest."""
    valid: Array
    """() bool, whether each vector sensor has set its part of the orientation yet."""
    status: Array
    """() int32, `OK`, `NON_FINITE`, or `OUT_OF_RANGE` (state as before); see `jaxest.types.status_message`."""
    covariance: Array
    """(3, 3) rad^2 of theta in `truth = quaternion * exp(theta)`. Without a magnetometer the heading counts from the
    first sample on, whose heading defines the earth frame; before the first samples nothing is known: pi^2 / 3."""


def init(params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen no data; the first valid accelerometer sample sets the inclination.

    Args:
        params: parameters; their dtype (a Python float's is JAX's default) becomes that of the state.
        key: not used.

    Returns:
        The state with index 0.
    """
    dtype = jnp.result_type(*jax.tree.leaves(params))
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    zero, vector, matrix = (jnp.zeros(shape, dtype) for shape in ((), 3, (3, 3)))
    no, one = jnp.zeros((), bool), quat.identity(dtype)
    spread = jnp.eye(3, dtype=dtype) * jnp.asarray(params.initial_bias, dtype) ** 2
    return apart(State(
        one, one, low.begin(15, dtype), vector, spread, vector, matrix, zero, resting.begin(dtype), zero, zero, zero,
        zero + 1, jnp.zeros((), jnp.int32), no, no,
    ))  # fmt: skip


__all__ = ["Info", "Params", "State", "init"]
