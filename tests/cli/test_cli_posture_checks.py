"""What is wrong with an IMU's streams is named before they become a posture."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest.cli.methods import posture_checks
from jaxest.io import SensorLog, Stream
from jaxest.types import InputError

KINDS = ("gyroscope", "accelerometer", "magnetometer")


def turning(**changed):
    """An IMU that turns about all axes, 20 s at 100 Hz; streams replaced by what is given."""
    time = np.arange(2000) / 100
    angles = np.c_[0.8 * np.sin(0.9 * time), 0.7 * np.sin(1.3 * time), 0.9 * np.sin(1.7 * time)]
    path = Rotation.from_euler("ZYX", angles)
    rate = (path[:-1].inv() * path[1:]).as_rotvec() * 100
    noise = np.random.default_rng(0).normal(scale=0.002, size=(3, 2000, 3))
    values = {
        "gyroscope": np.vstack([rate[:1], rate]) + noise[0],
        "accelerometer": path.inv().apply([0, 0, 9.81]) + noise[1],
        "magnetometer": 1e-6 * (path.inv().apply([0, 18.0, -41.0]) + noise[2]),
    }
    units = {"gyroscope": "rad/s", "accelerometer": "m/s2", "magnetometer": "T"}
    streams = {f"hand/{k}": Stream(time, changed[k](v) if k in changed else v, units[k]) for k, v in values.items()}
    return SensorLog(streams)


def test_a_sound_imu_passes():
    assert posture_checks.check(turning(), "hand", KINDS) == []


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        ("accelerometer", lambda v: v / 9.81, "median norm is 1, expected about 9.8 m/s2; is it in g"),
        ("gyroscope", lambda v: np.rad2deg(v), "is it in deg/s"),
        ("gyroscope", lambda v: v[:, [1, 0, 2]], r"its axes are not those.*\(y, x, z\) of the gyroscope would fit"),
        ("gyroscope", lambda v: v * [1, -1, 1], r"\(x, -y, z\) of the gyroscope would fit"),
        ("gyroscope", lambda v: v[:, :2], r"got shape \(2000, 2\), expected \(n, 3\); is an axis missing"),
        ("accelerometer", lambda v: v * [1, 1, 0] + np.array([0, 0, 9.0]), "channel z is constant at 9"),
        ("gyroscope", lambda v: np.clip(v, -0.8, 0.8), "channel x is at .*it is saturated, choose a wider range"),
        ("magnetometer", lambda v: v + np.array([40e-6, 0, 0]), "its norm scatters by .*calibrate it"),
    ],
    ids=["g", "deg/s", "swapped", "mirrored", "missing axis", "constant", "saturated", "uncalibrated"],
)
def test_what_is_wrong_is_named(kind, change, message):
    with pytest.raises(InputError, match=f"'hand/{kind}'.*{message}"):
        posture_checks.check(turning(**{kind: change}), "hand", KINDS)


def test_gaps_are_told():
    log = turning()
    keep = np.r_[0:800, 1100:2000]
    cut = {name: Stream(s.time[keep], s.value[keep], s.unit) for name, s in log.streams.items()}
    notes = posture_checks.check(SensorLog(cut), "hand", KINDS)
    assert len(notes) == 3
    assert "hand/gyroscope has a gap of 3.01 s" in notes[0]
