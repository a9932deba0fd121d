"""One IMU's own recording: which of its readings stand at a limit, and what it would have read at other times."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.filters import savitzky_golay as sg
from jaxest.stamps import around, near

ALIGNING = (3, 5)  # N and M of the fit that brings readings to other times: next to no smoothing
CLIPPED = 3  # equal readings in a row, at the largest value of the axis, that look like a limit and not like chance


class Imu(NamedTuple):
    """One IMU's recording."""

    time: NDArray[np.float64]
    """(n,) s, increasing."""
    gyroscope: NDArray[np.float64]
    """(n, 3) rad/s."""
    accelerometer: NDArray[np.float64]
    """(n, 3) m/s2."""
    clipped: NDArray[np.bool_] | None = None
    """(n, 2) whether gyroscope and accelerometer stood at a limit. None looks for it in the readings, where a
    calibration or another time base would hide it."""


def clipped(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell which of readings (n, 3) stand at a limit of their sensor: the extreme value, again and again in a row."""
    found = np.zeros(values.shape, bool)
    for axis, column in enumerate(np.asarray(values).T):
        there = np.isfinite(column)
        low, high = column.min(initial=np.inf, where=there), column.max(initial=-np.inf, where=there)
        for extreme in (low, high):
            at = column == extreme
            if low < high and any(np.all(at[i : i + CLIPPED]) for i in np.flatnonzero(at)[: -CLIPPED + 1]):
                found[:, axis] |= at
    return np.any(found, axis=1)


def at_limit(imu: Imu) -> NDArray[np.bool_]:
    """Return which readings of gyroscope and accelerometer (n, 2) stand at a limit."""
    if imu.clipped is not None:
        return imu.clipped
    return np.column_stack([clipped(imu.gyroscope), clipped(imu.accelerometer)])


def brought(imu: Imu, time: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Bring an IMU's readings to other times.

    Args:
        imu: the recording.
        time: (T,) s.

    Returns:
        Rates and forces (T, 6), and whether each of the two is there (T, 2): not in a gap nor beside a reading at a
        limit.
    """
    value, there = resampled(imu.time, np.hstack([imu.gyroscope, imu.accelerometer]), time)
    return value, there[:, None] & ~np.any(at_limit(imu)[around(imu.time, time)], axis=1)


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
    return np.asarray(fitted.value, np.float64), np.asarray(fitted.valid) & near(stamps, time)


__all__ = ["Imu", "at_limit", "brought", "clipped", "resampled"]
