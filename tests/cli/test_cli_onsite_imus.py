"""Recordings of `--method onsite`: streams with stamps of their own, limits and calibrations."""

import numpy as np
import pytest

from jaxest.cli.methods import onsite_imus
from jaxest.io import SensorLog, Stream
from jaxest.types import InputError

TIME = np.arange(400) / 100


def moving(time):
    return np.sin(2 * np.pi * np.outer(time, [1.0, 1.3, 1.7]) + [0, 1, 2])


def logged(gyro, force):
    """One IMU whose two sensors have these stamps."""
    return SensorLog({"imu0/gyroscope": Stream(gyro, moving(gyro), "rad/s"),
                      "imu0/accelerometer": Stream(force, 9 * moving(force), "m/s2")})  # fmt: skip


def test_no_forces_are_made_up_where_the_accelerometer_has_a_gap():
    late = TIME + 0.003
    kept = (late < 1) | (late > 2.5)
    kept[50] = False  # one lost sample is no gap
    found = onsite_imus.recording(logged(TIME, late[kept]), "imu0", "error", {})
    assert not ((found.time > 1) & (found.time < 2.5)).any()
    assert len(found.time) == pytest.approx(kept.sum(), abs=3)
    np.testing.assert_allclose(found.accelerometer, 9 * moving(found.time), atol=5e-3)


def test_an_accelerometer_that_cannot_be_brought_to_the_gyro_is_named():
    found = onsite_imus.recording(logged(TIME, TIME[::2]), "imu0", "error", {})
    np.testing.assert_allclose(found.accelerometer, 9 * moving(found.time), atol=1e-2)
    with pytest.raises(InputError, match=r"imu0/accelerometer: 12.5 Hz beside 100 Hz of imu0/gyroscope, expected"):
        onsite_imus.recording(logged(TIME, np.arange(0, 8, 0.08)), "imu0", "error", {})
    with pytest.raises(InputError, match=r"imu0/gyroscope and imu0/accelerometer do not overlap: one from 0.0"):
        onsite_imus.recording(logged(TIME, TIME + 100), "imu0", "error", {})
    with pytest.raises(InputError, match="imu0/accelerometer: 5 samples, expected at least 50"):
        onsite_imus.recording(logged(TIME, TIME[:5]), "imu0", "error", {})
