"""What the numbers themselves say about their unit and order: gravity, the earth's field, rotation of the gravity."""

import itertools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# Bands of the median norm; a resting accelerometer reads one g, the earth's field is 22 to 67 uT.
_GRAVITY = {"m/s2": (6.0, 15.0), "g": (0.6, 1.5)}
_FIELD = {"uT": (15.0, 100.0), "mG": (150.0, 1000.0), "nT": (15e3, 100e3), "mT": (0.015, 0.1), "T": (15e-6, 100e-6)}
_FIELD_G, _FIELD_1 = (0.15, 0.9), (0.9, 1.1)
FASTEST = 70.0  # rad/s: twice the range of common gyroscopes
_SHARE = 99  # percent of the samples that must be slower
_SLOWEST = 1.5  # s between two samples that nobody doubts: 1 Hz, and its jitter


def _finite(value: NDArray[Any]) -> NDArray[np.float64]:
    """Return the values as float64 with NaN for what is not finite or too large to be squared."""
    found = np.asarray(value, np.float64)
    return np.where(np.abs(found) < 1e100, found, np.nan)


def median_norm(value: NDArray[Any]) -> float:
    """Return the median norm of the finite rows.

    Args:
        value: (n, k).

    Returns:
        The median, NaN where no row is finite.
    """
    rows = _finite(value)
    rows = rows[np.isfinite(rows).all(axis=1)]
    return float(np.median(np.linalg.norm(rows, axis=1))) if len(rows) else float("nan")


def acceleration_unit(value: NDArray[Any]) -> str:
    """Return the unit that an accelerometer's readings (n, 3) must be in, or nothing where their size fits none."""
    norm = median_norm(value)
    return next((unit for unit, (low, high) in _GRAVITY.items() if low <= norm <= high), "")


def field_unit(value: NDArray[Any]) -> str:
    """Return the unit that a magnetometer's readings (n, 3) must be in, `1` where only their direction is of use."""
    norm = median_norm(value)
    bands = {**_FIELD, "G": _FIELD_G, "1": _FIELD_1}
    return next((unit for unit, (low, high) in bands.items() if low <= norm <= high), "1")


def time_unit(stamps: NDArray[Any]) -> str:
    """Return the unit of stamps (n,) from their size since 1970 and their step; nothing where it is open.

    A clock in us that has run for a week reads as ms since 1970, but then ticks a thousand times too slowly.
    """
    if stamps.dtype.kind == "M" or len(stamps) < 2:
        return "s"
    step = float(np.median(np.diff(stamps.astype(np.float64))))
    for unit, per_second in (("ns", 1e9), ("us", 1e6), ("ms", 1e3), ("s", 1.0)):
        if 5e8 < float(stamps[0]) / per_second < 5e9:  # 1985 to 2128
            return "" if step / per_second > _SLOWEST and likely_time_unit(step) else unit
    return "s" if step < 0.5 else ""


def likely_time_unit(step: float) -> str:
    """Return the unit in which stamps a `step` apart make a rate between 1 Hz and 5 kHz, or nothing."""
    usual = {"ms": 1e3, "us": 1e6, "ns": 1e9}
    return next((unit for unit, per_second in usual.items() if 1 <= per_second / max(step, 1e-9) <= 5e3), "")


def too_fast(gyr: NDArray[Any]) -> bool:
    """Say whether the rates (n, 3) are beyond what a gyroscope measures, if they were rad/s."""
    norm = np.linalg.norm(_finite(gyr), axis=1)
    norm = norm[np.isfinite(norm)]
    return bool(len(norm)) and bool(np.percentile(norm, _SHARE) > FASTEST)


class RateCheck(NamedTuple):
    """How far the measured gravity turned, against the integrated gyroscope."""

    ratio: float
    """1 where the gyroscope is in rad/s, pi/180 where it is in deg/s; NaN where nothing turned."""
    correlation: float


