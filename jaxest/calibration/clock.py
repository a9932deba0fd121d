"""The constant offset between the clocks of two IMUs on one rigid link, from their angular rates."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.calibration._recordings import recorded
from jaxest.filters import savitzky_golay as sg
from jaxest.stamps import longest, near
from jaxest.types import InputError


class Offset(NamedTuple):
    """P's clock shows `seconds` more than A's at the same moment."""

    seconds: float
    deviation: float
    """s, standard deviation"""
    drift: float
    """s/s, how the offset grows"""
    drift_deviation: float
    """s/s"""
    residual: float
    """rad/s, standard deviation per axis of what is left of the rates' difference"""


def offset(
    time_a: ArrayLike,
    rate_a: ArrayLike,
    time_p: ArrayLike,
    rate_p: ArrayLike,
    *,
    most: float = 0.5,
    half_width: int = 5,
    degree: int = 3,
) -> Offset:
    """Find by how much P's stamps are late against A's.

    Lengths of the rates are compared first, within `most`; then R w_P(t + offset) + c = w_A(t) is solved for rotation,
    bias and offset together.

    Args:
        time_a: (n,) s, increasing.
        rate_a: (n, 3) rad/s.
        time_p: (m,) s, increasing.
        rate_p: (m, 3) rad/s.
        most: s, largest offset that is looked for.
        half_width: N of the filter that interpolates the rates.
        degree: M.

    Returns:
        The offset. Its deviation is that of scores summed over half seconds, for errors of the sensors are correlated.

    Raises:
        InputError: shapes or stamps are wrong, values are not finite, the recordings hardly overlap, or the rates do
            not vary enough to tell.
    """
    ta, wa = recorded(("time_a", time_a), rate_a=rate_a)
    tp, wp = recorded(("time_p", time_p), rate_p=rate_p)
    low, high = max(ta[0], tp[0] + most), min(ta[-1], tp[-1] - most)
    if not high - low > 2:
        raise InputError(
            f"the recordings overlap by {high - low + 2 * most:.1f} s, expected more than {2 + 2 * most} s"
        )
    step = float(np.median(np.diff(ta)))
    grid = np.arange(low, high, step)
    a, _, there = _at(ta, wa, grid, half_width, degree)
    grid, a = grid[there], a[there]
    shifts = np.arange(-most, most + step / 2, step)
    both = [near(tp, grid + s) for s in shifts]
    least = step * min(np.count_nonzero(there) for there in both)
    if not least > 2:
        raise InputError(f"the recordings overlap by {least:.1f} s outside of their gaps, expected more than 2 s")
    length, sizes = np.linalg.norm(a, axis=1), np.linalg.norm(wp, axis=1)
    if np.std(length) < 1e-3 or np.std(np.interp(grid, tp, sizes)) < 1e-3:
        raise InputError("the rates hardly vary: shake the link so that the clocks can be compared")
    pairs = zip(shifts, both, strict=True)
    alike = [np.corrcoef(length[k], np.interp(grid[k] + s, tp, sizes))[0, 1] for s, k in pairs]
    found = float(shifts[int(np.argmax(alike))])
    for _ in range(10):
        p, turn, there = _at(tp, wp, grid + found, half_width, degree)
        e, slope, left = _compare(a[there], p[there], turn[there])
        change = float(np.sum(slope * e) / np.sum(slope * slope))
        found += change
        if abs(change) < 1e-9:
            break
    return _judged(found, e, slope, left, grid[there], step)


def _at(
    time: NDArray[np.float64], rate: NDArray[np.float64], query: NDArray[np.float64], half_width: int, degree: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Rates (n, 3), their derivatives (n, 3), and where no gap is near (n,): beside one, a window reaches across."""
    fitted = sg.smooth(time, rate, query=query, half_width=half_width, degree=degree)
    stamps = time[sg.windows(time, query, half_width)[0]]
    there = near(time, query) & (np.ptp(stamps, axis=1) < 2 * half_width * longest(time))
    return np.asarray(fitted.value, np.float64), np.asarray(fitted.derivative, np.float64), there


def _compare(
    a: NDArray[np.float64], p: NDArray[np.float64], turn: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Residual (n, 3), its slope (n, 3) by the offset cleared of rotation and bias, and the residual's deviation."""
    u, _, vt = np.linalg.svd((a - a.mean(axis=0)).T @ (p - p.mean(axis=0)))
    r = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    e = a - a.mean(axis=0) - (p - p.mean(axis=0)) @ r.T
    slope = turn @ r.T
    turned = (p - p.mean(axis=0)) @ r.T
    # A small rotation v changes the prediction by v x turned, a bias by itself: take both out of the slope.
    columns = [np.cross(unit, turned).ravel() for unit in np.eye(3)]
    columns += [np.tile(unit, len(a)) for unit in np.eye(3)]
    basis = np.column_stack(columns)
    clean = slope.ravel() - basis @ np.linalg.lstsq(basis, slope.ravel(), rcond=None)[0]
    return e, clean.reshape(-1, 3), float(np.sqrt(np.mean(e**2)))


def _judged(
    found: float,
    e: NDArray[np.float64],
    slope: NDArray[np.float64],
    left: float,
    grid: NDArray[np.float64],
    step: float,
) -> Offset:
    score, weight = np.sum(slope * e, axis=1), np.sum(slope * slope, axis=1)
    away = grid - np.sum(weight * grid) / weight.sum()
    drift = float(np.sum(score * away) / np.sum(weight * away**2))
    score = score - weight * away * drift  # a drift must not look like noise of the offset
    block = max(round(0.5 / step), 12)
    whole = len(score) // block * block
    count = whole // block

    def deviation(scores: NDArray[np.float64], total: float) -> float:
        sums = scores[:whole].reshape(-1, block).sum(axis=1)
        return float(np.sqrt(np.sum(sums**2) * count / max(count - 2, 1)) / total)

    spread, bend = deviation(score, weight.sum()), deviation(score * away, float(np.sum(weight * away**2)))
    return Offset(found, spread, drift, bend, left)


__all__ = ["Offset", "offset"]
