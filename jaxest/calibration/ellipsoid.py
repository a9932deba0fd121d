"""Scale, skew and bias of a three-axis sensor that sees a vector of constant length in many directions.

A reading y of a field of length g lies on an ellipsoid: |W (y - b)| = g with W symmetric. W is fitted as such, by the
distance |W (y - b)| - g of each reading, so that the quadric is an ellipsoid whatever the noise: no hyperboloid can be
written in this form. A fit of the general quadric's ten coefficients, with or without a constraint, weighs readings by
what their coefficients do, and is biased by noise.

Source: Sato 2024, section III-E, eqs. 37 and 38, whose constrained quadric (Li and Griffiths 2004) this replaces.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.calibration._recordings import finite
from jaxest.types import InputError

REACH = 0.3
"""m, standard deviation of the place, along each axis, of the point that a sensor in the hand is turned about"""
ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


class Fit(NamedTuple):
    """How to correct a reading: `matrix @ (reading - bias)`."""

    matrix: NDArray[np.float64]
    """(3, 3) W, symmetric, positive definite."""
    bias: NDArray[np.float64]
    """(3,) in the sensor's unit."""
    covariance: NDArray[np.float64]
    """(9, 9) of W's entries xx, yy, zz, xy, xz, yz, and the bias."""
    noise: float
    """standard deviation of the corrected readings' length about g, in the sensor's unit"""
    lever: NDArray[np.float64] = np.zeros(3)
    """(3,) m, from the point that it was turned about to the sensor; 0 if the turning was not given"""

    @property
    def axes(self) -> NDArray[np.float64]:
        """(3,) half axes of the ellipsoid over g, the sensor's gains, rising."""
        return np.sort(1 / np.linalg.eigvalsh(self.matrix))

    @property
    def axes_error(self) -> NDArray[np.float64]:
        """(3,) standard errors of `axes`."""
        values, vectors = np.linalg.eigh(self.matrix)
        errors = []
        for value, v in zip(values[::-1], vectors.T[::-1], strict=True):
            slope = np.array([v[i] * v[j] * (1 if i == j else 2) for i, j in ENTRIES])
            errors.append(np.sqrt(slope @ self.covariance[:6, :6] @ slope) / value**2)
        return np.array(errors)


def fit(
    readings: ArrayLike, length: float = 9.80665, *, tolerance: float = 0.02, iterations: int = 100,
    turning: ArrayLike | None = None,
) -> Fit:  # fmt: skip
    """Fit the ellipsoid.

    Args:
        readings: (n, 3) in the sensor's unit, without motion beyond slow turning.
        length: g, the field's length in the same unit.
        tolerance: largest standard error, of each half axis over g and of the bias over g, with which the result is
            still accepted.
        iterations: most steps of Levenberg and Marquardt.
        turning: (n, 3, 3) 1/s^2, [dw/dt x] + [w x]^2 of the body's rates. A sensor that is turned about a point away
            from it feels that times the lever, which looks like a bias and does not average out; with this the lever
            is estimated along, within some 0.3 m of the sensor.

    Returns:
        The fit.

    Raises:
        InputError: fewer than 12 readings, values that are not finite, or directions that do not determine the
            ellipsoid; the message says how far the readings spread.
    """
    y = np.asarray(readings, np.float64)
    if y.ndim != 2 or y.shape[1] != 3 or len(y) < 12:
        raise InputError(f"readings: got shape {y.shape}, expected (n, 3) with at least 12 rows")
    finite("readings", y)
    x = _start(y / length)
    residual, slope = _model(x, y / length)
    damping, cost = 1e-3, residual @ residual
    for _ in range(iterations):
        gram, gradient = slope.T @ slope, slope.T @ residual
        trial = x - np.linalg.solve(gram + damping * np.diag(np.diag(gram) + 1e-12), gradient)
        found, its_slope = _model(trial, y / length)
        lower = found @ found
        if lower <= cost and np.linalg.eigvalsh(_matrix(trial))[0] > 0:
            done = cost - lower <= 1e-14 * cost + 1e-30
            x, residual, slope, cost, damping = trial, found, its_slope, lower, damping / 5
            if done:
                break
        else:
            damping *= 4
            if damping > 1e12:
                break
    if turning is None:
        return _judged(*_unbiased(x, y / length), y, length, tolerance)
    arms = np.asarray(turning, np.float64) / length
    if arms.shape != (len(y), 3, 3) or not np.isfinite(arms).all():
        raise InputError(f"turning: got shape {arms.shape}, expected ({len(y)}, 3, 3), finite")
    lever, x = _levered(x, y / length, arms)
    still = y / length - (arms @ lever) @ np.linalg.inv(_matrix(x))
    x, residual, slope = _unbiased(x, still)
    slope = np.hstack([slope, _pull(x, still, arms)])
    return _judged(x, residual, slope, y, length, tolerance)._replace(lever=lever)