def rate_check(time: NDArray[np.float64], gyr: NDArray[Any], acc: NDArray[Any], window: float = 0.04) -> RateCheck:
    """Compare the rotation of the accelerometer's direction with the gyroscope.

    Means over short blocks are compared: between two blocks the direction u changes by -(omega T) x u.

    Args:
        time: (n,) s.
        gyr: (n, 3), taken as rad/s.
        acc: (n, 3), any unit.
        window: length of a block, s.

    Returns:
        The regression of what is seen on what is predicted, and their correlation.
    """
    dt = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    size = max(1, round(window / dt)) if dt > 0 else 1
    count = len(time) // size
    if count < 20:
        return RateCheck(float("nan"), 0.0)
    rate, force = (
        _finite(v)[: count * size].reshape(count, size, 3).mean(axis=1) for v in (gyr, acc)
    )  # fmt: skip
    u = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-12)
    step = (time[size : count * size : size] - time[: (count - 1) * size : size])[:, None]
    predicted = -np.cross(0.5 * (rate[1:] + rate[:-1]) * step, 0.5 * (u[1:] + u[:-1]))
    seen = np.diff(u, axis=0)
    use = np.isfinite(predicted).all(axis=1) & np.isfinite(seen).all(axis=1) & (step[:, 0] < 3 * size * dt)
    both = float(np.sum(predicted[use] * seen[use]))
    size_p, size_s = float(np.sum(predicted[use] ** 2)), float(np.sum(seen[use] ** 2))
    if size_p == 0 or size_s == 0:
        return RateCheck(float("nan"), 0.0)
    return RateCheck(both / size_p, both / float(np.sqrt(size_p * size_s)))


def in_degrees(check: RateCheck) -> bool | None:
    """Say whether a gyroscope is in deg/s: yes, no, or None where the motion does not tell."""
    if not check.correlation > 0.2:
        return None
    return True if 0.005 < check.ratio < 0.06 else False if 0.3 < check.ratio < 3.0 else None


def quaternion_order(quat: NDArray[Any], acc: NDArray[Any]) -> str:
    """Tell the order and direction of quaternions from where they put the measured gravity.

    Turned into the earth frame by the right convention, the accelerometer's mean keeps its length; by a wrong one it
    averages out, provided that the sensor was turned about.

    Args:
        quat: (n, 4).
        acc: (n, 3) at the same times, any unit.

    Returns:
        `wxyz`, `xyzw`, either followed by ` inverse` where they map earth to sensor, or nothing where it cannot be
        told.
    """
    q, a = _finite(quat), _finite(acc)
    rows = np.isfinite(q).all(axis=1) & np.isfinite(a).all(axis=1)
    if rows.sum() < 20:
        return ""
    q, a = q[rows], a[rows]
    length = np.linalg.norm(a, axis=1).mean()
    if length == 0:
        return ""
    found = {}
    for order, inverse in itertools.product(("wxyz", "xyzw"), (False, True)):
        w, v = (q[:, :1], q[:, 1:]) if order == "wxyz" else (q[:, 3:], q[:, :3])
        v = -v if inverse else v
        turned = a + 2 * np.cross(v, np.cross(v, a) + w * a)
        found[order + " inverse" * inverse] = np.linalg.norm(turned.mean(axis=0)) / length
    best, second = sorted(found, key=lambda k: -found[k])[:2]
    return best if found[best] > 0.9 and found[second] < 0.85 * found[best] else ""


def earth_up(quat: NDArray[Any], acc: NDArray[Any]) -> NDArray[np.float64]:
    """Return where quaternions put the mean of the measured specific force.

    Args:
        quat: (n, 4) wxyz, sensor to earth.
        acc: (n, 3) at the same times, any unit.

    Returns:
        (3,) of unit length: (0, 0, 1) in an earth frame whose z points up; NaN where nothing is finite.
    """
    q, a = _finite(quat), _finite(acc)
    rows = np.isfinite(q).all(axis=1) & np.isfinite(a).all(axis=1)
    w, v, a = q[rows, :1], q[rows, 1:], a[rows]
    mean = (a + 2 * np.cross(v, np.cross(v, a) + w * a)).mean(axis=0) if rows.any() else np.full(3, np.nan)
    return np.asarray(mean / np.maximum(np.linalg.norm(mean), 1e-12))
