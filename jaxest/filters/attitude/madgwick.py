"""Madgwick's filter: the orientation of one IMU by one step of gradient descent a sample.

Source: Madgwick 2010 (An efficient orientation filter for inertial and inertial/magnetic sensor arrays), eqs. 11 to 46
without the gyro bias. There the earth's x axis points north; here, as everywhere, y does (ENU).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters._state import apart
from jaxest.filters.attitude.vectors import levelled, northward
from jaxest.filters.imu import Imu, direction, usable
from jaxest.manifolds import quaternion as quat
from jaxest.types import Array, ArrayLike


class Params(NamedTuple):
    """What may be tuned."""

    beta: ArrayLike = 0.041
    """() 1/s, speed of the descent in the norm of the quaternion: the filter turns by at most 2 beta. 0.041 is the
    paper's for nine axes (0.033 for six)."""


class State(NamedTuple):
    """What the next step needs."""

    quaternion: Array
    """(4,) wxyz, sensor to earth."""
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
    descent: Array
    """(4,) unit gradient of the squared errors by the quaternion; 0 where no vector was used."""
    valid: Array
    """() bool, whether each vector sensor has set its part of the orientation yet."""
    status: Array
    """() int32, `OK` or `NON_FINITE`; see `jaxest.types.status_message`."""


def init(params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen no data; the first valid vectors set the orientation.

    Args:
        params: their dtype (a Python float's is JAX's default) becomes that of the state.
        key: not used.

    Returns:
        The state with index 0.
    """
    dtype = jnp.result_type(*params)
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    no = jnp.zeros((), bool)
    return apart(State(quat.identity(dtype), jnp.zeros((), jnp.int32), no, no))


def step(params: Params, state: State, measurement: Imu, *, key: Array | None = None) -> tuple[State, Info]:
    """Take in one sample.

    Args:
        params: the descent's speed.
        state: as `init` or the previous step returned it; its dtype is that of the computation.
        measurement: one sample; of the vector sensors only the directions count.
        key: not used.

    Returns:
        The next state and the info. What is masked or not finite adds exactly nothing.

    Raises:
        ValueError: a sensor's value is not (3,), or `valid` or `dt` is not a scalar.

    Source: Madgwick 2010, eqs. 33 (gradient), 42 to 44 (fusion), 45 and 46 (field).
    """
    dtype = state.quaternion.dtype
    sample, beta = usable(measurement, dtype), jnp.asarray(params.beta, dtype)
    acc, mag, before = direction(sample.accelerometer.value), direction(sample.magnetometer.value), state.quaternion
    east, north, up = quat.rotate(before, mag)
    flat = east * east + north * north
    reference = jnp.stack([jnp.where(flat > 0, jnp.sqrt(jnp.where(flat > 0, flat, 1)), 0), up])
    use_acc = sample.accelerometer.valid & state.initialized
    use_mag = sample.magnetometer.valid & state.initialized & state.heading_initialized
    quarter = jnp.asarray([0.5**0.5, 0, 0, 0.5**0.5], dtype)  # from the paper's earth frame to this one
    paper = quat.compose(quat.inverse(quarter), before)
    slope = _slope(paper, acc, jnp.array([0, 1], dtype)) * use_acc + _slope(paper, mag, reference) * use_mag
    descent = quat.compose(quarter, direction(slope))
    rate = jnp.where(sample.gyroscope.valid, sample.gyroscope.value, 0)
    turn = quat.compose(before, jnp.concatenate([jnp.zeros(1, dtype), rate])) / 2
    moved = quat.normalize(before + (turn - beta * descent) * sample.dt)

    initialized = state.initialized | sample.accelerometer.valid
    level = jnp.where(sample.accelerometer.valid, levelled(acc), before)
    quaternion = jnp.where(state.initialized, moved, level)
    first = initialized & sample.magnetometer.valid & ~state.heading_initialized
    turned = quat.compose(northward(quat.rotate(quaternion, mag)), quaternion)
    quaternion = jnp.where(first, turned, quaternion)
    headed = state.heading_initialized | first
    valid = initialized if measurement.magnetometer is None else initialized & headed
    after = State(quaternion, state.index + 1, initialized, headed)
    return after, Info(quaternion, descent, valid, sample.status)


def _slope(quaternion: Array, seen: Array, reference: Array) -> Array:
    """Gradient (4,) of half the squared error between a direction and its reference (north, up), eqs. 20, 21, 34.

    In the paper's frame, since its normalised step depends on how the rotation matrix is written off the unit sphere.
    """

    def half_square(q: Array) -> Array:
        w, x, y, z = q
        to_north = jnp.stack([2 * (0.5 - y * y - z * z), 2 * (x * y - w * z), 2 * (w * y + x * z)])
        to_up = jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 2 * (0.5 - x * x - y * y)])
        error = reference[0] * to_north + reference[1] * to_up - seen
        return jnp.sum(error * error) / 2

    return jax.grad(half_square)(quaternion)


__all__ = ["Info", "Params", "State", "init", "step"]
