"""One IMU's own recording, and what it would have read at other times."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.filters import savitzky_golay as sg
from jaxest.stamps import longest

ALIGNING = (3, 5)  # N and M of the fit that brings readings to other times: next to no smoothing


class Imu(NamedTuple):
    """One IMU's recording."""

    time: NDArray[np.float64]
    """(n,) s, increasing."""
    gyroscope: NDArray[np.float64]
    """(n, 3) rad/s."""
    accelerometer: NDArray[np.float64]
    """(n, 3) m/s2."""


def brought(imu: Imu, time: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return an IMU's rates and forces (T, 6) at given times, and whether they are there rather than in a gap (T,)."""
    return resampled(imu.time, np.hstack([imu.gyroscope, imu.accelerometer]), time)


def resampled(
    stamps: NDArray[np.float64], values: NDArray[np.float64], time: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Bring readings to other times.

    Args:
        stamps: (n,) s, increasing.
        values: (n, C) at these.
        time: (T,) s.

    Returns:
        Values (T, C), and whether they are there (T,): between two samples that no gap parts.
    """
    half_width, degree = ALIGNING
    fitted = sg.smooth(stamps, values, query=time, half_width=half_width, degree=degree)
    right = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
    near = stamps[right] - stamps[right - 1] <= longest(stamps)
    return np.asarray(fitted.value, np.float64), np.asarray(fitted.valid) & near


__all__ = ["Imu", "brought", "resampled"]
