"""Parameters, state and info of the error-state Kalman filter `ekf`."""

import itertools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters.attitude import rest as resting
from jaxest.filters.attitude.motion import Since, Track, begin
from jaxest.manifolds import quaternion as quat
from jaxest.types import Array, ArrayLike


class Params(NamedTuple):
    """Noise of the sensors and what is known of movements and rooms; one setting for people, robots and tools indoors.

    A disturbance of standard deviation s and correlation time T acts on a slow filter like white noise of density
    `s sqrt(2 T)`: so are `speed`, `excursion` and `field` used.
    """

    gyroscope: ArrayLike = 2e-4
    """() rad/s/sqrt(Hz), density of the rate noise."""
    misalignment: ArrayLike = 0.002
    """() without unit: what scales leave over of the gyro's errors, as a fraction of the rate, for `turn_time`."""
    turn_time: ArrayLike = 0.1
    """() s, correlation time of turns."""
    bias_walk: ArrayLike = 2e-5
    """() rad/s/sqrt(s), walk of the gyro bias: 0.01 deg/s in a minute."""
    accelerometer: ArrayLike = 0.01
    """() m/s^2/sqrt(Hz), density of the noise of the specific force."""
    speed: ArrayLike = 0.3
    """() m/s, standard deviation of the horizontal velocity along each axis."""
    excursion: ArrayLike = 0.2
    """() m, standard deviation of the horizontal position along each axis."""
    move_time: ArrayLike = 0.5
    """() s, correlation time of movements."""
    field: ArrayLike = 0.07
    """() standard deviation of each component of the magnetometer's readings, as a fraction of the field: rooms."""
    field_time: ArrayLike = 1.0
    """() s, correlation time of that."""
    field_walk: ArrayLike = 0.001
    """() 1/sqrt(s), walk of each component of the field that the heading counts from, as a fraction of the field."""
    tail: ArrayLike = 3.0
    """() standard deviations beyond which a reading loses its weight."""
    rejection_time: ArrayLike = 60.0
    """() s of rejected readings after which the field is learned anew."""
    hold: ArrayLike = 0.25
    """() s, longest time that one rate or specific force stands for; beyond, the sensor may have moved unseen."""
    unseen_rotation: ArrayLike = 1.0
    """() rad/s/sqrt(Hz), density of the rotation that a missing rate hides."""
    unseen_force: ArrayLike = 2.0
    """() m/s^2/sqrt(Hz), density of the acceleration that a missing specific force hides."""
    rest_rate: ArrayLike = 5e-4
    """() rad/s, standard deviation of the true rate about each axis at rest, for `move_time`: 0.03 deg/s."""
    initial_inclination: ArrayLike = 0.03
    """() rad, standard deviation about each horizontal axis after an accelerometer sample of 1 g."""
    initial_bias: ArrayLike = 0.01
    """() rad/s, standard deviation of the gyro bias about each axis before any data: 0.6 deg/s."""
    initial_scale: ArrayLike = 0.005
    """() without unit, standard deviation of each gyro scale before any data."""
    gravity: ArrayLike = 9.81
    """() m/s^2, norm of the specific force at rest; used for the first sample and the covariance only."""
    accelerometer_bias: ArrayLike = 0.05
    """() m/s^2, standard deviation of the accelerometer's bias along each axis, 5 mg, a tilt that no averaging takes
    away; enters the covariance that is given out only."""
    interval: ArrayLike = 0.03
    """() s between corrections."""
    rest: resting.Rest = resting.Rest()
    """When the IMU counts as resting."""


class Memory(NamedTuple):
    """What the next step needs, by name; `opened` gives it of a `State` and `closed` makes one of it."""

    track: Track
    """The estimate."""
    since: Since
    """Sums over the samples since the last correction."""
    stillness: resting.Stillness
    """Memory of the rest detection."""
    doubt: Array
    """() s for which magnetometer readings have been rejected."""
    unit: Array
    """() norm of the first magnetometer reading."""
    weights: Array
    """(2,) what the last correction weighed movement and field with, in [0, 1]."""
    lost: Array
    """() bool, whether the last correction left a covariance that is not finite."""
    initialized: Array
    """() bool, whether an accelerometer sample has set the inclination."""
    heading_initialized: Array
    """() bool, whether a magnetometer sample has set the heading."""


