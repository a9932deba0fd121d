"""TUM trajectories: the order of the quaternion, and what they cannot hold."""

import numpy as np
import pytest

from jaxest.io import SensorLog, Stream, read, write
from jaxest.types import InputError

TEXT = """# timestamp tx ty tz qx qy qz qw
1700000000.25 1 2 3 0.1 0.2 0.3 0.9

1700000000.50 1.5 2 3 0 0 0 1
"""
TIME = np.array([0.1, 0.2, 1 / 3])


def pose(prefix="", **more):
    rng = np.random.default_rng(0)
    quat = rng.normal(size=(3, 4))
    streams = {
        f"{prefix}position": Stream(TIME, rng.normal(size=(3, 3)), "m"),
        f"{prefix}orientation": Stream(TIME, quat / np.linalg.norm(quat, axis=1, keepdims=True), "1"),
    }
    return SensorLog({**streams, **more})


def test_reads_xyzw_as_wxyz(tmp_path):
    (tmp_path / "a.tum").write_text(TEXT)
    log = read(tmp_path / "a.tum")
    np.testing.assert_array_equal(log.streams["position"].time, [1700000000.25, 1700000000.5])
    np.testing.assert_array_equal(log.streams["position"].value, [[1, 2, 3], [1.5, 2, 3]])
    np.testing.assert_array_equal(log.streams["orientation"].value, [[0.9, 0.1, 0.2, 0.3], [1, 0, 0, 0]])
    assert any("xyzw" in line for line in log.notes)


@pytest.mark.parametrize("prefix", ["", "tool/"])
def test_round_trip_is_exact(tmp_path, prefix):
    write(pose(prefix), tmp_path / "a.tum")
    first = (tmp_path / "a.tum").read_text().splitlines()[1].split()
    assert float(first[7]) == pose().streams["orientation"].value[0, 0]  # w last
    log = read(tmp_path / "a.tum")
    for name in ("position", "orientation"):
        np.testing.assert_array_equal(log.streams[name].time, TIME)
        np.testing.assert_array_equal(log.streams[name].value, pose().streams[name].value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TEXT[:-6], r"line 4: 5 numbers, expected 8.*the 1 poses before it can be read"),
        (TEXT.replace("0.9", "zero"), r"line 2:.*'zero'; the 0 poses"),
        ("# nothing\n", "empty"),
        (TEXT.replace("00.50", "00.25"), "duplicate"),
    ],
)
def test_bad_lines(tmp_path, text, words):
    (tmp_path / "a.tum").write_text(text)
    with pytest.raises(InputError, match=words):
        read(tmp_path / "a.tum")


def test_what_it_cannot_hold(tmp_path):
    good = pose()
    bent = good.streams["position"].value.copy()
    bent[1, 0] = np.nan
    late = good.streams["position"]._replace(time=TIME + 1)
    for log, words in (
        (pose(movement=Stream(TIME, np.zeros(3))), "one pose.*movement, orientation, position"),
        (SensorLog({"position": good.streams["position"]}), "one pose"),
        (pose(position=late), "different stamps"),
        (pose(position=Stream(TIME, bent, "m")), "row 1 at 0.200000 s is not finite"),
        (pose(position=good.streams["position"]._replace(unit="mm")), "'mm'"),
    ):
        with pytest.raises(InputError, match=words):
            write(log, tmp_path / "a.tum")
    assert not (tmp_path / "a.tum").exists()
