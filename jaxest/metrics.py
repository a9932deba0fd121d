"""How wrong an estimate is, and whether it knows: errors on the group, intervals, consistency.

Every function takes NumPy arrays (and then stays in NumPy and starts no backend) or JAX arrays, of any leading batch
shape. Angles are radians except where a name says `_deg`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg


class OrientationError(NamedTuple):
    """An orientation's error split on the group."""

    total: Any
    """(...) rad in [0, pi]: the angle of the whole error rotation."""
    heading: Any
    """(...) rad in [0, pi]: the part about the earth's vertical."""
    inclination: Any
    """(...) rad in [0, pi]: the part about a horizontal axis."""


class Interval(NamedTuple):
    """A two-sided interval."""

    lower: Any
    """(...) lower end."""
    upper: Any
    """(...) upper end."""


def orientation_error(estimate: Any, truth: Any) -> OrientationError:
    """Return total, heading and inclination error of orientations.

    The error rotation `estimate * conj(truth)` lies in the earth frame and is cut into a rotation about the vertical z
    and one about a horizontal axis. Signs of quaternions do not matter. NaN in gives NaN out.

    Args:
        estimate: (..., 4) unit quaternions wxyz, sensor to earth.
        truth: (..., 4) unit quaternions wxyz, sensor to earth; z of the earth frame is vertical.

    Returns:
        The three errors, each (...), rad.

    Raises:
        ValueError: a last axis is not 4.

    Source: Laidig et al. 2021 (BROAD), the benchmark's error measures: total 2 acos|w|, heading 2 atan|z/w|,
    inclination 2 acos sqrt(w^2 + z^2); evaluated by atan2, which keeps small angles in float32.
    """
    xp = _namespace(estimate, truth)
    w, x, y, z = _product(xp, estimate, truth, conjugate_first=False)
    return OrientationError(
        2 * xp.arctan2(_norm(xp, x, y, z), xp.abs(w)),
        2 * xp.arctan2(xp.abs(z), xp.abs(w)),
        2 * xp.arctan2(_norm(xp, x, y), _norm(xp, w, z)),
    )


def orientation_difference(estimate: Any, truth: Any) -> Any:
    """Return the rotation vector that leads from the estimate to the truth, in the sensor frame.

    Args:
        estimate: (..., 4) unit quaternions wxyz, sensor to earth.
        truth: (..., 4) unit quaternions wxyz, sensor to earth.

    Returns:
        (..., 3) rad, theta with `truth = estimate * exp(theta)`: the tangent in which an orientation's covariance is
        given.

    Raises:
        ValueError: a last axis is not 4.
    """
    xp = _namespace(estimate, truth)
    w, x, y, z = _product(xp, estimate, truth, conjugate_first=True)
    half = _norm(xp, x, y, z)
    small = half < 1e-6  # there, 2 atan2(half, w) / half is 2 up to half^2 / 3
    sign = xp.where(w < 0, -1.0, 1.0).astype(w.dtype)
    scale = xp.where(small, 2.0, 2 * xp.arctan2(half, xp.abs(w)) / xp.where(small, 1.0, half)).astype(w.dtype)
    return xp.stack([sign * scale * part for part in (x, y, z)], axis=-1)


def align_heading(estimate: Any, truth: Any, sample: int = 0) -> Any:
    """Turn the truth about the vertical so that the heading error of one sample is zero.

    Without a magnetometer nothing tells the heading; what can be judged is how it drifts from that sample on.

    Args:
        estimate: (..., T, 4) unit quaternions wxyz, sensor to earth.
        truth: (..., T, 4) unit quaternions wxyz, sensor to earth.
        sample: index along T at which the headings are made equal; the truth must be there.

    Returns:
        (..., T, 4) the truth, turned.

    Raises:
        ValueError: a last axis is not 4.
    """
    xp = _namespace(estimate, truth)
    w, _, _, z = _product(xp, estimate, truth, conjugate_first=False)
    w, z = w[..., sample, None], z[..., sample, None]
    norm = _norm(xp, w, z)
    safe = xp.where(norm == 0, 1, norm)
    c, s = xp.where(norm == 0, 1, w / safe), z / safe
    a, b, d, e = (xp.asarray(truth)[..., i] for i in range(4))
    return xp.stack([c * a - s * e, c * b - s * d, c * d + s * b, c * e + s * a], axis=-1)


