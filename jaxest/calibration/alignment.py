"""How an accelerometer's axes are turned against the gyroscope's of the same IMU, from slow turning.

An ellipsoid fit leaves a rotation open: the length of gravity does not tell it. Its direction does: at rest in the
earth it turns in the sensor as the gyro says, u(t) = D u(s) for the rotation D between two moments, so that readings
x = Q u of an accelerometer turned by Q obey Q' x(t) = D Q' x(s).

Source: the equation A X = X B of hand-eye calibration, linear for a small Q.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.calibration._recordings import recorded
from jaxest.calibration._rotations import rotations, skew
from jaxest.types import InputError


class Alignment(NamedTuple):
    """How to turn accelerometer readings into the gyro's frame: `rotation @ reading`."""

    rotation: NDArray[np.float64]
    """(3, 3)"""
    deviation: NDArray[np.float64]
    """(3,) rad, standard deviations about the axes."""


def align(
    time: ArrayLike, gyroscope: ArrayLike, accelerometer: ArrayLike, *, span: float = 1.0, tolerance: float = 0.01
) -> Alignment:
    """Find the rotation between the axes of an IMU's two sensors.

    Args:
        time: (n,) s, increasing.
        gyroscope: (n, 3) rad/s, without bias.
        accelerometer: (n, 3) m/s2, scaled and without bias, while the IMU turns slowly and hardly accelerates.
        span: s, between the moments that are compared.
        tolerance: rad, largest standard deviation with which the result is accepted.

    Returns:
        The rotation.

    Raises:
        InputError: shapes or stamps are wrong, values are not finite, the recording is too short, or the turning does
            not tell; the axis is named.
    """
    t, w, f = recorded(("time", time), gyroscope=gyroscope, accelerometer=accelerometer)
    count = max(round(span / float(np.median(np.diff(t)))), 1)
    if len(t) < 20 * count:
        raise InputError(f"time: got {len(t)} samples, expected at least {20 * count}, twenty times {span} s")
    turns = _turned(t, w, count)
    x, y = f[:-count], f[count:]
    found, errors, slopes = np.eye(3), np.zeros((0, 3)), np.zeros((0, 3, 3))
    for _ in range(5):
        x0, y0 = x @ found.T, y @ found.T
        moved = np.einsum("nij,nj->ni", turns, x0)
        # A further small turn v of the readings: y0 + v x y0 = D (x0 + v x x0), and v x y0 = -y0 x v.
        errors = y0 - moved
        slopes = skew(y0) - turns @ skew(x0)
        gram = np.einsum("nji,njk->ik", slopes, slopes)
        change = np.linalg.lstsq(gram, np.einsum("nji,nj->i", slopes, errors), rcond=1e-12)[0]
        found = rotations(change[None])[0] @ found
        if np.linalg.norm(change) < 1e-10:
            break
    return _judged(found, errors, slopes, count, tolerance)


def _judged(
    found: NDArray[np.float64], errors: NDArray[np.float64], slopes: NDArray[np.float64], count: int, tolerance: float
) -> Alignment:
    gram = np.einsum("nji,njk->ik", slopes, slopes)
    # The readings' own noise makes slopes that tell nothing.
    gram = gram - 2 * np.mean(errors**2) * len(errors) * np.eye(3)
    whole = len(errors) // count * count
    scores = np.einsum("nji,nj->ni", slopes, errors)[:whole].reshape(-1, count, 3).sum(axis=1)
    inverse = np.linalg.pinv(gram, rcond=1e-12)
    covariance = inverse @ (scores.T @ scores) @ inverse
    white = inverse * np.mean(errors**2)
    deviation = np.sqrt(np.maximum(np.diag(covariance), np.diag(white)))
    values, vectors = np.linalg.eigh(gram)
    if values[0] < 1e-6 * values[-1] or not deviation.max() <= tolerance:
        axis = ", ".join(f"{v:.2f}" for v in vectors[:, 0] * np.sign(vectors[np.argmax(np.abs(vectors[:, 0])), 0]))
        raise InputError(
            f"the turning does not tell how the accelerometer is turned about [{axis}]: known to "
            f"{deviation.max():.3g} rad, expected {tolerance:g}; turn the sensor about other axes, slowly"
        )
    return Alignment(found, deviation)


def _turned(time: NDArray[np.float64], rate: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Rotations (n - count, 3, 3) D of the earth's vectors in the sensor from each moment to `count` samples later."""
    steps = rotations((rate[1:] + rate[:-1]) / 2 * np.diff(time)[:, None])
    number = len(time) - count
    product = steps[:number]
    for shift in range(1, count):
        product = product @ steps[shift : shift + number]
    return np.swapaxes(product, 1, 2)


__all__ = ["Alignment", "align", "rotations", "skew"]
