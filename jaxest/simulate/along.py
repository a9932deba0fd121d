"""What an IMU reads on a motion that is known at samples only, such as one that MuJoCo computed."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.types import InputError


class Samples(NamedTuple):
    """Readings of n intervals between n + 1 poses."""

    gyroscope: NDArray[np.float64]
    """(n, 3) rad/s, in the sensor's axes."""
    accelerometer: NDArray[np.float64]
    """(n, 3) m/s2, specific force in the sensor's axes."""


class Faults(NamedTuple):
    """How bad the IMU is; the defaults are those of `simulate.imu.Sensor`."""

    gyroscope: float = 9e-5
    """rad/s per root Hz, white noise."""
    accelerometer: float = 4e-3
    """m/s2 per root Hz."""
    gyroscope_bias: float = 0.005
    """rad/s, standard deviation of a bias that is drawn once for each axis."""
    accelerometer_bias: float = 0.02
    """m/s2."""


def readings(position: ArrayLike, quaternion: ArrayLike, dt: float, gravity: ArrayLike = (0.0, 0.0, -9.81)) -> Samples:
    """Differentiate poses: the mean rate of each interval, and the specific force at its middle.

    Args:
        position: (n + 1, 3) m, of the sensor in the world.
        quaternion: (n + 1, 4) wxyz, sensor to world.
        dt: s, between samples.
        gravity: (3,) m/s2.

    Returns:
        The readings without faults.

    Raises:
        InputError: fewer than three poses, or not as many of both.
    """
    from scipy.spatial.transform import Rotation

    place, turns = np.asarray(position, float), np.asarray(quaternion, float)
    if len(place) < 3 or len(place) != len(turns):
        raise InputError(
            f"position, quaternion: {len(place)} and {len(turns)} rows, expected as many, and three or more"
        )
    turn = Rotation.from_quat(turns[:, [1, 2, 3, 0]])
    rate = (turn[:-1].inv() * turn[1:]).as_rotvec() / dt
    speed = np.diff(place, axis=0) / dt
    # Accelerations at the inner samples; those of an interval are the mean of its ends'.
    inner = np.diff(speed, axis=0) / dt
    ends = np.concatenate([inner[:1], inner, inner[-1:]])
    push = (ends[:-1] + ends[1:]) / 2 - np.asarray(gravity, float)
    middle = turn[:-1] * Rotation.from_rotvec(rate * dt / 2)
    return Samples(rate, middle.inv().apply(push))


def spoiled(samples: Samples, faults: Faults, dt: float, seed: int) -> Samples:
    """Add white noise and constant biases, drawn from a seed, to readings `dt` s apart."""
    random = np.random.default_rng([seed, 7007])
    found = []
    for clean, density, bias in (
        (samples.gyroscope, faults.gyroscope, faults.gyroscope_bias),
        (samples.accelerometer, faults.accelerometer, faults.accelerometer_bias),
    ):
        white = density / np.sqrt(dt) * random.standard_normal(clean.shape)
        found.append(clean + bias * random.standard_normal(3) + white)
    return Samples(*found)


__all__ = ["Faults", "Samples", "readings", "spoiled"]
