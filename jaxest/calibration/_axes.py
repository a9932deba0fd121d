"""The search for joint axes behind `mounting`: a start by eigenvalues, then Gauss-Newton."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.calibration._axes_rates import across, tilted

Matrix = NDArray[np.float64]
HEADINGS = 72
STARTS = 16
ROUNDS = 20


class Paths(NamedTuple):
    """The rotation between two IMUs as far as it is known: R_12 = flat cos(h) + across sin(h) + along."""

    time: Matrix
    """(n,) s from the first sample"""
    flat: Matrix
    across: Matrix
    along: Matrix
    """(n, 3, 3) each"""

    @classmethod
    def of(cls, time: Matrix, first: Matrix, second: Matrix) -> "Paths":
        """Make the paths of two IMUs' rotation matrices (n, 3, 3), sensor to upright frames."""
        up = np.diag([0.0, 0, 1])
        turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])
        back = np.swapaxes(first, 1, 2)
        return cls(time - time[0], back @ (np.eye(3) - up) @ second, back @ turn @ second, back @ up @ second)

    def rotation(self, heading: float, drift: float = 0.0) -> Matrix:
        """Return R_12 (n, 3, 3) for a heading between the earth frames and its drift."""
        h = (heading + drift * self.time)[:, None, None]
        return self.flat * np.cos(h) + self.across * np.sin(h) + self.along

    def turned(self, heading: float, drift: float = 0.0) -> Matrix:
        """Return the derivative of R_12 (n, 3, 3) by the heading."""
        h = (heading + drift * self.time)[:, None, None]
        return -self.flat * np.sin(h) + self.across * np.cos(h)


class Found(NamedTuple):
    """What Gauss-Newton ends with."""

    first: Matrix
    second: Matrix
    heading: float
    drift: float
    angle: float | None
    covariance: Matrix
    """(6, 6)"""
    residual: float
    cost: float


def start_hinge(paths: Paths) -> tuple[Matrix, Matrix, float]:
    """Find the heading at which some `j_1 = R_12 j_2` holds best on the mean: the largest singular value tells."""
    h = np.linspace(0, 2 * np.pi, HEADINGS, endpoint=False)[:, None, None]
    means = [x.mean(axis=0) for x in (paths.flat, paths.across, paths.along)]
    u, size, vt = np.linalg.svd(means[0] * np.cos(h) + means[1] * np.sin(h) + means[2])
    best = int(np.argmax(size[:, 0]))
    return u[best, :, 0], vt[best, 0], float(h[best, 0, 0])


def start_pair(paths: Paths, keep: int = 6) -> list[tuple[Matrix, Matrix, float]]:
    """Find headings and axes whose angle varies least, the best of several minima first.

    What varies least is the cosine, `j_1 . R_12 j_2`, for then each axis in turn is an eigenvector; but the cosine of
    nearly parallel axes hardly varies whatever they do, hence the order by the angle itself.
    """
    parts = np.concatenate([x.reshape(len(x), 9) for x in (paths.flat, paths.across, paths.along)], axis=1)
    spread, mean = np.cov(parts.T), parts.mean(axis=0)
    h = np.linspace(0, 2 * np.pi, HEADINGS, endpoint=False)
    mix = np.stack([np.concatenate([np.cos(x) * np.eye(9), np.sin(x) * np.eye(9), np.eye(9)]) for x in h])
    form = np.einsum("hij,ik,hkl->hjl", mix, spread, mix).reshape(HEADINGS, 1, 3, 3, 3, 3)
    middle = np.einsum("hij,i->hj", mix, mean).reshape(HEADINGS, 1, 3, 3)
    steps = np.arange(STARTS) + 0.5
    z, phi = 1 - steps / STARTS, np.pi * (1 + 5**0.5) * steps  # evenly over the half sphere
    one = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], axis=1)
    one = np.broadcast_to(one, (HEADINGS, STARTS, 3))
    for _ in range(ROUNDS):
        half = np.matmul(np.einsum("hsa,hsc->hsac", one, one).reshape(HEADINGS, STARTS, 9), _paired(form, "acbd"))
        two = np.linalg.eigh(half.reshape(HEADINGS, STARTS, 3, 3))[1][..., 0]
        half = np.matmul(np.einsum("hsb,hsd->hsbd", two, two).reshape(HEADINGS, STARTS, 9), _paired(form, "bdac"))
        values, vectors = np.linalg.eigh(half.reshape(HEADINGS, STARTS, 3, 3))
        one = vectors[..., 0]
    cosine = np.einsum("hsa,hsab,hsb->hs", one, np.broadcast_to(middle, (HEADINGS, STARTS, 3, 3)), two)
    order = np.argsort((values[..., 0] / np.maximum(1 - cosine**2, 1e-3)).ravel())
    chosen: list[tuple[Matrix, Matrix, float]] = []
    for at in order:
        k, s = divmod(int(at), STARTS)
        new = one[k, s], two[k, s], float(h[k])
        if all(_apart(new, old) for old in chosen):
            chosen.append(new)
        if len(chosen) == keep:
            break
    return chosen


