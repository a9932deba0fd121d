"""Recordings of `--method onsite`: streams with stamps of their own, limits and calibrations."""

import numpy as np
import pytest

from jaxest.calibration import imu as calibration
from jaxest.cli.methods import onsite_imus, onsite_robot
from jaxest.io import SensorLog, Stream
from jaxest.systems.onsite_recording import Imu, brought, refuse_loose
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


def test_each_link_of_a_robot_is_checked_as_that_of_two_imus():
    time = np.arange(600) / 100
    noise = 0.01 * np.random.default_rng(3).normal(size=(4, 600, 3))
    a, p = (Imu(time, moving(time) + w, 9 * moving(time) + f) for w, f in (noise[:2], noise[2:]))
    names = [("imu0", "imu1")]
    (found,), notes = onsite_robot._agreed(names, [(a, p._replace(time=time + 0.02))])
    np.testing.assert_allclose(found[1].time, time, atol=1e-3)
    assert notes[0].startswith("imu1's clock shows +")
    with pytest.raises(InputError, match=r"imu1/accelerometer: saturated in .* % of the samples"):
        onsite_robot._agreed(names, [(a, p._replace(accelerometer=np.clip(p.accelerometer, -7, 7)))])
    with pytest.raises(InputError, match="imu0 and imu1 are not on one rigid link: their rates differ by"):
        onsite_robot._agreed(names, [(a, p._replace(gyroscope=p.gyroscope * [1, 1, -1]))])
    with pytest.raises(
        InputError, match=r"link, or a sensor's axis points the wrong way: their forces differ by 3 m/s2"
    ):
        refuse_loose(names[0], "forces", a.accelerometer, p.accelerometer, 3.0)
    refuse_loose(names[0], "forces", a.accelerometer, p.accelerometer, 1.5)