def circular_error(estimate: Any, truth: Any) -> Any:
    """Return the signed difference of angles on the circle.

    Args:
        estimate: (...) rad.
        truth: (...) rad.

    Returns:
        (...) rad in [-pi, pi), estimate minus truth.
    """
    xp = _namespace(estimate, truth)
    return (xp.asarray(estimate) - xp.asarray(truth) + np.pi) % (2 * np.pi) - np.pi


def position_error(estimate: Any, truth: Any) -> Any:
    """Return the distance between positions.

    Args:
        estimate: (..., 3) m.
        truth: (..., 3) m, same frame.

    Returns:
        (...) m.
    """
    xp = _namespace(estimate, truth)
    difference = xp.asarray(estimate) - xp.asarray(truth)
    return _norm(xp, *(difference[..., i] for i in range(difference.shape[-1])))


def rmse(error: Any, where: Any = None, *, axis: int = -1) -> Any:
    """Return the root mean square of errors over the samples that count.

    Args:
        error: (..., T) in any unit; may be NaN where `where` is False.
        where: (..., T) bool, the samples that count; None means all.
        axis: axis of the samples.

    Returns:
        (...) in the unit of `error`; NaN where no sample counts. Its gradient is 0 where every error is.
    """
    xp = _namespace(error, where)
    error = xp.asarray(error)
    if where is None:
        return _root(xp, xp.mean(error * error, axis=axis))
    where = xp.broadcast_to(xp.asarray(where), error.shape)
    safe = xp.where(where, error, 0)
    count = xp.sum(where, axis=axis)
    mean = xp.sum(safe * safe, axis=axis) / xp.where(count == 0, 1, count).astype(error.dtype)
    return xp.where(count == 0, xp.nan, _root(xp, mean))


def broad_rmse_deg(estimate: Any, truth: Any, movement: Any) -> OrientationError:
    """Return the metric of the BROAD benchmark for a trial.

    Args:
        estimate: (..., T, 4) unit quaternions wxyz, sensor to earth.
        truth: (..., T, 4) unit quaternions wxyz, sensor to earth (ENU); NaN where occluded.
        movement: (..., T) bool, the samples that count where the truth is there.

    Returns:
        RMSE of the total, heading and inclination error, each (...), in DEGREES. The benchmark's figure is the mean of
        one of them over trials; without a magnetometer only the inclination means anything.

    Raises:
        ValueError: a last axis is not 4.

    Source: Laidig et al. 2021 (BROAD).
    """
    xp = _namespace(estimate, truth, movement)
    truth = xp.asarray(truth)
    there = ~xp.any(xp.isnan(truth), axis=-1)
    errors = orientation_error(estimate, xp.where(there[..., None], truth, _identity(xp, truth)))
    return OrientationError(*(xp.rad2deg(rmse(error, there & xp.asarray(movement))) for error in errors))


def coverage(truth: Any, lower: Any, upper: Any, where: Any = None) -> Any:
    """Return how often the truth lies in its interval.

    Args:
        truth: (..., T) in any unit.
        lower: (..., T) lower ends, inclusive, same unit.
        upper: (..., T) upper ends, inclusive, same unit.
        where: (..., T) bool, the samples that count; None means all.

    Returns:
        (...) fraction in [0, 1]; NaN where no sample counts. Of n independent samples at probability p its standard
        error is sqrt(p (1 - p) / n); samples of a filter's run are not independent.
    """
    xp = _namespace(truth, lower, upper, where)
    inside = (xp.asarray(truth) >= xp.asarray(lower)) & (xp.asarray(truth) <= xp.asarray(upper))
    where = xp.ones_like(inside) if where is None else xp.broadcast_to(xp.asarray(where), inside.shape)
    count = xp.sum(where, axis=-1)
    return xp.where(count == 0, xp.nan, xp.sum(inside & where, axis=-1) / xp.where(count == 0, 1, count))


