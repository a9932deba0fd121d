"""What an IMU on a frame of a moving robot reads."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters.complementary import Imu, imu
from jaxest.kinematics import Robot, forward
from jaxest.manifolds import quaternion as quat
from jaxest.types import Array, ArrayLike


class Sensor(NamedTuple):
    """How good the IMU is; the defaults are those of a cheap MEMS part."""

    gyroscope_noise: ArrayLike = 9e-5
    """() rad/s/sqrt(Hz), white."""
    gyroscope_bias: ArrayLike = 0.005
    """() rad/s, standard deviation of each axis' constant bias."""
    accelerometer_noise: ArrayLike = 4e-3
    """() m/s2/sqrt(Hz), white."""
    accelerometer_bias: ArrayLike = 0.02
    """() m/s2, standard deviation of each axis' constant bias."""
    magnetometer_noise: ArrayLike = 3e-8
    """() T/sqrt(Hz), white."""


class Truth(NamedTuple):
    """What the readings come from."""

    quaternion: Array
    """(..., 4) wxyz, sensor to world."""
    position: Array
    """(..., 3) m, of the sensor in the world."""
    rate: Array
    """(..., 3) rad/s, of the sensor, in the sensor's frame."""
    specific_force: Array
    """(..., 3) m/s2, in the sensor's frame; +1 g up at rest."""


def ideal(robot: Robot, motion: Callable[[Array], Array], frame: int | str, time: ArrayLike) -> Truth:
    """Compute a frame's orientation, angular rate and specific force, by differentiating the motion exactly.

    Args:
        robot: the robot; its `gravity` is what the accelerometer feels.
        motion: time () s -> q (nq,), twice differentiable.
        frame: static, a frame's index or name.
        time: () s; batch with `jax.vmap`.

    Returns:
        The truth at that time.
    """
    time = jnp.asarray(time, jnp.result_type(float))

    def pose(t: Array) -> tuple[Array, Array]:
        frames = forward(robot, motion(t), (frame,))
        return frames.position[0], frames.quaternion[0]

    def moving(t: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        return jax.jvp(pose, (t,), (jnp.ones_like(t),))

    ((position, quaternion), (_, turning)), (_, (acceleration, _)) = jax.jvp(moving, (time,), (jnp.ones_like(time),))
    rate = 2 * quat.compose(quat.inverse(quaternion), turning)[1:]
    force = acceleration - jnp.asarray(robot.gravity, acceleration.dtype)
    return Truth(quaternion, position, rate, quat.rotate(quat.inverse(quaternion), force))


def record(
    robot: Robot,
    motion: Callable[[Array], Array],
    frame: int | str,
    *,
    key: Array,
    duration: float = 60.0,
    rate_hz: float = 200.0,
    sensor: Sensor | None = None,
    field: tuple[float, float, float] | Array = (0.0, 18e-6, -41e-6),
) -> tuple[Imu, Truth]:
    """Record a 9-axis IMU during a motion.

    Args:
        robot: the robot.
        motion: time () s -> q (nq,), twice differentiable.
        frame: static, the frame that carries the IMU and whose axes it has.
        key: key of the whole recording.
        duration: s.
        rate_hz: samples per second.
        sensor: how good the IMU is.
        field: (3,) T, the earth's magnetic field in the world (x east, y north, z up).

    Returns:
        Measurements and truth with a leading time axis of `round(duration * rate_hz)` samples; the first `dt` is 0.

    Raises:
        ValueError: there is no sample.
    """
    count = round(duration * rate_hz)
    if count < 1:
        raise ValueError(f"duration, rate_hz: {duration} s at {rate_hz} Hz, expected at least one sample")
    sensor = Sensor() if sensor is None else sensor
    time = jnp.arange(count) / rate_hz
    truth = jax.jit(jax.vmap(lambda t: ideal(robot, motion, frame, t)))(time)
    earth = jnp.asarray(field, truth.quaternion.dtype)
    magnetic = jax.vmap(lambda q: quat.rotate(quat.inverse(q), earth))(truth.quaternion)
    spread = jnp.sqrt(jnp.asarray(rate_hz, earth.dtype))  # of a sample, per density
    keys = jax.random.split(key, 5)

    def noisy(key: Array, value: Array, density: ArrayLike) -> Array:
        return value + density * spread * jax.random.normal(key, value.shape, value.dtype)

    bias = sensor.gyroscope_bias * jax.random.normal(keys[3], (1, 3), earth.dtype)
    offset = sensor.accelerometer_bias * jax.random.normal(keys[4], (1, 3), earth.dtype)
    measurements = imu(
        noisy(keys[0], truth.rate + bias, sensor.gyroscope_noise),
        noisy(keys[1], truth.specific_force + offset, sensor.accelerometer_noise),
        noisy(keys[2], magnetic, sensor.magnetometer_noise),
        dt=jnp.where(jnp.arange(count) == 0, 0, 1 / spread**2),
    )
    return measurements, truth


__all__ = ["Sensor", "Truth", "ideal", "record"]
