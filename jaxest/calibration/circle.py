"""The circle through points, as when a hand feels out a disk; on the host, in float64."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.calibration._recordings import finite
from jaxest.types import InputError


class Circle(NamedTuple):
    """A circle and how well points lie on it."""

    centre: NDArray[np.float64]
    """(2,) m"""
    radius: float
    """m"""
    residual: float
    """m, rms distance of the points from it"""


def fit(points: ArrayLike, *, iterations: int = 20) -> Circle:
    """Find the circle whose distances to points are smallest in the least-squares sense.

    Args:
        points: (n, 2) m, at least three that are not on a line.
        iterations: most Gauss-Newton steps.

    Returns:
        The circle.

    Raises:
        InputError: the shape is wrong, a point is not finite, or all are on a line.

    Source: Kasa 1976 for the start (linear in the squared distances), then the geometric distances themselves.
    """
    p = np.asarray(points, np.float64)
    if p.ndim != 2 or p.shape[1] != 2 or len(p) < 3:
        raise InputError(f"points: got shape {p.shape}, expected (n, 2) with at least three points")
    middle = finite("points", p).mean(axis=0)
    scale = float(np.linalg.norm(p - middle, axis=1).max())
    if scale == 0 or np.linalg.svd(p - middle)[1][1] < 1e-9 * scale * np.sqrt(len(p)):
        raise InputError("points: they lie on one line, expected three that do not")
    x = (p - middle) / scale
    solution = np.linalg.lstsq(np.c_[2 * x, np.ones(len(x))], np.sum(x * x, axis=1), rcond=None)[0]
    centre, radius = solution[:2], float(np.sqrt(solution[2] + solution[:2] @ solution[:2]))
    for _ in range(iterations):
        away = x - centre
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
        slope = np.c_[-away / distance[:, None], -np.ones(len(x))]
        step = np.linalg.lstsq(slope, -(distance - radius), rcond=None)[0]
        centre, radius = centre + step[:2], radius + float(step[2])
        if np.abs(step).max() < 1e-12:
            break
    residual = np.linalg.norm(x - centre, axis=1) - radius
    return Circle(middle + scale * centre, scale * radius, scale * float(np.sqrt(np.mean(residual**2))))


__all__ = ["Circle", "fit"]
