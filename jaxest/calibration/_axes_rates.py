"""Joint axes from the gyroscopes themselves: the refinement behind `mounting` where the angular rates are at hand.

The orientations that a filter gives are wrong by tenths of a degree for seconds, as accelerations pull them about, and
an axis that is hardly turned about inherits that. Integrated rates have no such errors, only a start and a bias each,
and the constraint of the joint knows both. So one least squares finds all: the axes, the angle between them, and of
each IMU the rotation it starts from and its bias. The filter's orientations say no more than where up is.

Source: the constraints of `_axes`, on integrated rates; the weights by rounds of variance components (Helmert 1907).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.calibration._rotations import rotation_vector, rotations

Matrix = NDArray[np.float64]
SIZE = 17
"""Unknowns: 2 of each axis, the angle between them, then of each IMU 3 of its rotation and 3 of its bias."""
AXES, ANGLE, TURN, BIAS = slice(0, 4), 4, (5, 11), (8, 14)
CONSTRAINT, TILT = np.deg2rad(0.05), np.deg2rad(0.5)
"""rad, deviations of the two kinds of residual in the first round."""
LEAST = 1e-5
"""rad, below which no deviation is believed."""
ALIKE = 1.0
"""s, for how long residuals are alike: what so many samples say counts once."""
WANDER = 0.01
"""rad/s, how far a bias may be from that of the filter's path."""
ROUNDS, STEPS = 3, 8


class Turning(NamedTuple):
    """What two IMUs say of their rotation."""

    time: Matrix
    """(n,) s"""
    rate: Matrix
    """(2, n, 3) rad/s"""
    up: Matrix
    """(2, n, 3) the vertical in each sensor's frame, by its filter"""
    bias: Matrix
    """(2, 3) rad/s, of the filters' paths"""
    used: slice
    """samples that enter the least squares; all are integrated"""


class Guess(NamedTuple):
    """What is searched for."""

    first: Matrix
    second: Matrix
    angle: float | None
    """of a two-axis joint, None of a hinge"""
    turn: Matrix
    """(2, 3, 3) each IMU at the first sample, to a common upright frame"""
    bias: Matrix
    """(2, 3) rad/s"""


class Solved(NamedTuple):
    """The least squares."""

    guess: Guess
    covariance: Matrix
    """(6, 6) of the axes, rad^2"""
    residual: float
    """rad, rms of what the constraint leaves"""


