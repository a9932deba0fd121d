"""All four families of recordings are read."""

import numpy as np
import pytest

from jaxest.io import propose, read, summarize, ticks
from jaxest.types import InputError

pytestmark = pytest.mark.recorded


@pytest.fixture
def recordings(shared):
    return shared / "recordings"


def test_broad_needs_no_table(recordings):
    paths = sorted((recordings / "broad").glob("*.npz"))
    assert len(paths) == 20
    for path in paths:
        log = read(path)
        with np.load(path) as arrays:
            np.testing.assert_array_equal(log.streams["gyroscope"].value, arrays["gyr"])
            np.testing.assert_array_equal(log.streams["accelerometer"].value, arrays["acc"])
            np.testing.assert_allclose(log.streams["magnetometer"].value, 1e-6 * arrays["mag"], rtol=1e-6)
            np.testing.assert_array_equal(log.streams["orientation"].value, arrays["quat"])  # NaN kept
            np.testing.assert_array_equal(log.streams["movement"].value, arrays["movement"])
            np.testing.assert_allclose(log.streams["gyroscope"].time, np.arange(len(arrays["gyr"])) / arrays["fs"])
        assert log.streams["movement"].value.dtype == bool
        assert {s.value.dtype for n, s in log.streams.items() if n != "movement"} == {np.dtype(np.float32)}


def test_a_broad_trial_as_steps(recordings):
    log = read(recordings / "broad" / "02_undisturbed_slow_rotation_B.npz")
    n = len(log.streams["gyroscope"].time)
    with pytest.raises(InputError, match=r"orientation.*row 0 at .*1706 of 53240"):
        ticks(log)
    steps = ticks(log, nan="invalid")
    assert steps.dt.shape == (n,)
    assert steps.dt.dtype == np.float32
    assert steps.readings["gyroscope"].valid.all()
    assert (~steps.readings["orientation"].valid).sum() == 1706
    assert all(np.isfinite(r.value).all() for r in steps.readings.values())


def test_kuka_needs_no_table(recordings):
    log = read(recordings / "kuka_lwr4" / "measurements_1.npz")
    for name, si in [("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s2"), ("torque", "Nm")]:
        stream = log.streams[f"joint_{name}"]
        assert stream.value.shape == (5027, 7)
        assert stream.unit == si
    assert log.streams["joint_position"].time[0] > 1.4e9
    assert "target/joint_position" in log.streams


def test_panda_has_two_clocks_and_gaps(recordings):
    log = read(recordings / "franka_panda" / "exciting_traj_1.npz")
    assert len(log.streams["joint_torque"].time) == 20544
    assert len(log.streams["cmd/joint_velocity"].time) == 20545
    summary = {s.name: s for s in summarize(log).streams}
    assert summary["joint_position"].gaps.number == 4
    assert summary["joint_position"].gaps.longest == pytest.approx(8.81e-3)
    assert summary["joint_position"].saturated == ()


def test_two_imus_need_an_answer(recordings):
    path = recordings / "two_imus_200mm" / "twoimus_200mm_sample.npz"
    with pytest.raises(InputError, match=r'(?s)imu0 \(1387, 8\).*\[columns\."imu0/gyroscope"\]'):
        read(path)
    columns = {"gyroscope": [2, 3, 4], "accelerometer": [5, 6, 7]}
    table = {
        f"{imu}/{kind}": {"array": imu, "columns": part, "time": 0} for imu in ("imu0", "imu1")
        for kind, part in columns.items()
    }  # fmt: skip
    log = read(path, table)
    with np.load(path) as arrays:
        np.testing.assert_array_equal(log.streams["imu1/gyroscope"].value, arrays["imu1"][:, 2:5])
        np.testing.assert_array_equal(log.streams["imu1/accelerometer"].time, arrays["imu1"][:, 0])
    guess = propose(path).table
    assert {n: (c.array, c.columns) for n, c in guess.streams.items()} == {
        n: (c["array"], tuple(c["columns"])) for n, c in table.items()
    }
    skew = {s.name: s for s in summarize(log).skews}
    assert abs(skew["imu0/gyroscope"].start) == pytest.approx(8.324e-3, abs=1e-6)


def test_units_that_look_wrong_are_seen_and_none_is_seen_where_all_is_right(recordings):
    for path in sorted((recordings / "broad").glob("*.npz"))[::4]:
        log = read(path)
        right = [w for w in summarize(log).warnings if "expected numbers" not in w]
        assert right == [], path.name
        wrong = dict(log.streams)
        for name, factor in [("gyroscope", 180 / np.pi), ("accelerometer", 1 / 9.80665), ("magnetometer", 1e6)]:
            wrong[name] = wrong[name]._replace(value=(wrong[name].value * factor).astype(np.float32))
        warnings = " ".join(summarize(log._replace(streams=wrong)).warnings)
        for word in ("is it in deg/s", "is it in g?", "is it in uT?"):
            assert word in warnings, (path.name, word)