def nees(error: Any, covariance: Any) -> Any:
    """Return the normalised estimation error squared.

    Args:
        error: (..., n) estimate to truth, in the tangent and unit of `covariance`.
        covariance: (..., n, n) what the estimator claims; positive definite.

    Returns:
        (...) without unit: error' covariance^-1 error, chi-square with n degrees of freedom, hence n on average, for a
        consistent estimator; above that it is overconfident.

    Raises:
        ValueError: the covariance is not (..., n, n).

    Source: Bar-Shalom, Li, Kirubarajan 2001, section 5.4.
    """
    xp = _namespace(error, covariance)
    error, covariance = xp.asarray(error), xp.asarray(covariance)
    n = error.shape[-1]
    if covariance.shape[-2:] != (n, n):
        raise ValueError(f"covariance: got shape {covariance.shape}, expected (..., {n}, {n}) as error has")
    if xp is np:
        return np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0], axis=-1)
    weighted = xp.vectorize(linalg.solve, signature="(n,n),(n)->(n)")(covariance, error)
    return xp.sum(error * weighted, axis=-1)


def nees_bounds(dof: int, runs: int = 1, probability: float = 0.95) -> Interval:
    """Return where the mean NEES of independent runs lies for a consistent estimator.

    Args:
        dof: degrees of freedom n of one run's error.
        runs: number of independent runs whose NEES are averaged.
        probability: two-sided probability of the interval, in (0, 1).

    Returns:
        The chi-square interval of the mean, without unit.

    Raises:
        ValueError: a number is out of range.

    Source: Bar-Shalom, Li, Kirubarajan 2001, section 5.4.
    """
    from scipy.special import gammaincinv  # scipy.stats would double the time of the import

    if dof < 1 or runs < 1 or not 0 < probability < 1:
        raise ValueError(f"got dof {dof}, runs {runs}, probability {probability}; expected >= 1, >= 1 and in (0, 1)")
    tails = (1 - probability) / 2, (1 + probability) / 2
    return Interval(*(float(2 * gammaincinv(dof * runs / 2, tail) / runs) for tail in tails))


def _namespace(*arrays: Any) -> Any:
    """The array module of the arguments: JAX if any is JAX's (or traced), else NumPy."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np


def _product(xp: Any, estimate: Any, truth: Any, *, conjugate_first: bool) -> tuple[Any, Any, Any, Any]:
    """Components of `conj(estimate) * truth` or of `estimate * conj(truth)`."""
    p, q = xp.asarray(estimate), xp.asarray(truth)
    for name, value in (("estimate", p), ("truth", q)):
        if value.shape[-1:] != (4,):
            raise ValueError(f"{name}: got shape {value.shape}, expected (..., 4), a quaternion wxyz")
    a, b, c, d = (p[..., i] for i in range(4))
    e, f, g, h = (q[..., i] for i in range(4))
    w = a * e + b * f + c * g + d * h
    if conjugate_first:
        return w, a * f - b * e - c * h + d * g, a * g - c * e - d * f + b * h, a * h - d * e - b * g + c * f
    return w, b * e - a * f - c * h + d * g, c * e - a * g - d * f + b * h, d * e - a * h - b * g + c * f


def _norm(xp: Any, *parts: Any) -> Any:
    """Euclidean norm whose gradient is zero, not NaN, at the origin."""
    return _root(xp, sum(part * part for part in parts))


def _root(xp: Any, square: Any) -> Any:
    """Square root whose gradient is zero, not infinite, at zero."""
    zero = square == 0
    return xp.where(zero, 0, xp.sqrt(xp.where(zero, 1, square))).astype(square.dtype)


def _identity(xp: Any, like: Any) -> Any:
    return xp.broadcast_to(xp.asarray([1, 0, 0, 0], dtype=like.dtype), like.shape)


__all__ = [
    "Interval",
    "OrientationError",
    "align_heading",
    "broad_rmse_deg",
    "circular_error",
    "coverage",
    "nees",
    "nees_bounds",
    "orientation_difference",
    "orientation_error",
    "position_error",
    "rmse",
]