def begun(time: Matrix, rate: Matrix, path: Matrix, heading: Matrix, axes: Any) -> tuple[Turning, Guess]:
    """Prepare the least squares.

    Args:
        time: (n,) s.
        rate: (2, n, 3) rad/s.
        path: (2, n, 3, 3) orientations by a filter, sensor to an upright frame each.
        heading: (n,) rad, the angle that turns the second one's earth frame into the first's.
        axes: first, second and the angle of a two-axis joint, as a search on the orientations has found them.

    Returns:
        What is observed, and where to begin.
    """
    bias = np.stack([np.mean(np.subtract(*_both(time, rate[i], path[i])), axis=0) for i in (0, 1)])
    common = np.stack([path[0], about_up(heading) @ path[1]])
    integrated = np.stack([integral(time, rate[i], bias[i]) for i in (0, 1)])
    u, _, vt = np.linalg.svd(np.einsum("knij,knlj->kil", common, integrated))
    proper = np.linalg.det(u @ vt)
    u[:, :, 2] *= proper[:, None]
    turning = Turning(time, rate, path[:, :, 2, :], bias, slice(None, None, max(1, len(time) // 4000)))
    return turning, Guess(axes[0], axes[1], axes[2], u @ vt, bias)


def unexplained(time: Matrix, rate: Matrix, path: Matrix) -> float:
    """Return the share of rates (n, 3), rms, that a path (n, 3, 3) does not explain but by a constant bias."""
    mean, moved = _both(time, rate, path)
    return float(np.std(mean - moved) / max(float(np.std(moved)), 1e-9))


def _both(time: Matrix, rate: Matrix, path: Matrix) -> tuple[Matrix, Matrix]:
    """Rates (n - 1, 3) between samples: by the gyroscope, and by the path."""
    moved = rotation_vector(np.swapaxes(path[:-1], -1, -2) @ path[1:]) / np.diff(time)[:, None]
    return (rate[1:] + rate[:-1]) / 2, moved


def solve(turning: Turning, guess: Guess) -> Solved:
    """Bring a start to the least squares.

    Args:
        turning: what is observed.
        guess: where to begin.

    Returns:
        The solution.
    """
    size = CONSTRAINT, TILT
    alike = max(ALIKE / float(np.median(np.diff(turning.time[turning.used]))), 1.0)
    for _ in range(ROUNDS):
        for _ in range(STEPS):
            parts = _linear(turning, guess)
            gradient, square = _normal(turning, guess, parts, size, alike)
            step = np.asarray(-np.linalg.solve(square, gradient), np.float64)
            guess = _moved(guess, step)
            if np.abs(step[: TURN[0]]).max() < 1e-9:
                break
        parts = _linear(turning, guess)
        size = tuple(max(float(np.sqrt(np.mean(r**2))), LEAST) for r, _ in parts)  # type: ignore[assignment]
    _, square = _normal(turning, guess, parts, size, alike)
    onto = np.zeros((6, SIZE))
    onto[:3, :2], onto[3:, 2:4] = across(guess.first), across(guess.second)
    covariance = onto @ np.linalg.inv(square) @ onto.T
    return Solved(guess, covariance, float(np.sqrt(np.mean(np.sum(parts[0][0] ** 2, axis=1)))))


def integral(time: Matrix, rate: Matrix, bias: Matrix) -> Matrix:
    """Rotations (n, 3, 3) since the first sample, by the rates' means between samples."""
    found = np.concatenate([np.eye(3)[None], rotations(((rate[1:] + rate[:-1]) / 2 - bias) * np.diff(time)[:, None])])
    ahead = 1
    while ahead < len(found):
        found = np.concatenate([found[:ahead], found[:-ahead] @ found[ahead:]])
        ahead *= 2
    return found


def _linear(turning: Turning, guess: Guess) -> tuple[tuple[Matrix, Matrix], tuple[Matrix, Matrix]]:
    """Residuals (n, r) and slopes (n, r, 17) of the joint's constraint and of the vertical."""
    step = np.diff(turning.time)[:, None, None]
    turned, swung = [], []
    for i in (0, 1):
        path = guess.turn[i] @ integral(turning.time, turning.rate[i], guess.bias[i])
        grown = np.concatenate([np.zeros((1, 3, 3)), np.cumsum((path[1:] + path[:-1]) / 2 * step, axis=0)])
        turned.append(path[turning.used])
        swung.append(grown[turning.used])
    ends = turned[0] @ guess.first, turned[1] @ guess.second
    if guess.angle is None:
        residual = ends[0] - ends[1]
        pulls = (np.broadcast_to(sign * np.eye(3), (len(residual), 3, 3)) for sign in (1.0, -1.0))
    else:
        cosine = np.clip(np.sum(ends[0] * ends[1], axis=1), -1, 1)
        residual = (np.arccos(cosine) - guess.angle)[:, None]
        sine = np.sqrt(np.maximum(1 - cosine**2, 1e-4))[:, None, None]
        pulls = (-end[:, None, :] / sine for end in (ends[1], ends[0]))
    slope = np.zeros((*residual.shape, SIZE))
    upright, levels = [], []
    for i, (pull, axis) in enumerate(zip(pulls, (guess.first, guess.second), strict=True)):
        slope[:, :, 2 * i : 2 * i + 2] = pull @ turned[i] @ across(axis)
        _turn(slope, i, pull, ends[i], swung[i])
        vertical = np.einsum("nij,nj->ni", turned[i], turning.up[i, turning.used])
        level = np.zeros((len(residual), 2, SIZE))
        _turn(level, i, np.broadcast_to(np.eye(3)[:2], (len(residual), 2, 3)), vertical, swung[i])
        upright.append(vertical[:, :2])
        levels.append(level)
    if guess.angle is not None:
        slope[:, 0, ANGLE] = -1
    return (residual, slope), (np.concatenate(upright, axis=1), np.concatenate(levels, axis=1))


def _turn(slope: Matrix, i: int, pull: Matrix, vector: Matrix, swung: Matrix) -> None:
    """Write how a residual that follows a turned vector by `pull` (n, r, 3) follows rotation and bias of IMU i."""
    by = np.cross(vector[:, None, :], pull)
    slope[:, :, TURN[i] : TURN[i] + 3] = by
    slope[:, :, BIAS[i] : BIAS[i] + 3] = -by @ swung


def _normal(turning: Turning, guess: Guess, parts: Any, size: Any, alike: float) -> tuple[Matrix, Matrix]:
    """Gradient and normal matrix; what no residual shows (headings of both alike) stays where it is."""
    square, gradient = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    square[TURN[0] + 2, TURN[0] + 2] = 1e4
    if guess.angle is None:
        square[ANGLE, ANGLE] = 1.0
    for i in (0, 1):
        at = np.arange(BIAS[i], BIAS[i] + 3)
        square[at, at] += 1 / WANDER**2
        gradient[at] += (guess.bias[i] - turning.bias[i]) / WANDER**2
    for (residual, slope), deviation in zip(parts, size, strict=True):
        flat = slope.reshape(-1, SIZE)
        square += flat.T @ flat / (deviation**2 * alike)
        gradient += flat.T @ residual.reshape(-1) / (deviation**2 * alike)
    return gradient, square


def _moved(guess: Guess, step: Matrix) -> Guess:
    turned = rotations(np.stack([step[at : at + 3] for at in TURN])) @ guess.turn
    bias = guess.bias + np.stack([step[at : at + 3] for at in BIAS])
    angle = None if guess.angle is None else guess.angle + float(step[ANGLE])
    return Guess(tilted(guess.first, step[:2]), tilted(guess.second, step[2:4]), angle, turned, bias)


def across(axis: Matrix) -> Matrix:
    """Two unit vectors across an axis, (3, 2)."""
    return np.linalg.svd(axis[None])[2][1:].T


def tilted(axis: Matrix, by: Matrix) -> Matrix:
    """Move a unit vector (3,) by (2,) rad along the two across it."""
    moved = axis + across(axis) @ by
    return moved / np.linalg.norm(moved)


def about_up(angle: Matrix) -> Matrix:
    """Rotations (n, 3, 3) about the vertical."""
    zero, one = np.zeros_like(angle), np.ones_like(angle)
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], -1).reshape(*angle.shape, 3, 3)
