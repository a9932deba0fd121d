"""Orientation of a single IMU, by whichever filter, and data to try it on."""

import functools
import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters import attitude, complementary, complementary_covariance
from jaxest.filters.complementary import exponential
from jaxest.filters.complementary_covariance import Noise
from jaxest.filters.imu import Imu, imu
from jaxest.manifolds import quaternion as quat
from jaxest.simulate.noise import coloured
from jaxest.types import Array, PyTree, System, unknown_name

SENSORS = ("gyroscope", "accelerometer", "magnetometer")
FIELD = (0.0, 18e-6, -41e-6)
"""T, the earth's magnetic field that `simulate` draws with: east, north, up."""


class Truth(NamedTuple):
    """What simulated measurements come from."""

    quaternion: Array
    """(T, 4) wxyz, sensor to earth, at each sample."""
    bias: Array
    """(T, 3) rad/s, gyro bias."""
    rate: Array
    """(T, 3) rad/s in the sensor frame, over the step that ends at each sample."""


def build(
    robot: None = None,
    sensors: Sequence[str] = SENSORS,
    *,
    filter: Any = complementary,
    update: Any = exponential,
    covariance: bool = False,
) -> System:
    """Build the orientation estimator of one IMU.

    Args:
        robot: not used, an IMU needs none; here because every system takes one.
        sensors: which there are, of `gyroscope`, `accelerometer`, `magnetometer`; the first two are needed.
        filter: a module with `Params`, `init` and `step`: `jaxest.filters.complementary` or one of
            `jaxest.filters.attitude` (`ekf`, `decoupled`, `madgwick`).
        update: how a step of `complementary` turns the estimate, its `exponential` or `projection`.
        covariance: whether states and infos of `complementary` carry a covariance (several times the work in a batch);
            those of `ekf` and `decoupled` always do, of `madgwick` never.

    Returns:
        The system, the same object for the same choices, so that `run` compiles its step once. Its measurement is
        `imu.Imu` (the magnetometer None without one); its parameters are the filter's `Params`, or
        `complementary_covariance.Params` with `covariance`.

    Raises:
        InputError: a sensor has no such name.
        ValueError: the gyroscope or the accelerometer is missing, or an option is not one of the filter's.

    Source: Santaera 2015, Algorithm 1 (`complementary`).
    """
    for name in sensors:
        if name not in SENSORS:
            raise unknown_name("sensor", name, SENSORS)
    if not {"gyroscope", "accelerometer"} <= set(sensors):
        raise ValueError(f"sensors: got {tuple(sensors)}, expected at least 'gyroscope' and 'accelerometer'")
    if filter is not complementary and (update is not exponential or (covariance and filter is attitude.madgwick)):
        name = "covariance" if update is exponential else "update"
        raise ValueError(f"{name}: {filter.__name__} has no such option")
    return _build("magnetometer" in sensors, filter, update, covariance)


@functools.cache
def _build(magnetic: bool, filter: Any, update: Any, covariance: bool) -> System:
    if filter is not complementary:
        return System(filter.Params(), filter.init, filter.step, partial(simulate, magnetic=magnetic))
    step = complementary.step if update is exponential else partial(complementary.step, update=update)
    draw = partial(simulate, magnetic=magnetic)
    if not covariance:
        return System(complementary.Params(), complementary.init, step, draw)
    carried = complementary_covariance
    return System(carried.Params(), carried.init, carried.with_covariance(step), draw)


