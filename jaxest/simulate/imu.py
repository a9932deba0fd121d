"""What an IMU on a frame of a moving robot reads."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters.complementary import Imu
from jaxest.kinematics import Robot, forward
from jaxest.manifolds import quaternion as quat
from jaxest.simulate.noise import Faults, Triad, corrupt
from jaxest.types import Array, ArrayLike, Reading

G = 9.80665  # m/s2, the unit of data sheets
DEG = np.pi / 180


class Sensor(NamedTuple):
    """An IMU; the defaults are those of a small MEMS part after a factory calibration."""

    gyroscope: Triad = Triad(density=9e-5, bias=0.005, walk=2e-5)
    """rad/s."""
    accelerometer: Triad = Triad(density=4e-3, bias=0.02, walk=1e-4)
    """m/s2."""
    magnetometer: Triad = Triad(density=3e-8)
    """T."""
    jitter: ArrayLike = 0.0
    """() s, standard deviation of a sample's time about the regular one, at most a tenth of the interval."""
    drop: ArrayLike = 0.0
    """() probability that a sample of all three sensors is lost."""
    clock_offset: ArrayLike = 0.0
    """() s, the sensor's stamps are late by this."""


def perfect() -> Sensor:
    """Return an IMU without any error."""
    return Sensor(Triad(), Triad(), Triad())


def mpu6050() -> Sensor:
    """Return InvenSense's MPU-6050 at 2000 deg/s and 16 g as it comes, uncalibrated; with a magnetometer beside it.

    A data sheet's tolerance is taken as two standard deviations. Source: product specification PS-MPU-6000A rev. 3.4:
    noise 0.005 deg/s/sqrt(Hz) and 400 ug/sqrt(Hz), zero-rate 20 deg/s, zero-g 50 mg, scale 3 %, cross-axis 2 %.
    """
    return Sensor(
        Triad(0.005 * DEG / np.sqrt(2), 10 * DEG, 2e-5, 0.015, 0.01, 2000 * DEG, 2000 * DEG / 2**15),
        Triad(400e-6 * G / np.sqrt(2), 0.025 * G, 1e-4, 0.015, 0.01, 16 * G, 16 * G / 2**15),
    )


def mpu6886() -> Sensor:
    """Return TDK's MPU-6886 at 2000 deg/s and 8 g as it comes, uncalibrated; with a magnetometer beside it.

    Source: data sheet DS-000193 rev. 1.1 for noise (0.004 deg/s/sqrt(Hz), 100 ug/sqrt(Hz)) and gyro scale (1 %); bias,
    accelerometer scale and misalignment are those of parts of its class (1 deg/s, 20 mg, 0.5 %, 1 %).
    """
    return Sensor(
        Triad(0.004 * DEG / np.sqrt(2), 0.5 * DEG, 1e-5, 0.005, 0.005, 2000 * DEG, 2000 * DEG / 2**15),
        Triad(100e-6 * G / np.sqrt(2), 0.01 * G, 5e-5, 0.0025, 0.005, 8 * G, 8 * G / 2**15),
    )


class Truth(NamedTuple):
    """How the sensor really moves."""

    quaternion: Array
    """(..., 4) wxyz, sensor to world."""
    position: Array
    """(..., 3) m, of the sensor in the world."""
    rate: Array
    """(..., 3) rad/s, of the sensor, in the sensor's frame."""
    specific_force: Array
    """(..., 3) m/s2, in the sensor's frame; +1 g up at rest."""


class Record(NamedTuple):
    """All there is to know about a simulated recording."""

    truth: Truth
    """leaves (T, ...)"""
    time: Array
    """(T,) s, when the samples were really taken."""
    stamp: Array
    """(T,) s, when the sensor says they were."""
    gyroscope: Faults
    accelerometer: Faults
    magnetometer: Faults


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
) -> tuple[Imu, Record]:
    """Record a 9-axis IMU during a motion.

    Args:
        robot: the robot.
        motion: time () s -> q (nq,), twice differentiable.
        frame: static, the frame that carries the IMU and whose axes it has.
        key: key of the whole recording.
        duration: s.
        rate_hz: samples per second.
        sensor: which IMU; the default `Sensor()` if None, `mpu6050()` and `mpu6886()` for parts as they come.
        field: (3,) T, the earth's magnetic field in the world (x east, y north, z up).

    Returns:
        Measurements with a leading time axis of T = `round(duration * rate_hz)` samples (a lost one is not valid; the
        first `dt` is 0), and what they come from.

    Raises:
        ValueError: there is no sample.
    """
    count = round(duration * rate_hz)
    if count < 1:
        raise ValueError(f"duration, rate_hz: {duration} s at {rate_hz} Hz, expected at least one sample")
    sensor = Sensor() if sensor is None else sensor
    keys = jax.random.split(key, 5)
    late = jnp.clip(sensor.jitter * jax.random.normal(keys[0], (count,)), -0.1 / rate_hz, 0.1 / rate_hz)
    dt = (1 / rate_hz + late - jnp.roll(late, 1)).at[0].set(0)
    time = jnp.arange(count) / rate_hz + late
    truth = jax.jit(jax.vmap(lambda t: ideal(robot, motion, frame, t)))(time)
    earth = jnp.asarray(field, truth.quaternion.dtype)
    magnetic = jax.vmap(lambda q: quat.rotate(quat.inverse(q), earth))(truth.quaternion)
    there = jax.random.uniform(keys[1], (count,)) >= sensor.drop
    signals = truth.rate, truth.specific_force, magnetic
    drawn = [corrupt(k, triad, x, dt) for k, triad, x in zip(keys[2:], sensor[:3], signals, strict=True)]
    gyroscope, accelerometer, magnetometer = (Reading(jnp.where(there[:, None], x, 0), there) for x, _ in drawn)
    measurements = Imu(gyroscope, accelerometer, magnetometer, dt)
    faults = (fault for _, fault in drawn)
    return measurements, Record(truth, time, time + jnp.asarray(sensor.clock_offset, time.dtype), *faults)


__all__ = ["Record", "Sensor", "Truth", "ideal", "mpu6050", "mpu6886", "perfect", "record"]
