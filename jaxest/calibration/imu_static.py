"""Bias and noise of an IMU from a rest in a recording, which is found by itself.

Source: Sato 2024, section III-E.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.calibration._recordings import recorded
from jaxest.filters import savitzky_golay as sg
from jaxest.types import InputError

FEWEST = 20
"""Rows in a window at least: the scatter of fewer says too little of the noise."""
QUIET = 1.75
"""Scatter of a rest's windows at most, over that of the recording's quiet ones."""


class Rest(NamedTuple):
    """What a resting IMU says of itself."""

    start: int
    """first row of the rest"""
    stop: int
    """row after the last"""
    gyroscope_bias: NDArray[np.float64]
    """(3,) rad/s"""
    gyroscope_covariance: NDArray[np.float64]
    """(3, 3) (rad/s)^2, of a sample; divide by the number of rows for that of the bias"""
    turn_covariance: NDArray[np.float64]
    """(3, 3) (rad/s^2)^2, of the rate's derivative by the Savitzky-Golay filter"""
    specific_force: NDArray[np.float64]
    """(3,) m/s2, mean"""
    accelerometer_covariance: NDArray[np.float64]
    """(3, 3) (m/s2)^2, of a sample"""


def calibrate(
    time: ArrayLike,
    gyroscope: ArrayLike,
    accelerometer: ArrayLike,
    *,
    least: float = 0.5,
    half_width: int = 7,
    degree: int = 3,
) -> Rest:
    """Find the rest that tells the gyro's bias best, long and quiet, and read bias and noise from it.

    Rest is where both sensors' scatter within a window of `least` seconds, or of `FEWEST` rows where that is longer,
    stays near that of the recording's quiet windows, for that is the sensors' noise, if no less than steps of the
    converter bring; it must look like noise, not like the quietest part of a motion.

    Args:
        time: (n,) s, increasing.
        gyroscope: (n, 3) rad/s.
        accelerometer: (n, 3) m/s2.
        least: s, shortest rest.
        half_width: N of the filter whose derivative's noise is measured.
        degree: M of that filter.

    Returns:
        The rest.

    Raises:
        InputError: shapes or stamps are wrong, values are not finite, or the sensor never rests; the message says how
            quiet it was at best.
    """
    t, w, f, found = _rests(time, gyroscope, accelerometer, least, max(2 * half_width + 2, FEWEST))
    coarse = [rounding(x) ** 2 for x in (w, f)]
    rows = min(found, key=lambda r: np.trace(_covariance(w[r], coarse[0])) / (r.stop - r.start))
    turns = sg.smooth(t[rows], w[rows], half_width=half_width, degree=degree)
    slope, gain = (np.asarray(x, np.float64)[half_width:-half_width] for x in (turns.derivative, turns.derivative_gain))
    return Rest(
        rows.start, rows.stop, w[rows].mean(axis=0), _covariance(w[rows], coarse[0]),
        _covariance(slope, coarse[0] * gain.mean()), f[rows].mean(axis=0), _covariance(f[rows], coarse[1]),
    )  # fmt: skip


def rests(time: ArrayLike, gyroscope: ArrayLike, accelerometer: ArrayLike, *, least: float = 0.5) -> tuple[slice, ...]:
    """Find every rest in a recording; arguments and errors as for `calibrate`.

    Returns:
        The rows of each, in order of time.
    """
    return _rests(time, gyroscope, accelerometer, least, FEWEST)[3]


def rounding(value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard deviation that steps of the converter bring to each channel, (3,) in the reading's unit.

    Args:
        value: (n, 3) readings; their smallest difference is the step, all but 0 where they are not rounded.
    """
    return np.array([np.diff(np.unique(channel)).min(initial=np.ptp(channel)) for channel in value.T]) / np.sqrt(12)


def _covariance(rows: NDArray[np.float64], least: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance (3, 3) of rows (n, 3), with variances of at least `least` (3,)."""
    found = np.cov(rows.T)
    return found + np.diag(np.maximum(least - np.diag(found), 0))


def _rests(
    time: ArrayLike, gyroscope: ArrayLike, accelerometer: ArrayLike, least: float, fewest: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], tuple[slice, ...]]:
    """The recording, checked, and the rows of its rests."""
    t, w, f = recorded(("time", time), gyroscope=gyroscope, accelerometer=accelerometer)
    width = max(round(least / float(np.median(np.diff(t)))), fewest)
    if len(t) < width:
        raise InputError(f"time: got {len(t)} samples, expected at least {width}, {least} s")
    scatter = [_scatter(x, width) for x in (w, f)]
    best = [float(s.min()) for s in scatter]
    if best[0] > 0.05 or best[1] > 0.3:
        raise InputError(
            f"the sensor never rests: at its quietest the gyro scatters by {best[0]:.3f} rad/s and the accelerometer "
            f"by {best[1]:.3f} m/s2 within {least} s, expected at most 0.05 and 0.3"
        )
    quiet = np.all([s <= _limit(s, x) for s, x in zip(scatter, (w, f), strict=True)], axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], quiet.astype(int), [0]])))
    if len(edges) == 0:
        raise InputError("recording: gyro and accelerometer are never quiet together; let it rest for some seconds")
    runs = zip(edges[::2], edges[1::2], strict=True)
    return t, w, f, tuple(slice(int(start), int(stop) - 1 + width) for start, stop in runs)


def _limit(scatter: NDArray[np.float64], value: NDArray[np.float64]) -> float:
    """Scatter of a window up to which it is at rest. One window may be quiet by chance, the median of many is not."""
    scatter = np.maximum(scatter, rounding(value).max())
    return 1e-9 + QUIET * float(np.median(scatter[scatter <= QUIET * scatter.min()]))


def _scatter(x: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Largest standard deviation over the axes within each window of `width` rows."""
    x = x - x.mean(axis=0)
    sums = [np.vstack([np.zeros((1, 3)), np.cumsum(v, axis=0)]) for v in (x, x * x)]
    mean, square = ((s[width:] - s[:-width]) / width for s in sums)
    return np.sqrt(np.maximum(square - mean**2, 0)).max(axis=1)


__all__ = ["Rest", "calibrate", "rests"]