def _pull(x: NDArray[np.float64], y: NDArray[np.float64], arms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Derivatives (n, 3) of the distances by the lever."""
    corrected = (y - x[6:]) @ _matrix(x)
    unit = corrected / np.maximum(np.linalg.norm(corrected, axis=1), 1e-9)[:, None]
    return -np.einsum("ni,nij->nj", unit, arms)


def _levered(
    x: NDArray[np.float64], y: NDArray[np.float64], arms: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The lever and the ellipsoid, by Gauss and Newton from the ellipsoid without a lever."""
    lever = np.zeros(3)
    for _ in range(10):
        still = y - (arms @ lever) @ np.linalg.inv(_matrix(x))
        residual, slope = _model(x, still)
        both = np.hstack([slope, _pull(x, still, arms)])
        prior = np.concatenate([np.zeros(9), np.full(3, residual @ residual / len(y) / REACH**2)])
        change = np.linalg.solve(both.T @ both + np.diag(prior + 1e-12), both.T @ residual + prior * [*[0] * 9, *lever])
        trial = x - change[:9]
        if np.linalg.eigvalsh(_matrix(trial))[0] <= 0:
            break
        x, lever = trial, lever - change[9:]
        if np.abs(change).max() < 1e-9:
            break
    return lever, x


def _start(y: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sphere about the readings by linear least squares: |y|^2 = 2 b'y + r^2 - b'b."""
    a = np.hstack([2 * y, np.ones((len(y), 1))])
    found = np.linalg.lstsq(a, np.sum(y * y, axis=1), rcond=1e-6)[0]
    bias = found[:3]
    radius = np.sqrt(max(found[3] + bias @ bias, 0.0))
    if not (0.5 < radius < 2 and np.linalg.norm(bias) < 1):
        bias, radius = np.zeros(3), float(np.sqrt(np.mean(np.sum(y * y, axis=1))))
    return np.concatenate([np.full(3, 1 / radius), np.zeros(3), bias])


def _matrix(x: NDArray[np.float64]) -> NDArray[np.float64]:
    a, b, c, d, e, f = x[:6]
    return np.array([[a, d, e], [d, b, f], [e, f, c]])


def _model(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distances (n,) from the unit sphere after correction, and their derivatives (n, 9)."""
    w, away = _matrix(x), y - x[6:]
    corrected = away @ w
    size = np.maximum(np.linalg.norm(corrected, axis=1), 1e-9)
    unit = corrected / size[:, None]
    columns = []
    for i, j in ENTRIES:
        columns.append(unit[:, i] * away[:, j] + (unit[:, j] * away[:, i] if i != j else 0))
    return size - 1, np.column_stack([*columns, -unit @ w])


def _unbiased(
    x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Solve again for what the gradient expects of noise instead of zero.

    A reading's noise moves both its distance and that distance's slope; the mean of their product is, to second order,
    half the Laplacian of the product times the variance. It does not shrink with more readings, and where few
    directions are seen it is larger than the standard error.
    """
    for _ in range(20):
        residual, slope = _model(x, y)
        w, away = _matrix(x), y - x[6:]
        corrected = away @ w
        size = np.maximum(np.linalg.norm(corrected, axis=1), 1e-9)
        unit = corrected / size[:, None]
        steep = unit @ w  # of the distance, by the reading
        variance = residual @ residual / max(len(y) - 9, 1) / np.mean(np.sum(steep**2, axis=1))
        h = 1e-5
        turned = (_model(x, y + h * steep)[1] - _model(x, y - h * steep)[1]) / (2 * h)
        bend = (np.sum(w * w) - np.sum(steep**2, axis=1)) / size
        expected = variance * np.sum(turned + slope * bend[:, None] / 2, axis=0)
        change = np.linalg.lstsq(slope.T @ slope, slope.T @ residual - expected, rcond=1e-12)[0]
        trial = x - change
        if np.linalg.norm(change) > 0.2 or np.linalg.eigvalsh(_matrix(trial))[0] <= 0:
            break
        x = trial
        if np.abs(change).max() < 1e-12:
            break
    return x, *_model(x, y)


def _judged(
    x: NDArray[np.float64],
    residual: NDArray[np.float64],
    slope: NDArray[np.float64],
    y: NDArray[np.float64],
    length: float,
    tolerance: float,
) -> Fit:
    """Scale the result back and refuse it where it is not determined."""
    spread = np.linalg.svd(y - y.mean(axis=0), compute_uv=False) / np.sqrt(len(y)) / length
    joint = slope.T @ slope
    gram = joint[:9, :9]
    if len(joint) > 9:  # a lever is estimated along
        own = joint[9:, 9:] + residual @ residual / len(y) / REACH**2 * np.eye(3)
        gram = gram - joint[:9, 9:] @ np.linalg.solve(own, joint[9:, :9])
    scale = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-30))
    values = np.linalg.eigvalsh(gram * np.outer(scale, scale))
    where = (
        f"the directions do not determine an ellipsoid: the readings spread by {spread[0]:.2f}, {spread[1]:.2f} and "
        f"{spread[2]:.2f} g about their mean (0.58 each where all directions are seen)"
    )
    if values[0] < 1e-9 * values[-1]:
        raise InputError(f"readings: {where}; turn the sensor through more attitudes")
    noise = float(np.sqrt(residual @ residual / max(len(y) - 9, 1)))
    covariance = np.linalg.inv(gram) * max(noise, 1e-9) ** 2
    unit = np.concatenate([np.ones(6), np.full(3, length)])
    wide = np.asarray(covariance * np.outer(unit, unit), np.float64)
    result = Fit(_matrix(x), x[6:] * length, wide, noise * length)
    worst = max(np.max(result.axes_error), float(np.sqrt(np.max(np.diag(covariance)[6:]))))
    if not worst <= tolerance or not 0.2 < np.linalg.eigvalsh(result.matrix)[0] < 5:
        raise InputError(
            f"readings: {where}; the worst standard error is {worst:.3f} g, expected at most {tolerance:g}; turn the "
            "sensor through more attitudes, or take more readings"
        )
    return result


def apply(fitted: Fit, readings: ArrayLike) -> NDArray[np.float64]:
    """Correct readings (..., 3)."""
    return (np.asarray(readings, np.float64) - fitted.bias) @ fitted.matrix


__all__ = ["Fit", "apply", "fit"]
