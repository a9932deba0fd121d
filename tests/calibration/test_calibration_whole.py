"""An IMU's calibration from a rest and slow turning: what it finds, what it refuses, and its file."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest.calibration import alignment, imu
from jaxest.types import InputError


def turning(n=6000, hz=100.0, axes=(1, 1, 1), seed=0):
    """Rates and gravity in a sensor that turns slowly, without noise."""
    time = np.arange(n) / hz
    random = np.random.default_rng(seed)
    rate = np.zeros((n, 3))
    for _ in range(3):
        f, phase = random.uniform(0.02, 0.08, 3), random.uniform(0, 6.3, 3)
        rate += 0.25 * np.sin(2 * np.pi * f * time[:, None] + phase) * axes
    turn, attitude = Rotation.from_rotvec((rate[1:] + rate[:-1]) / 2 / hz), [Rotation.random(random_state=seed)]
    for i in range(n - 1):
        attitude.append(attitude[-1] * turn[i])
    return time, rate, Rotation.concatenate(attitude).inv().apply([0, 0, 9.80665])


@pytest.mark.parametrize("seed", [0, 1])
def test_the_accelerometers_axes_are_found_in_the_gyros(seed):
    time, rate, force = turning(seed=seed)
    random = np.random.default_rng(seed + 10)
    off = Rotation.from_rotvec([0.02, -0.015, 0.03])
    noisy = off.apply(force) + 0.05 * random.normal(size=force.shape)
    found = alignment.align(time, rate + 0.01 * random.normal(size=rate.shape), noisy)
    error = (Rotation.from_matrix(found.rotation) * off).as_rotvec()
    assert np.all(np.abs(error) < 4 * found.deviation)
    assert found.deviation.max() < 2e-3


def test_turning_about_one_axis_does_not_tell():
    time, rate, _ = turning(axes=(0, 0, 1))
    force = np.tile([0, 0, 9.80665], (len(time), 1))  # about the vertical
    with pytest.raises(InputError, match=r"does not tell how the accelerometer is turned about \["):
        alignment.align(time, rate, force + 0.01 * np.random.default_rng(0).normal(size=force.shape))
    with pytest.raises(InputError, match="got 100 samples, expected at least 2000"):
        alignment.align(time[:100], rate[:100], force[:100])


def test_a_sensor_as_it_comes_reads_right_afterwards(tmp_path):
    time, rate, force = turning(n=10000)
    random = np.random.default_rng(5)
    matrix = np.eye(3) + 0.02 * random.normal(size=(3, 3))
    bias, drift = np.array([0.3, -0.2, 0.25]), np.array([0.05, -0.02, 0.01])
    rest = imu.Readings(
        np.arange(1000) / 100,
        drift + 0.01 * random.normal(size=(1000, 3)),
        matrix @ [0, 0, 9.80665] + bias + 0.05 * random.normal(size=(1000, 3)),
    )
    raw = imu.Readings(
        time,
        rate + drift + 0.01 * random.normal(size=rate.shape),
        force @ matrix.T + bias + 0.05 * random.normal(size=force.shape),
    )
    found = imu.calibrate(rest, raw)
    # Of a thousand samples: 0.01 / sqrt(1000), to four standard deviations.
    np.testing.assert_allclose(found.gyroscope_bias, drift, atol=1.3e-3)
    np.testing.assert_allclose(found.gyroscope_noise, 0.01, rtol=0.1)
    _, corrected = imu.apply(found, raw.gyroscope, force @ matrix.T + bias)
    assert np.abs(corrected - force).max() < 0.03  # was 0.5
    imu.save({"imu0": found}, tmp_path / "imus.json")
    back = imu.load(tmp_path / "imus.json")["imu0"]
    for a, b in zip(back, found, strict=True):
        np.testing.assert_array_equal(a, b)
    plain = imu.calibrate(rest)
    np.testing.assert_array_equal(plain.accelerometer_matrix, np.eye(3))


def test_files_that_are_no_calibration(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        imu.load(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(InputError, match="not a calibration"):
        imu.load(tmp_path / "bad.json")
    (tmp_path / "short.json").write_text('{"a": {"gyroscope_bias": [1]}}')
    with pytest.raises(InputError, match="not a calibration: KeyError"):
        imu.load(tmp_path / "short.json")
    one = imu.Calibration(np.zeros(2), 0.1, np.eye(3), np.zeros(3), 0.1)
    imu.save({"a": one}, tmp_path / "shape.json")
    with pytest.raises(InputError, match=r"a: gyroscope_bias has shape \(2,\), expected \(3,\)"):
        imu.load(tmp_path / "shape.json")
