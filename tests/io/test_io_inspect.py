"""What looks wrong about a log is said, with stream, found and expected; what is right is not."""

import numpy as np
import pytest

from jaxest.io import SensorLog, Stream, summarize
from jaxest.types import InputError

RNG = np.random.default_rng(3)
N = 2000
TIME = 5 + np.arange(N) / 100


def swinging(time=TIME):
    angle = 3 * np.sin(2 * np.pi * 0.3 * time)
    rate = 3 * 2 * np.pi * 0.3 * np.cos(2 * np.pi * 0.3 * time)
    noise = RNG.normal(size=(3, len(time), 3)) * 0.01
    gyr = np.stack([rate, 0 * rate, 0 * rate], 1) + noise[0]
    acc = 9.81 * np.stack([0 * angle, np.sin(angle), np.cos(angle)], 1) + noise[1]
    quat = np.stack([np.cos(angle / 2), np.sin(angle / 2), 0 * angle, 0 * angle], 1)
    mag = np.array([1e-5, 2e-5, -4e-5]) * (1 + noise[2])
    return gyr, acc, mag, quat


def log_of(**changes):
    gyr, acc, mag, quat = swinging()
    streams = {
        "gyroscope": Stream(TIME, gyr, "rad/s"),
        "accelerometer": Stream(TIME, acc, "m/s2"),
        "magnetometer": Stream(TIME, mag, "T"),
        "orientation": Stream(TIME, quat, "1"),
    }
    return SensorLog({**streams, **changes})


def warned(**changes):
    return list(summarize(log_of(**changes)).warnings)


def test_a_good_log_gets_figures_and_only_the_idle_axes_of_its_truth_are_named():
    summary = summarize(log_of())
    assert summary.warnings == ("orientation: column 2, 3 never changes; expected a live channel",)
    first = summary.streams[0]
    assert (first.name, first.n, first.shape, first.unit) == ("gyroscope", N, (3,), "rad/s")
    assert first.rate == pytest.approx(100)
    assert first.duration == pytest.approx((N - 1) / 100)
    assert first.start == 5
    assert first.jitter < 1e-12
    assert first.gaps.number == 0
    assert all(s.rate_ratio == 1 and s.start == 0 for s in summary.skews)


def test_jitter_and_gaps():
    time = TIME + RNG.normal(size=N) * 5e-4
    time[1200:] += 0.3
    time[1500:] += 0.1
    stream = Stream(time, RNG.normal(size=N))
    summary = summarize(SensorLog({"x": stream})).streams[0]
    assert summary.gaps.number == 2
    assert summary.gaps.longest == pytest.approx(0.31, abs=5e-3)
    assert summary.gaps.at == time[1199]
    assert summary.jitter == pytest.approx(5e-4 * np.sqrt(2), rel=0.1)  # sampling error of n = 2000 is 3 %
    assert "2 gaps" in summarize(SensorLog({"x": stream})).warnings[0]


def test_missing_rows_are_counted():
    gyr = swinging()[0]
    gyr[10:20, 1] = np.nan
    summary = summarize(log_of(gyroscope=Stream(TIME, gyr, "rad/s")))
    assert summary.streams[0].missing == 10
    assert any("gyroscope: 10 of 2000 rows" in w for w in summary.warnings)


def test_a_stream_that_is_nan_throughout_is_described():
    summary = summarize(SensorLog({"gyroscope": Stream(TIME, np.full((N, 3), np.nan), "rad/s")}))
    assert summary.streams[0].missing == N


def test_clipped_and_quantised_channels():
    gyr = swinging()[0]
    clipped = Stream(TIME, np.clip(gyr, -4, 4), "rad/s")
    assert summarize(log_of(gyroscope=clipped)).streams[0].saturated == (0,)
    assert any("gyroscope: column 0 sticks" in w for w in warned(gyroscope=clipped))
    slow = np.round(np.sin(0.4 * TIME), 3)  # rests at its turning points
    assert summarize(SensorLog({"x": Stream(TIME, slow)})).streams[0].saturated == ()


