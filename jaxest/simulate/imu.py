"""What an IMU on a frame of a moving robot reads."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters.imu import Imu
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
    return jax.tree.map(lambda x: x[0], ideals(robot, motion, (frame,), time))


def ideals(robot: Robot, motion: Callable[[Array], Array], frames: Sequence[int | str], time: ArrayLike) -> Truth:
    """Compute the same for n frames at once.

    Args:
        robot: as in `ideal`.
        motion: as in `ideal`.
        frames: static, indices or names.
        time: () s; batch with `jax.vmap`.

    Returns:
        The truth at that time, leaves (n, ...).
    """
    time = jnp.asarray(time, jnp.result_type(float))

    def pose(t: Array) -> tuple[Array, Array]:
        found = forward(robot, motion(t), frames)
        return found.position, found.quaternion

    def moving(t: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        return jax.jvp(pose, (t,), (jnp.ones_like(t),))

    ((position, quaternion), (_, turning)), (_, (acceleration, _)) = jax.jvp(moving, (time,), (jnp.ones_like(time),))
    gravity = jnp.asarray(robot.gravity, acceleration.dtype)

    def felt(q: Array, dq: Array, position: Array, acceleration: Array) -> Truth:
        rate = 2 * quat.compose(quat.inverse(q), dq)[1:]
        return Truth(q, position, rate, quat.rotate(quat.inverse(q), acceleration - gravity))

    found: Truth = jax.vmap(felt)(quaternion, turning, position, acceleration)
    return found


def _mounted(mounting: Array, truth: Truth) -> Truth:
    """Turn what a frame feels into the axes of an IMU that sits on it."""
    back = quat.inverse(mounting)
    return Truth(
        quat.compose(truth.quaternion, mounting),
        truth.position,
        quat.rotate(back, truth.rate),
        quat.rotate(back, truth.specific_force),
    )


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
    mounting: ArrayLike | None = None,
) -> tuple[Imu, Record]:
    """Record a 9-axis IMU during a motion.

    Args:
        robot: the robot.
        motion: time () s -> q (nq,), twice differentiable.
        frame: static, the frame that carries the IMU.
        key: key of the whole recording.
        duration: s.
        rate_hz: samples per second.
        sensor: which IMU; the default `Sensor()` if None, `mpu6050()` and `mpu6886()` for parts as they come.
        field: (3,) T, the earth's magnetic field in the world (x east, y north, z up).
        mounting: (4,) wxyz, IMU to frame; None where the IMU has the frame's axes.

    Returns:
        Measurements with a leading time axis of T = `round(duration * rate_hz)` samples (a lost one is not valid; the
        first `dt` is 0), and what they come from.

    Raises:
        ValueError: there is no sample.
    """
    given = quat.identity() if mounting is None else mounting
    measurements, found = record_all(
        robot, motion, (frame,), key=key, duration=duration, rate_hz=rate_hz, sensor=sensor, field=field,
        mounting=jnp.asarray(given)[None],
    )  # fmt: skip
    every = measurements._replace(dt=jnp.asarray(measurements.dt)[:, None])
    return jax.tree.map(lambda x: x[:, 0], every), found._replace(
        truth=jax.tree.map(lambda x: x[:, 0], found.truth),
        gyroscope=jax.tree.map(lambda x: x[0], found.gyroscope),
        accelerometer=jax.tree.map(lambda x: x[0], found.accelerometer),
        magnetometer=jax.tree.map(lambda x: x[0], found.magnetometer),
    )


def record_all(
    robot: Robot,
    motion: Callable[[Array], Array],
    frames: Sequence[int | str],
    *,
    key: Array,
    duration: float = 60.0,
    rate_hz: float = 200.0,
    sensor: Sensor | None = None,
    field: tuple[float, float, float] | Array = (0.0, 18e-6, -41e-6),
    mounting: ArrayLike | None = None,
) -> tuple[Imu, Record]:
    """Record n IMUs with one clock during a motion.

    Args:
        robot: as in `record`, and so are `motion`, `key`, `duration`, `rate_hz`, `sensor` and `field`.
        motion: see there.
        frames: static, the n frames that carry an IMU each.
        key: see there.
        duration: s.
        rate_hz: samples per second.
        sensor: see there; each IMU draws its own faults.
        field: (3,) T.
        mounting: (n, 4) wxyz, each IMU to its frame; None where they have the frames' axes.

    Returns:
        Measurements, values and flags (T, n, ...) and `dt` (T,), and what they come from: truth (T, n, ...), faults
        (n, ...).

    Raises:
        ValueError: there is no sample.
    """
    count, n = round(duration * rate_hz), len(frames)
    if count < 1:
        raise ValueError(f"duration, rate_hz: {duration} s at {rate_hz} Hz, expected at least one sample")
    sensor = Sensor() if sensor is None else sensor
    keys = jax.random.split(key, 5)
    late = jnp.clip(sensor.jitter * jax.random.normal(keys[0], (count,)), -0.1 / rate_hz, 0.1 / rate_hz)
    dt = (1 / rate_hz + late - jnp.roll(late, 1)).at[0].set(0)
    time = jnp.arange(count) / rate_hz + late
    truth = jax.jit(jax.vmap(lambda t: ideals(robot, motion, tuple(frames), t)))(time)
    if mounting is not None:
        given = jnp.asarray(mounting, truth.quaternion.dtype)
        truth = jax.vmap(jax.vmap(_mounted), (None, 0))(given, truth)
    earth = jnp.asarray(field, truth.quaternion.dtype)
    magnetic = jax.vmap(jax.vmap(lambda q: quat.rotate(quat.inverse(q), earth)))(truth.quaternion)
    there = jax.random.uniform(keys[1], (count, n)) >= sensor.drop
    found, faults = [], []
    for k, triad, signal in zip(keys[2:], sensor[:3], (truth.rate, truth.specific_force, magnetic), strict=True):
        drawn, fault = jax.vmap(lambda k, x, triad=triad: corrupt(k, triad, x, dt), (0, 1), (1, 0))(
            jax.random.split(k, n), signal
        )
        found.append(Reading(jnp.where(there[:, :, None], drawn, 0), there))
        faults.append(fault)
    gyroscope, accelerometer, magnetometer = found
    imus = Imu(gyroscope, accelerometer, magnetometer, dt)
    return imus, Record(truth, time, time + jnp.asarray(sensor.clock_offset, time.dtype), *faults)


__all__ = ["Record", "Sensor", "Truth", "ideal", "ideals", "mpu6050", "mpu6886", "perfect", "record", "record_all"]
