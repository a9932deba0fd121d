"""Recordings of `--method onsite`: streams with stamps of their own, limits and calibrations."""

import numpy as np
import pytest

from jaxest.calibration import imu as calibration
from jaxest.cli.methods import onsite_imus
from jaxest.io import SensorLog, Stream
from jaxest.systems.onsite_recording import brought
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


@pytest.mark.parametrize("late", [0.0, 0.003])
def test_a_calibration_does_not_hide_what_stands_at_a_limit(late):
    log = logged(TIME, TIME + late)
    flat = Stream(TIME + late, np.clip(log.streams["imu0/accelerometer"].value, -8.5, 8.5), "m/s2")
    log.streams["imu0/accelerometer"] = flat
    askew = np.eye(3) + 0.01 * np.random.default_rng(0).normal(size=(3, 3))
    known = {"imu0": calibration.Calibration(np.full(3, 0.1), 0.01, askew, np.zeros(3), 0.1)}
    imu = onsite_imus.recording(log, "imu0", "error", known)
    expected = np.any(np.abs(9 * moving(imu.time)) > 8.6, axis=1)
    assert expected.any()
    assert imu.clipped[expected, 1].all()
    assert not imu.clipped[np.all(np.abs(9 * moving(imu.time)) < 8, axis=1)].any()
    there = brought(imu, imu.time[:-1] + 0.005)[1]
    assert not there[expected[:-1], 1].any()
    assert there[:, 0].all()


def test_a_calibration_of_other_names_is_refused_and_what_it_is_of_is_said(tmp_path):
    one = calibration.Calibration(np.zeros(3), 0.01, np.eye(3), np.zeros(3), 0.1)
    file = tmp_path / "imus.json"
    calibration.save({"imu0": one, "IMU_1": one}, file)
    known, notes = onsite_imus.calibrations({"calibration": str(file)}, ["imu0", "imu1"])
    assert set(known) == {"imu0", "IMU_1"}
    assert notes == [f"{file}: calibration of imu0; not of imu1, taken as they come"]
    with pytest.raises(InputError, match=r"imus.json: calibration of 'imu2' does not exist; did you mean 'imu0'"):
        onsite_imus.calibrations({"calibration": str(file)}, ["imu2", "imu3"])
    assert onsite_imus.calibrations({}, ["imu0"]) == ({}, [])
