"""Streams as one sequence of steps: nothing lost, nothing made up unless asked."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from jaxest.io import SensorLog, Stream, interpolate, ticks
from jaxest.types import InputError


def log_of(**stamps):
    """A log whose values are the stamps themselves."""
    return SensorLog({name: Stream(np.asarray(t, float), np.asarray(t, float)) for name, t in stamps.items()}, "run")


def test_a_step_for_each_stamp_by_hand():
    steps = ticks(log_of(gyr=[0.0, 0.1, 0.2, 0.3], mag=[0.05, 0.1, 0.4]))
    np.testing.assert_array_equal(steps.time, [0, 0.05, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(steps.dt, [0, 0.05, 0.05, 0.1, 0.1, 0.1])
    np.testing.assert_array_equal(steps.readings["gyr"].valid, [1, 0, 1, 1, 1, 0])
    np.testing.assert_array_equal(steps.readings["mag"].valid, [0, 1, 1, 0, 0, 1])
    np.testing.assert_array_equal(steps.readings["mag"].value, [0, 0.05, 0.1, 0, 0, 0.4])


def test_tolerance_by_hand():
    # 0.101 is nearest to tick 0.1 and joins; 0.104 wants it too and makes its own; 0.15 is too far from any
    log = log_of(gyr=[0.0, 0.1, 0.2, 0.3], mag=[0.101, 0.104, 0.15, 0.297])
    steps = ticks(log, tolerance=0.005)
    np.testing.assert_array_equal(steps.time, [0, 0.1, 0.104, 0.15, 0.2, 0.3])
    np.testing.assert_array_equal(steps.readings["mag"].value, [0, 0.101, 0.104, 0.15, 0, 0.297])
    np.testing.assert_array_equal(steps.readings["gyr"].valid, [1, 1, 0, 0, 1, 1])


def test_columns_apart_are_missing_each_on_its_own():
    value = np.array([[1.0, np.nan], [2.0, 20.0], [np.nan, np.nan]])
    log = SensorLog({name: Stream(np.arange(3.0), value) for name in ("encoders", "imu")})
    apart, rows = ticks(log, nan="invalid", apart=["encoders"]).readings.values()
    np.testing.assert_array_equal(apart.valid, [[1, 0], [1, 1], [0, 0]])
    np.testing.assert_array_equal(apart.value, [[1, 0], [2, 20], [0, 0]])
    np.testing.assert_array_equal(rows.valid, [0, 1, 0])
    np.testing.assert_array_equal(rows.value, [[0, 0], [2, 20], [0, 0]])


GRID = st.lists(st.integers(0, 60), min_size=1, max_size=15, unique=True).map(sorted)


@settings(max_examples=150, deadline=None)
@given(st.lists(GRID, min_size=1, max_size=4), st.sampled_from([0.0, 1.0, 2.0, 7.0]))
def test_every_sample_is_in_one_step_in_order(stamps, tolerance):
    names = [f"s{i}" for i in range(len(stamps))]
    steps = ticks(log_of(**dict(zip(names, stamps, strict=True))), tolerance=tolerance)
    assert (np.diff(steps.time) > 0).all()
    used = np.zeros(len(steps.time), bool)
    for name, time in zip(names, stamps, strict=True):
        value, valid = steps.readings[name]
        np.testing.assert_array_equal(value[valid], time)
        assert (np.abs(value[valid] - steps.time[valid]) <= tolerance).all()
        assert (value[~valid] == 0).all()
        used |= valid
    assert used.all()
    if tolerance == 0:
        np.testing.assert_array_equal(steps.time, np.unique(np.concatenate(stamps)))


def test_steps_are_differenced_before_they_are_cast():
    time = 1.7e9 + np.arange(1000) * 1e-3
    log = SensorLog({"gyroscope": Stream(time, np.zeros((1000, 3), np.float32))})
    steps = ticks(log)
    assert steps.dt.dtype == np.float32
    assert steps.time.dtype == np.float64
    assert steps.dt[0] == 0
    np.testing.assert_allclose(steps.dt[1:], 1e-3, atol=3e-7)  # a float64 stamp of today resolves 0.24 us
    assert ticks(log, dtype=np.float64).readings["gyroscope"].value.dtype == np.float64
    assert ticks(log, dtype=np.float64).dt.dtype == np.float64


def test_a_million_samples_are_merged_whole():
    rng = np.random.default_rng(0)
    fast = np.cumsum(rng.uniform(0.5e-3, 1.5e-3, 1_000_000))
    slow = np.cumsum(rng.uniform(5e-3, 15e-3, 90_000))
    steps = ticks(log_of(fast=fast, slow=slow), tolerance=1e-4)
    assert steps.readings["fast"].valid.sum() == len(fast)
    np.testing.assert_array_equal(steps.readings["slow"].value[steps.readings["slow"].valid], slow)


def test_flags_keep_their_type_and_shapes_survive():
    log = SensorLog(
        {
            "zones": Stream(np.arange(3.0), np.ones((3, 8, 8), np.float32)),
            "contact": Stream(np.arange(1.0, 3.0), np.array([True, True])),
        }
    )
    steps = ticks(log, dtype=np.float64)
    assert steps.readings["zones"].value.shape == (3, 8, 8)
    assert steps.readings["contact"].value.dtype == bool
    np.testing.assert_array_equal(steps.readings["contact"].value, [False, True, True])


def test_nan_is_refused_or_masked():
    log = log_of(a=[0.0, 1.0, 2.0])
    log.streams["a"].value[1] = np.inf
    with pytest.raises(InputError, match=r"run: stream 'a': row 1 at 1\.0"):
        ticks(log)
    steps = ticks(log, nan="invalid")
    np.testing.assert_array_equal(steps.readings["a"].valid, [True, False, True])
    np.testing.assert_array_equal(steps.readings["a"].value, [0, 0, 2])
    for function in (lambda nan: ticks(log, nan=nan), lambda nan: interpolate(log, None, [0.5], nan=nan)):
        with pytest.raises(ValueError, match="'error' or 'invalid'"):
            function("drop")


def test_bad_arguments():
    log = log_of(gyroscope_raw=[0.0, 1.0], mag=[5.0])
    with pytest.raises(InputError, match="did you mean 'gyroscope_raw'"):
        ticks(log, ["gyroscope"])
    with pytest.raises(ValueError, match="names"):
        ticks(log, "mag")
    with pytest.raises(ValueError, match="tolerance"):
        ticks(log, tolerance=-1.0)
    with pytest.raises(InputError, match="duplicate"):
        ticks(log_of(a=[0.0, 0.0]))
    for times in ([], [1.0, 0.0], [np.nan], [[0.0]]):
        with pytest.raises(InputError, match="times"):
            interpolate(log, None, times)
    assert ticks(log, ["mag"]).time.tolist() == [5.0]


def test_linear_interpolation_inside_and_nothing_outside():
    log = SensorLog(
        {
            "a": Stream(np.array([0.0, 1.0, 3.0]), np.array([[0.0, 10], [2, 20], [6, 0]], np.float32)),
            "flag": Stream(np.array([0.5, 1.0]), np.array([1, 2])),
        }
    )
    steps = interpolate(log, None, [-0.1, 0.0, 0.25, 1.0, 2.0, 3.0, 3.1])
    np.testing.assert_array_equal(steps.readings["a"].valid, [0, 1, 1, 1, 1, 1, 0])
    np.testing.assert_allclose(steps.readings["a"].value, [[0, 0], [0, 10], [0.5, 12.5], [2, 20], [4, 10], [6, 0],
                                                           [0, 0]])  # fmt: skip
    assert steps.readings["a"].value.dtype == np.float32
    np.testing.assert_array_equal(steps.readings["flag"].valid, [0, 0, 0, 1, 0, 0, 0])
    gap = interpolate(log, ["a"], [0.5, 1.0, 2.0, 3.0], max_gap=1.5)
    np.testing.assert_array_equal(gap.readings["a"].valid, [1, 1, 0, 1])


def test_interpolation_beside_a_missing_sample_is_invalid():
    log = log_of(a=[0.0, 1.0, 2.0, 3.0])
    log.streams["a"].value[1] = np.nan
    steps = interpolate(log, None, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5], nan="invalid")
    np.testing.assert_array_equal(steps.readings["a"].valid, [1, 0, 0, 0, 1, 1])
    assert np.isfinite(steps.readings["a"].value).all()
    with pytest.raises(InputError, match="row 1"):
        interpolate(log, None, [0.5])


def test_quaternions_go_along_the_great_circle():
    rng = np.random.default_rng(1)
    time = np.arange(30.0)
    rotations = Rotation.random(30, rng=rng)
    quat = np.roll(rotations.as_quat(), 1, axis=1) * rng.choice([-1, 1], (30, 1))  # wxyz, of either sign
    quat[5] = quat[4]
    quat[6] = -quat[5]
    times = np.sort(rng.uniform(0, 29, 200))
    found = interpolate(SensorLog({"imu/orientation": Stream(time, quat, "1")}), None, times).readings
    value = found["imu/orientation"].value
    expected = Slerp(time, Rotation.from_quat(np.roll(quat, -1, axis=1)))(times)
    error = (expected.inv() * Rotation.from_quat(np.roll(value, -1, axis=1))).magnitude()
    assert error.max() < 1e-12
    np.testing.assert_allclose(np.linalg.norm(value, axis=1), 1, atol=1e-14)
