"""Logs of ideal sensors on something that turns at a constant rate, whose orientation is known exactly."""

import numpy as np
from scipy.spatial.transform import Rotation

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
