"""An IMU's calibration from a rest and slow turning: what it finds, what it refuses, and its file."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest.calibration import alignment, ellipsoid, imu
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
    with pytest.raises(InputError, match="gyroscope: row 7 is not finite"):
        alignment.align(time, np.where(np.arange(len(time))[:, None] == 7, np.nan, rate), force)
    with pytest.raises(InputError, match="time: expected at least two increasing stamps"):
        alignment.align(time[::-1], rate, force)


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


def test_a_sensor_away_from_the_point_it_is_turned_about():
    """12 sensors 0.2 m out: what turning adds is not taken for a bias, and errors are as large as is said."""
    squares, without = [], []
    for seed in range(12):
        time, rate, force = turning(n=3000, hz=50.0, seed=seed)
        random = np.random.default_rng(seed)
        arms = imu._arms(time, rate)
        lever = random.normal(size=3)
        lever *= 0.2 / np.linalg.norm(lever)
        bias = 0.3 * random.normal(size=3)
        gain = 0.02 * random.normal(size=(3, 3))
        matrix = np.eye(3) + (gain + gain.T) / 2
        readings = (force + arms @ lever) @ np.linalg.inv(matrix) + bias + 0.05 * random.normal(size=force.shape)
        noisy = imu._arms(time, rate + 0.01 * random.normal(size=rate.shape))
        found = ellipsoid.fit(readings, turning=noisy)
        np.testing.assert_allclose(found.lever, lever, atol=0.06)
        inverse = np.linalg.inv(found.covariance)
        entries = [matrix[i, j] for i, j in ellipsoid.ENTRIES]
        for one, sums in ((found, squares), (ellipsoid.fit(readings), without)):
            error = np.concatenate([[one.matrix[i, j] for i, j in ellipsoid.ENTRIES], one.bias]) - [*entries, *bias]
            sums.append(error @ inverse @ error)
    # Of nine errors each: 12 x 9 squares.
    assert abs(np.sum(squares) - 108) < 4 * np.sqrt(216)
    assert np.median(without) > 100
    with pytest.raises(InputError, match=r"turning: got shape \(3, 3\), expected \(3000, 3, 3\)"):
        ellipsoid.fit(readings, turning=np.eye(3))


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
    one = one._replace(gyroscope_bias=np.array([0, np.nan, 0]))
    imu.save({"a": one}, tmp_path / "lost.json")
    with pytest.raises(InputError, match=r"a: gyroscope_bias is \[0.0, nan, 0.0\], expected finite numbers"):
        imu.load(tmp_path / "lost.json")
