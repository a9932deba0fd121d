"""The simulated IMU: rest, a known circle, and consistency of its rates with its poses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxest import kinematics, models
from jaxest.manifolds import quaternion as quat
from jaxest.simulate import imu, trajectories
from jaxest.simulate.noise import Triad, corrupt


def test_a_resting_arm_reads_one_g_up(dtype):
    robot = kinematics.load(models.path("arm"))
    truth = imu.ideal(robot, lambda t: jnp.asarray(robot.home, dtype) + 0 * t, "site:imu3", 0.0)
    up = quat.rotate(truth.quaternion, truth.specific_force)
    np.testing.assert_allclose(up, [0, 0, 9.81], atol=2e-6)
    np.testing.assert_allclose(truth.rate, 0, atol=1e-7)


def test_a_constant_turn_pulls_to_the_centre(x64):
    robot = kinematics.load(models.chain(1))
    truth = imu.ideal(robot, lambda t: jnp.stack([3.0 * t]), "link1", 0.7)
    np.testing.assert_allclose(truth.rate, [0, 0, 3], atol=1e-12)
    text = models.chain(1).replace("<geom", '<site name="s" pos="0.2 0 0"/><geom')
    truth = imu.ideal(kinematics.load(text), lambda t: jnp.stack([3.0 * t]), "site:s", 0.7)
    np.testing.assert_allclose(truth.specific_force, [-(3.0**2) * 0.2, 0, 9.81], atol=1e-10)


def test_rates_integrate_to_the_orientation_and_forces_to_the_path(x64):
    robot = kinematics.load(models.path("arm"))
    motion = trajectories.random_motion(jax.random.key(0), robot)
    rate_hz = 500.0
    measured, record = imu.record(
        robot, lambda t: trajectories.configuration(motion, t), "site:imu3", key=jax.random.key(1), duration=2.0,
        rate_hz=rate_hz, sensor=imu.perfect(),
    )  # fmt: skip
    truth = record.truth
    middle = (truth.rate[1:] + truth.rate[:-1]) / 2 / rate_hz
    predicted = jax.vmap(quat.retract)(truth.quaternion[:-1], middle)
    error = jax.vmap(quat.local)(predicted, truth.quaternion[1:])
    assert np.abs(error).max() < 1e-6
    world = jax.vmap(quat.rotate)(truth.quaternion, truth.specific_force) + jnp.asarray(robot.gravity)[None]
    second = (truth.position[2:] - 2 * truth.position[1:-1] + truth.position[:-2]) * rate_hz**2
    assert np.abs(second - world[1:-1]).max() < 1e-3
    np.testing.assert_allclose(measured.gyroscope.value, truth.rate)
    assert measured.dt[0] == 0
    assert measured.dt[1] == pytest.approx(1 / rate_hz)


def at_rest(sensor, seed=3, duration=40.0, rate_hz=100.0):
    robot = kinematics.load(models.path("arm"))
    still = jnp.asarray(robot.home)
    return imu.record(
        robot,
        lambda t: still + 0 * t,
        "hand",
        key=jax.random.key(seed),
        duration=duration,
        rate_hz=rate_hz,
        sensor=sensor,
    )


def test_noise_is_as_stated():
    sensor = imu.Sensor(Triad(density=0.01), Triad(density=0.02), Triad(density=3e-8))
    measured, record = at_rest(sensor)
    n = measured.dt.size * 3
    for reading, clean, density in (
        (measured.gyroscope.value, record.truth.rate, 0.01),
        (measured.accelerometer.value, record.truth.specific_force, 0.02),
    ):
        spread = np.std(np.asarray(reading - clean))
        assert spread == pytest.approx(density * 10, rel=4 / np.sqrt(2 * n))  # 4 standard errors


def test_bias_walks_by_the_square_root_of_time():
    dt = jnp.full(400, 0.25)
    drawn = jax.vmap(lambda k: corrupt(k, Triad(bias=0.3, walk=0.1), jnp.zeros((400, 3)), dt)[1].bias)(
        jax.random.split(jax.random.key(0), 300)
    )
    n = 900
    assert np.std(drawn[:, -1]) == pytest.approx(np.sqrt(0.3**2 + 0.1**2 * 100), rel=4 / np.sqrt(2 * n))
    np.testing.assert_allclose(np.std(drawn[:, 0]), 0.3, rtol=4 / np.sqrt(2 * n) + 0.02)


def test_scale_misalignment_saturation_and_rounding():
    value = jnp.asarray(np.random.default_rng(0).normal(size=(500, 3)), jnp.float32)
    triad = Triad(scale=0.05, misalignment=0.03, limit=1.5, resolution=0.01)
    reading, faults = corrupt(jax.random.key(1), triad, value, jnp.full(500, 0.01))
    expected = np.clip(np.asarray(value) @ np.asarray(faults.matrix).T, -1.5, 1.5)
    assert np.abs(reading - expected).max() <= 0.005 + 1e-6
    np.testing.assert_allclose(reading / 0.01, np.round(reading / 0.01), atol=1e-3)
    assert np.abs(reading).max() == pytest.approx(1.5)
    assert np.abs(faults.matrix - np.eye(3)).max() > 0.01


def test_drops_jitter_and_clock():
    sensor = imu.Sensor(jitter=2e-4, drop=0.2, clock_offset=0.03)
    measured, record = at_rest(sensor)
    n = measured.dt.size
    lost = 1 - np.mean(measured.gyroscope.valid)
    assert lost == pytest.approx(0.2, abs=4 * np.sqrt(0.16 / n))
    assert (np.asarray(measured.accelerometer.value)[~np.asarray(measured.accelerometer.valid)] == 0).all()
    np.testing.assert_allclose(np.cumsum(measured.dt), record.time - record.time[0], atol=2e-4)
    assert np.std(np.asarray(measured.dt)[1:]) == pytest.approx(2e-4 * np.sqrt(2), rel=0.1)
    np.testing.assert_allclose(record.stamp - record.time, 0.03, atol=1e-5)


@pytest.mark.parametrize("sensor", [imu.mpu6050(), imu.mpu6886()])
def test_real_parts_read_about_one_g_at_rest(sensor):
    measured, record = at_rest(sensor, duration=2.0)
    norm = np.linalg.norm(np.mean(measured.accelerometer.value, axis=0))
    assert norm == pytest.approx(9.81, rel=0.1)
    assert 1e-3 < np.abs(record.gyroscope.bias).max() < 0.6


def test_motions_stay_within_limits_and_leave_the_rest_alone(x64):
    robot = kinematics.load(models.path("rover"))
    motion = trajectories.random_motion(jax.random.key(0), robot, reach=1.0)
    q = np.asarray(jax.vmap(lambda t: trajectories.configuration(motion, t))(jnp.linspace(0, 60, 2000)))
    assert (q >= robot.limits[:, 0] - 1e-9).all()
    assert (q <= robot.limits[:, 1] + 1e-9).all()
    moving = np.ptp(q, axis=0) > 0.01
    start = robot.topology.joint_q[robot.joint_names.index("neck")]
    assert not moving[:7].any()
    assert not moving[start : start + 4].any()
    assert not moving[robot.topology.joint_q[robot.joint_names.index("left_tip")]]
    assert moving[robot.topology.joint_q[robot.joint_names.index("swing")]]


def test_bad_arguments():
    robot = kinematics.load(models.path("arm"))
    with pytest.raises(ValueError, match=r"slowest, fastest: 1\.0, 0\.5"):
        trajectories.random_motion(jax.random.key(0), robot, slowest=1.0)
    with pytest.raises(ValueError, match="reach: 2"):
        trajectories.random_motion(jax.random.key(0), robot, reach=2)
    with pytest.raises(ValueError, match="expected at least one sample"):
        imu.record(robot, lambda t: jnp.zeros(4) * t, 0, key=jax.random.key(0), duration=0.0)
