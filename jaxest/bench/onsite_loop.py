"""The same estimate as `jaxest.systems.onsite`, as one would write it in NumPy: the peer of the benchmark."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def _skew(v: NDArray[Any]) -> NDArray[Any]:
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def _pair(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    h = np.zeros((4, 4))
    h[0, 1:], h[1:, 0], h[1:, 1:] = b - a, a - b, _skew(a + b)
    return h


def _rotation(q: NDArray[Any]) -> NDArray[Any]:
    s = _skew(q[1:])
    return np.eye(3) + 2 * q[0] * s + 2 * s @ s


def _fit(time: NDArray[Any], value: NDArray[Any], degree: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Averages (6,), derivatives (6,) and averaged squares (3, 3) of a window (W, 6)."""
    span = time[-1] - time[0]
    q, r = np.linalg.qr((time / span)[:, None] ** np.arange(degree + 1))
    slope = np.linalg.solve(r, q.T)[1] / span
    mass = -np.cumsum(slope)[:-1] * np.diff(time) / 2
    w = np.append(mass, 0) + np.append(0, mass)
    return w @ value, slope @ value, (w[:, None] * value[:, :3]).T @ value[:, :3]


def loop(samples: Any, half_width: int = 7, degree: int = 3, lag: int = 20) -> tuple[NDArray[Any], NDArray[Any]]:
    """Run over one recording.

    Args:
        samples: `jaxest.systems.onsite.Pair` with a leading axis of T, all valid.
        half_width: N.
        degree: M.
        lag: N_lag.

    Returns:
        Position (3,), m, and its covariance (3, 3).
    """
    a, p = (
        np.hstack([getattr(samples, f"{kind}_{side}").value for kind in ("gyroscope", "accelerometer")]).astype(float)
        for side in "ap"
    )
    time = np.cumsum(np.asarray(samples.dt, float))
    width = 2 * half_width + 1
    bingham, information, projection = np.zeros((4, 4)), np.zeros((3, 3)), np.zeros(3)
    queue, place, covariance = np.zeros((lag, 3)), np.zeros(3), np.zeros((3, 3))
    for end in range(width, len(time) + 1):
        rows = slice(end - width, end)
        around = time[rows] - time[end - 1 - half_width]
        (ma, da, sa), (mp, dp, sp) = (_fit(around, x[rows], degree) for x in (a, p))
        h = _pair(ma[:3], mp[:3])
        bingham = bingham - h.T @ h / 4e-4
        turn = _rotation(np.linalg.eigh(bingham)[1][:, -1])
        spins = [s - np.trace(s) * np.eye(3) + _skew(d[:3]) for s, d in ((sa, da), (sp, dp))]
        o = (spins[0] + turn @ spins[1] @ turn.T) / 2 + 2e-4 * np.eye(3)
        force = turn @ mp[3:] - ma[3:]
        queue = np.vstack([queue[1:], force - o @ place])
        information = information + o.T @ o
        projection = projection + o.T @ force
        inverse = np.linalg.pinv(information)
        place = inverse @ projection
        covariance = inverse * np.sum(queue * queue) / (3 * (lag - 1))
    return place, covariance


__all__ = ["loop"]
