"""A block turned over on a plate: both sensors' matrices found as drawn, as well as it says, and refused where not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxest.calibration import imu, tumble
from jaxest.simulate import manipulator
from jaxest.simulate import tumble as turning
from jaxest.simulate.noise import Triad, corrupt
from jaxest.types import InputError

RATE = 85.0


@jax.jit
def faulty(key, triad, value, dt):
    return corrupt(key, triad, value, dt)


def recorded(seed, *, sensor=None, flatness=3e-4):
    """Readings of an IMU in a block, and the matrices (gyro, accelerometer) and biases they suffer from."""
    block = turning.draw(np.random.default_rng(seed), flatness=flatness)
    time = np.arange(int(block.duration * RATE)) / RATE
    dt = jnp.asarray(np.diff(time, prepend=0), jnp.float32)
    triads = (sensor or manipulator.mems())[:2]
    values, faults = [], []
    for key, triad, ideal in zip(
        jax.random.split(jax.random.key(seed)), triads, turning.ideal(block, time), strict=True
    ):
        value, fault = faulty(key, triad, jnp.asarray(ideal, jnp.float32), dt)
        values.append(np.asarray(value, float))
        faults.append(fault)
    return imu.Readings(time, *values), faults


def test_all_but_perfect_sensors_need_no_correction():
    readings, _ = recorded(0, sensor=(Triad(1e-7), Triad(1e-6)), flatness=0.0)
    found = tumble.calibrate(readings, flatness=0.0)
    np.testing.assert_allclose(found.gyroscope_matrix, np.eye(3), atol=2e-5)  # steps of the integral
    np.testing.assert_allclose(found.accelerometer_matrix, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(found.accelerometer_bias, 0, atol=1e-5)


def test_a_gyro_whose_steps_hide_its_noise_has_that_of_its_steps():
    readings, _ = recorded(0, sensor=(Triad(1e-7), Triad(1e-6)), flatness=0.0)
    step = 1.1e-3
    coarse = readings._replace(gyroscope=np.round(readings.gyroscope / step) * step)
    assert step / np.sqrt(12) < tumble.calibrate(coarse).gyroscope_noise * 1.001 < 1.5 * step


def test_matrices_are_found_as_well_as_it_says():
    errors = []
    for seed in range(12):
        readings, (gyro, acc) = recorded(seed)
        found = tumble.calibrate(readings, flatness=3e-4)
        eye = np.eye(3)
        errors.append([(found.gyroscope_matrix @ gyro.matrix - eye) / found.gyroscope_axes,
                       (found.accelerometer_matrix @ acc.matrix - eye) / found.accelerometer_axes])  # fmt: skip
        assert found.gyroscope_axes < 3e-4
        assert found.accelerometer_axes < 3e-4
        np.testing.assert_allclose(found.gyroscope_bias, gyro.bias.mean(axis=0), atol=5e-4)
    # 108 entries each, not independent: their mean square scatters by less than 0.3 about 1 or somewhat below it.
    square = np.mean(np.square(errors), axis=(0, 2, 3))
    assert np.all(square < 1.5)
    assert np.all(square > 0.3)


def test_what_was_found_is_applied_and_kept(tmp_path):
    readings, _ = recorded(1)
    found = tumble.calibrate(readings, flatness=3e-4)
    rates, forces = imu.apply(found, readings.gyroscope, readings.accelerometer)
    np.testing.assert_allclose(np.linalg.norm(forces[20:80].mean(axis=0)), tumble.G, rtol=1e-3)
    turned = rates[100:250].sum(axis=0) / RATE  # over the first quarter turn, which is about x
    np.testing.assert_allclose(turned, [np.pi / 2, 0, 0], atol=5e-3)
    imu.save({"left": found}, tmp_path / "imus.json")
    kept = imu.load(tmp_path / "imus.json")["left"]
    for one, other in zip(kept, found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_file_from_before_has_an_uncalibrated_gyro(tmp_path):
    (tmp_path / "old.json").write_text(
        '{"a": {"gyroscope_bias": [0, 0, 0], "gyroscope_noise": 0.01, "accelerometer_matrix": '
        '[[1, 0, 0], [0, 1, 0], [0, 0, 1]], "accelerometer_bias": [0, 0, 0], "accelerometer_noise": 0.1}}'
    )
    old = imu.load(tmp_path / "old.json")["a"]
    np.testing.assert_array_equal(old.gyroscope_matrix, np.eye(3))
    assert old.gyroscope_axes == imu.UNCALIBRATED


def test_too_few_faces():
    readings, _ = recorded(2)
    with pytest.raises(InputError, match=r"has 13 rests of at least 0.5 s, expected 5, one a face"):
        tumble.calibrate(readings, tumble.attitudes(tumble.QUARTERS[:4]))
    period = turning.REST + turning.TURN
    part = imu.Readings(*(x[readings.time < 4 * period + turning.REST] for x in readings))
    with pytest.raises(InputError, match="do not tell the accelerometer's axes; expected rests on all six"):
        tumble.calibrate(part, tumble.attitudes(tumble.QUARTERS[:4]))
    # All six faces, but hardly any turn about the case's z.
    turns = [np.eye(3)[k] for k in (0, 0, 0, 0, 1, 1, 1, 1)]
    part = imu.Readings(*(x[readings.time < 8 * period + turning.REST] for x in readings))
    with pytest.raises(InputError, match="8 turns do not tell the gyroscope's axes; expected some about all three"):
        tumble.calibrate(part, tumble.attitudes(turns))