def _paired(form: Matrix, order: str) -> Matrix:
    """The form (h, 1, a, b, c, d) as matrices (h, 9, 9) between pairs of indices."""
    return np.einsum(f"habcd->h{order}", form[:, 0]).reshape(HEADINGS, 9, 9)


def _apart(a: tuple[Matrix, Matrix, float], b: tuple[Matrix, Matrix, float]) -> bool:
    near = min(abs(float(a[0] @ b[0])), abs(float(a[1] @ b[1])))
    return near < 0.8 or np.cos(a[2] - b[2]) < 0.8


def fit_pair(paths: Paths, first: Matrix, second: Matrix, heading: float) -> Found:
    """Refine a two-axis joint."""
    cosine = np.einsum("i,nij,j->n", first, paths.rotation(heading), second)
    return refined(paths, first, second, heading, float(np.mean(np.arccos(np.clip(cosine, -1, 1)))))


class _Guess(NamedTuple):
    first: Matrix
    second: Matrix
    heading: float
    drift: float
    angle: float | None


def refined(
    paths: Paths, first: Matrix, second: Matrix, heading: float, angle: float | None, iterations: int = 40
) -> Found:
    """Bring a start to the least squares of the constraint: of a hinge without `angle`, else of a two-axis joint."""
    guess, damping = _Guess(first, second, heading, 0.0, angle), 1e-6
    residual, slope = _linear(paths, guess)
    for _ in range(iterations):
        gradient, square = _gradient(residual, slope)
        step = -np.linalg.solve(square + damping * np.diag(np.diag(square) + 1e-9), gradient)
        moved = _moved(paths, guess, step)
        fresh, bent = _linear(paths, moved)
        gained = np.sum(residual**2) - np.sum(fresh**2)
        if gained > 0:
            settled = gained < 1e-10 * np.sum(residual**2)
            guess, residual, slope, damping = moved, fresh, bent, damping * 0.1
            if settled:
                break
        else:
            damping *= 10
    cost = float(np.mean(np.sum(residual**2, axis=1)))
    return Found(guess.first, guess.second, guess.heading, guess.drift, guess.angle,
                 _covariance(paths, guess, residual, slope), float(np.sqrt(cost)), cost)  # fmt: skip


def _linear(paths: Paths, x: _Guess) -> tuple[Matrix, Matrix]:
    """Residuals (n, r) and slopes (n, r, p) by [first (2), second (2), heading, drift over the path, angle]."""
    rotation, turned = paths.rotation(x.heading, x.drift), paths.turned(x.heading, x.drift)
    a, b = across(x.first), across(x.second)
    share = (paths.time / paths.time[-1])[:, None, None]
    there, moving = rotation @ x.second, (turned @ x.second)[..., None]
    if x.angle is None:
        own = np.broadcast_to(a[None], (len(rotation), 3, 2))
        return x.first[None] - there, np.concatenate([own, -rotation @ b, -moving, -moving * share], axis=2)
    flat = np.einsum("i,nik->nk", x.first, moving)[:, None, :]
    parts = [(there @ a)[:, None], np.einsum("i,nij,jk->nk", x.first, rotation, b)[:, None], flat, flat * share]
    cosine = np.clip(there @ x.first, -1, 1)
    sine = np.sqrt(np.maximum(1 - cosine**2, 1e-4))[:, None, None]
    slope = np.concatenate([-np.concatenate(parts, axis=2) / sine, -np.ones_like(share)], axis=2)
    return (np.arccos(cosine) - x.angle)[:, None], slope


def _gradient(residual: Matrix, slope: Matrix) -> tuple[Matrix, Matrix]:
    flat = slope.reshape(-1, slope.shape[2])
    return flat.T @ residual.reshape(-1), flat.T @ flat


def _moved(paths: Paths, x: _Guess, step: Any) -> _Guess:
    angle = None if x.angle is None else x.angle + float(step[6])
    return _Guess(tilted(x.first, step[:2]), tilted(x.second, step[2:4]), x.heading + float(step[4]),
                  x.drift + float(step[5]) / float(paths.time[-1]), angle)  # fmt: skip


def _covariance(paths: Paths, x: _Guess, residual: Matrix, slope: Matrix) -> Matrix:
    """Covariance (6, 6) of the axes that holds for residuals which stay alike for up to a second.

    Source: the sandwich estimator with clustered residuals (Liang, Zeger 1986).
    """
    _, square = _gradient(residual, slope)
    block = paths.time.astype(int)
    pulls = [_gradient(residual[block == k], slope[block == k])[0] for k in np.unique(block)]
    back = np.linalg.pinv(square, rcond=1e-10, hermitian=True)
    spread = back @ np.sum([np.outer(p, p) for p in pulls], axis=0) @ back
    onto = np.zeros((6, spread.shape[0]))
    onto[:3, :2], onto[3:, 2:4] = across(x.first), across(x.second)
    return np.asarray(onto @ spread @ onto.T)
