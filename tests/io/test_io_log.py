"""What every log must satisfy, and what is said where it does not."""

import numpy as np
import pytest

from jaxest.io import SensorLog, Stream, check, stream, to_si
from jaxest.types import InputError

TIME = np.arange(5) * 0.01


def log_of(name="gyroscope", time=TIME, value=None, **kwargs):
    value = np.zeros((len(time), 3), np.float32) if value is None else value
    return SensorLog({name: Stream(time, value, **kwargs)}, "run.npz")


def changed(row, stamp):
    time = TIME.copy()
    time[row] = stamp
    return time


@pytest.mark.parametrize(
    ("log", "words"),
    [
        (SensorLog({}, "run.npz"), ["run.npz", "empty"]),
        (log_of(time=np.zeros(0)), ["gyroscope", "empty"]),
        (log_of(time=changed(3, 0.02)), ["row 3", "duplicate", "0.020000000", "row 2"]),
        (log_of(time=changed(3, 0.005)), ["row 3", "earlier", "0.005000000", "row 2"]),
        (log_of(time=changed(1, np.nan)), ["row 1", "nan"]),
        (log_of(time=TIME.astype(np.float32)), ["float32", "float64"]),
        (log_of(value=np.zeros((4, 3))), ["(4, 3)", "(5,)", "lengths"]),
        (log_of(value=np.zeros((5, 2))), ["(5, 2)", "(n, 3)"]),
        (log_of(time=np.arange(3.0), value=np.zeros((3, 5))), ["transposed"]),
        (log_of(value=np.zeros((5, 3), complex)), ["complex128"]),
        (log_of(value=np.zeros((5, 3), object)), ["object"]),
        (log_of(value=[[0, 0, 0]] * 5), ["list"]),
        (log_of(names=("a", "b")), ["2 names", "3 columns"]),
        (log_of(name="../x", value=np.zeros(5)), ["../x", "imu0/gyroscope"]),
        (log_of(name="a//b", value=np.zeros(5)), ["a//b"]),
        (log_of(name="", value=np.zeros(5)), ["usable name"]),
    ],
)
def test_check_names_what_is_wrong(log, words):
    with pytest.raises(InputError) as error:
        check(log)
    for word in ["run.npz", *words]:
        assert word in str(error.value)


def test_nan_is_a_missing_sample_unless_refused():
    value = np.zeros((5, 3), np.float32)
    value[2, 1] = np.nan
    log = log_of(value=value)
    assert check(log) is log
    with pytest.raises(InputError, match=r"gyroscope.*row 2 at 0\.020000 s.*1 of 5"):
        check(log, nan="error")
    with pytest.raises(ValueError, match="nan"):
        check(log, nan="drop")


def test_unknown_stream_gets_the_closest():
    with pytest.raises(InputError, match="'gyroscope'"):
        stream(log_of(), "gyro")
    assert stream(log_of(), "gyroscope").value.shape == (5, 3)


def test_to_si_converts_what_is_stated_and_keeps_the_rest():
    log = log_of(value=np.full((5, 3), 180, np.float32), unit="deg/s")
    log.streams["battery"] = Stream(TIME, np.ones(5), "furlong")
    si = to_si(log)
    assert si.streams["gyroscope"].unit == "rad/s"
    assert si.streams["gyroscope"].value.dtype == np.float32
    np.testing.assert_allclose(si.streams["gyroscope"].value, np.pi, rtol=1e-6)
    assert si.streams["battery"] == log.streams["battery"]
    with pytest.raises(InputError, match="gyroscope"):
        to_si(log_of(unit="deg"))