class State(NamedTuple):
    """What the next step needs, in few arrays of at most 512 bytes in float32.

    Called sample by sample, every array of a state costs microseconds; and as long as no array of a program is larger,
    XLA on CPU runs its small kernels one after the other instead of handing them from thread to thread.
    """

    numbers: Array
    """(67,) all that `Memory` names, one leaf after the other."""
    upper: Array
    """(8, 16) first rows of the covariance of the errors at the last correction."""
    lower: Array
    """(8, 16) its last rows."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""

    @property
    def covariance(self) -> Array:
        """(16, 16) of the errors at the last correction."""
        return jnp.concatenate([self.upper, self.lower], axis=-2)


class Info(NamedTuple):
    """The estimate of one step and how it came about."""

    quaternion: Array
    """(4,) wxyz, sensor to earth, at this sample."""
    bias: Array
    """(3,) rad/s, gyro bias."""
    scale: Array
    """(3,) gyro scale: the rate is `(1 + scale) (reading - bias)`."""
    weight_acc: Array
    """() weight in [0, 1] of the assumption that the movement is a usual one, at the last correction."""
    weight_mag: Array
    """() weight in [0, 1] of the magnetometer at the last correction that had a reading."""
    rest: Array
    """() bool, whether the IMU is at rest."""
    valid: Array
    """() bool, whether each vector sensor has set its part of the orientation yet."""
    status: Array
    """() int32, `OK`, `NON_FINITE` or `NOT_CONVERGED` (the covariance is lost); see `jaxest.types.status_message`."""
    covariance: Array
    """(3, 3) rad^2 of theta in `truth = quaternion * exp(theta)`. Without a magnetometer the heading counts from the
    first sample on, whose heading defines the earth frame; before the first samples nothing is known: pi^2 / 3."""


def init(params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen no data; the first valid accelerometer sample sets the inclination.

    Args:
        params: noise; their dtype (a Python float's is JAX's default) becomes that of the state.
        key: not used.

    Returns:
        The state with index 0.
    """
    dtype = jnp.result_type(*jax.tree.leaves(params))
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    two, three = jnp.zeros(2, dtype), jnp.zeros(3, dtype)
    no, zero = jnp.zeros((), bool), jnp.zeros((), dtype)
    one = jnp.ones(3, dtype)
    spread = [one * 0, two, two, one * params.initial_bias, one * params.initial_scale, one * 0]
    covariance = jnp.diag(jnp.concatenate([jnp.asarray(s, dtype) for s in spread]) ** 2)
    track = Track(quat.identity(dtype), two, two, three, three, three)
    memory = Memory(track, begin(dtype), resting.begin(dtype), zero, zero + 1, jnp.ones(2, dtype), no, no, no)
    return closed(memory, covariance[:8], covariance[8:], jnp.zeros((), jnp.int32))


def opened(state: State) -> Memory:
    """Return what a state (not a batch of them) holds, by name."""
    parts = jnp.split(state.numbers, list(itertools.accumulate(math.prod(shape) for shape, _ in _LEAVES))[:-1])
    leaves = [
        part.reshape(shape) > 0 if flag else part.reshape(shape)
        for part, (shape, flag) in zip(parts, _LEAVES, strict=True)
    ]
    memory: Memory = jax.tree.unflatten(_STRUCTURE, leaves)
    return memory


def closed(memory: Memory, upper: Array, lower: Array, index: Array) -> State:
    """Return the state of its parts."""
    numbers = [jnp.asarray(leaf, upper.dtype).reshape(-1) for leaf in jax.tree.leaves(memory)]
    return State(jnp.concatenate(numbers), upper, lower, index)


def _layout() -> tuple[list[tuple[tuple[int, ...], bool]], Any]:
    """Shape of each leaf of a `Memory` and whether it is a flag, and how they make one."""

    def shape(*sizes: int, flag: bool = False) -> Any:
        return jax.ShapeDtypeStruct(sizes, bool if flag else float)

    one, two, three, flag = shape(), shape(2), shape(3), shape(flag=True)
    track = Track(shape(4), two, two, three, three, three)
    since = Since(one, shape(3, 3), shape(3, 3), three, one, one, one, three, one, three, one, one)
    still = resting.Stillness(three, three, one, shape(2, flag=True))
    leaves, structure = jax.tree.flatten(Memory(track, since, still, one, one, two, flag, flag, flag))
    return [(leaf.shape, leaf.dtype == bool) for leaf in leaves], structure


_LEAVES, _STRUCTURE = _layout()

__all__ = ["Info", "Memory", "Params", "State", "closed", "init", "opened"]
