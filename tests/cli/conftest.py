import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from jaxest.cli.app import app
from jaxest.io import SensorLog, Stream

RATE = np.array([0.3, -0.2, 0.4])  # rad/s in the sensor, constant
START = Rotation.from_euler("ZYX", [0.5, 0.2, -0.3])


def orientation(time):
    """(n, 4) wxyz, sensor to earth, of a sensor that turns at a constant rate."""
    return np.roll((START * Rotation.from_rotvec(np.outer(time, RATE))).as_quat(), 1, axis=-1)


def seen(time, vector):
    """(n, 3) what the sensor sees of a vector of the earth frame."""
    return (START * Rotation.from_rotvec(np.outer(time, RATE))).inv().apply(vector)


def turning(n=200, hz=100.0, magnetometer=True, truth=False, start=0.0):
    """A log of ideal sensors."""
    time = np.arange(n) / hz
    streams = {
        "gyroscope": Stream(start + time, np.tile(RATE, (n, 1)), "rad/s"),
        "accelerometer": Stream(start + time, seen(time, [0, 0, 9.81]), "m/s2"),
    }
    if magnetometer:
        streams["magnetometer"] = Stream(start + time, seen(time, [0, 18e-6, -41e-6]), "T")
    if truth:
        streams["orientation"] = Stream(start + time, orientation(time), "1")
    return SensorLog(streams)


@pytest.fixture
def invoke(tmp_path, monkeypatch):
    """Run a command in an empty folder, as typed; a traceback of a bug is raised."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("JAXEST_DEBUG", raising=False)

    def call(*words):
        result = CliRunner().invoke(app, [str(word) for word in words])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result

    return call


@pytest.fixture
def refused(invoke):
    """Run a command that must end in one message on standard error, status 2, no traceback; return the message."""

    def call(*words):
        result = invoke(*words)
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("error: ") == 1
        assert "Traceback" not in result.stderr
        return result.stderr

    return call