@pytest.mark.parametrize(
    ("name", "factor", "words"),
    [
        ("gyroscope", 180 / np.pi, ["gyroscope", "0.0175", "deg/s"]),
        ("accelerometer", 1 / 9.80665, ["accelerometer", "median norm 1", "9.81", "in g?"]),
        ("accelerometer", 30.0, ["accelerometer", "294", "9.81"]),
        ("magnetometer", 1e6, ["magnetometer", "45.8", "uT?"]),
        ("magnetometer", 1e4, ["magnetometer", "0.458", "in G?"]),
        ("orientation", 1.5, ["orientation", "2000 quaternions", "length 1", "row 0", "1.5"]),
    ],
)
def test_wrong_units(name, factor, words):
    item = log_of().streams[name]
    found = [w for w in warned(**{name: item._replace(value=item.value * factor)}) if "never" not in w]
    assert len(found) == 1
    for word in words:
        assert word in found[0]


def test_a_gyroscope_in_degrees_is_seen_beside_an_accelerometer_of_another_rate():
    time = 5 + np.arange(N // 3) * 0.029
    item = log_of().streams["gyroscope"]
    found = warned(
        gyroscope=item._replace(value=np.rad2deg(item.value)), accelerometer=Stream(time, swinging(time)[1], "m/s2")
    )
    assert any(w.startswith("gyroscope") and "deg/s" in w for w in found)


def test_a_gyroscope_alone_is_judged_by_its_size():
    gyr = np.rad2deg(swinging()[0])
    assert "is it in deg/s?" in summarize(SensorLog({"gyroscope": Stream(TIME, gyr, "rad/s")})).warnings[0]


@pytest.mark.parametrize(
    ("order", "word"), [([1, 2, 3, 0], "as xyzw;"), ([0, 1, 2, 3], "wxyz inverse"), ([1, 2, 3, 0], "xyzw")]
)
def test_order_of_quaternions(order, word):
    quat = swinging()[3]
    if "inverse" in word:
        quat = quat * [1, -1, -1, -1]
    found = [w for w in warned(orientation=Stream(TIME, quat[:, order], "1")) if "never" not in w]
    assert len(found) == 1
    assert word in found[0]


@pytest.mark.parametrize("name", ["orientation", "camera/orientation"])
def test_an_earth_with_z_down_is_said(name):
    """The same quaternions in an earth of north, east and down, which a half turn about (1, 1, 0) leads to."""
    w, x, y, z = swinging()[3].T
    ned = np.sqrt(0.5) * np.stack([-x - y, w + z, w - z, y - x], axis=1)
    found = [w for w in warned(**{name: Stream(TIME, ned, "1")}) if "never" not in w]
    assert len(found) == 1
    assert found[0].startswith(f"{name}: puts the measured gravity along [")
    assert "NED" in found[0]


def test_units_that_are_not_si_and_angles_in_degrees():
    gyr = swinging()[0]
    assert any("stated in deg/s" in w for w in warned(gyroscope=Stream(TIME, np.rad2deg(gyr), "deg/s")))
    joints = Stream(TIME, 90 * np.sin(TIME)[:, None], "rad")
    assert any("joint_position" in w and "in deg?" in w for w in warned(joint_position=joints))


def test_clocks():
    away = Stream(TIME + 1e6, RNG.normal(size=N))
    assert any("away" in w and "never overlaps" in w for w in warned(away=away))
    fast = Stream(5 + (TIME - 5) * 0.99, RNG.normal(size=N))
    summary = summarize(log_of(fast=fast))
    assert any(w.startswith("fast") and "equal rate" in w for w in summary.warnings)
    skew = next(s for s in summary.skews if s.name == "fast")
    assert skew.rate_ratio == pytest.approx(1 / 0.99)
    assert skew.end == pytest.approx(-0.01 * (N - 1) / 100)
    shifted = Stream(TIME + 0.004, RNG.normal(size=N))
    assert not any("shifted" in w for w in warned(shifted=shifted))


def test_one_sample_and_an_invalid_log():
    one = summarize(SensorLog({"x": Stream(np.array([1.0]), np.array([2.0]))}))
    assert one.streams[0].duration == 0
    assert one.warnings == ()
    with pytest.raises(InputError, match="empty"):
        summarize(SensorLog({}))