def simulate(
    params: PyTree,
    *,
    key: Array,
    steps: int = 1000,
    rate_hz: float = 100.0,
    speed: float = 1.0,
    shaking: float = 0.0,
    colour: float = 0.5,
    noise: Noise | None = None,
    magnetic: bool = True,
) -> tuple[Imu, Truth]:
    """Draw a smooth random rotation and what an IMU with noise and a biased gyro reads during it.

    The gyro's bias starts as `initial_bias` says and walks, its noise is white. The noise of the vector sensors has
    the given densities and a correlation time, as bias, sway and uneven fields have. `scale` is not simulated.

    Args:
        params: the system's parameters; with a `noise` in them that is what is drawn. Their dtype is that of the data.
        key: key of the whole draw.
        steps: number of samples T, static.
        rate_hz: samples per second.
        speed: rad/s, standard deviation of the angular rate about each axis.
        shaking: m/s^2, standard deviation of the sensor's acceleration along each earth axis, with the correlation
            time `motion_time`.
        colour: s, correlation time of the vector sensors' noise; 0 is white.
        noise: noise of the sensors, in place of that in `params` or the default.
        magnetic: whether there is a magnetometer, static.

    Returns:
        Measurements with leading axis T, all valid (the field in tesla, 45 uT that dip by 66 deg to the north), and the
        truth. The orientation is uniform at the start, so without a magnetometer compare headings with
        `jaxest.metrics.align_heading`.

    Raises:
        ValueError: there are no steps.
    """
    if steps < 1:
        raise ValueError(f"steps: got {steps}, expected at least 1")
    chosen: Any = noise if noise is not None else getattr(params, "noise", Noise())
    dtype = jnp.result_type(*jax.tree.leaves(params))
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    given: Any = Noise._make(jnp.asarray(x, dtype) for x in chosen)
    turns, walks, forces, fields, moves = jax.random.split(key, 5)
    dt, time = jnp.asarray(1 / rate_hz, dtype), jnp.asarray(colour, dtype)
    rate, quaternion = _motion(turns, steps, dt, jnp.asarray(speed, dtype))
    start, walk, hiss = jax.random.normal(walks, (3, steps, 3), dtype)
    bias = given.initial_bias * start[:1] + given.bias_walk * jnp.sqrt(dt) * jnp.cumsum(walk, axis=0)
    gyroscope = rate + bias + given.gyroscope / jnp.sqrt(dt) * hiss
    shaken = jnp.asarray(shaking, dtype) * coloured(moves, steps, 3, dt, given.motion_time, dtype)
    force = given.gravity * jnp.array([[0, 0, 1]], dtype) + shaken
    field = jnp.broadcast_to(jnp.array(FIELD, dtype), (steps, 3))
    per_density = 1 / jnp.sqrt(_density(dt, time))
    sway = given.gravity * given.accelerometer * per_density * coloured(forces, steps, 3, dt, time, dtype)
    uneven = math.hypot(*FIELD) * given.magnetometer * per_density * coloured(fields, steps, 3, dt, time, dtype)
    accelerometer = _seen(quaternion, force) + sway
    magnetometer = _seen(quaternion, field) + uneven if magnetic else None
    measurements = imu(gyroscope, accelerometer, magnetometer, dt=jnp.broadcast_to(dt, (steps,)))
    return measurements, Truth(quaternion, bias, rate)


def _motion(key: Array, steps: int, dt: Array, speed: Array) -> tuple[Array, Array]:
    """Rates from a few sines between 0.1 and 1 Hz, and the orientations they lead through."""
    first, phase, pitch = jax.random.split(key, 3)
    waves = 5
    frequency = jax.random.uniform(pitch, (waves, 3), dt.dtype, 0.1, 1.0)
    offset = jax.random.uniform(phase, (waves, 3), dt.dtype, 0, 2 * jnp.pi)
    time = dt * jnp.arange(1, steps + 1, dtype=dt.dtype)
    angle = 2 * jnp.pi * frequency[None] * time[:, None, None] + offset[None]
    rate = speed * jnp.sqrt(2 / waves).astype(dt.dtype) * jnp.sum(jnp.sin(angle), axis=1)

    def turn(quaternion: Array, rate: Array) -> tuple[Array, Array]:
        quaternion = quat.normalize(quat.compose(quaternion, quat.exp(rate * dt)))
        return quaternion, quaternion

    start = quat.normalize(jax.random.normal(first, (4,), dt.dtype))
    return rate, jax.lax.scan(turn, start, rate)[1]


def _density(dt: Array, time: Array) -> Array:
    """Squared density of `noise.coloured` at low frequency: dt when white, 2 time when slow."""
    decay = jnp.exp(-dt / time)
    return dt * (1 + decay) / (1 - decay)


def _seen(quaternion: Array, vector: Array) -> Array:
    """Earth vectors (T, 3) in the sensor's frame."""
    return jax.vmap(lambda q, v: quat.rotate(quat.inverse(q), v))(quaternion, vector)


__all__ = ["SENSORS", "Truth", "build", "simulate"]
