"""An IMU's axes, in scale and direction, from a block that is turned over on a level plate along a fence.

The block rests on its faces one after the other, so that its attitude at each rest is known. At rest the accelerometer
reads gravity along known directions; between two rests the gyro must integrate to the known turn. Slow turning by hand
(`ellipsoid`, `alignment`) cannot tell how the axes lie in the IMU's case, and the gyro's scale not at all.

Source: the multi-position calibration of Syed, Aggarwal, Goodall, Niu, El-Sheimy 2007 (Meas. Sci. Technol. 18, 1897)
and Tedaldi, Pretto, Menegatti 2014, here with attitudes that are known.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.calibration import imu_static
from jaxest.calibration._rotations import rotation_vector as log
from jaxest.calibration._rotations import rotations
from jaxest.calibration.imu import Calibration, Readings
from jaxest.types import InputError

G = 9.80665  # m/s2
QUARTERS = tuple(axis for axis in np.eye(3) for _ in range(4))
"""Four quarter turns about each of the case's axes: all six faces, and every axis of the gyro."""


def attitudes(turns: Sequence[ArrayLike] = QUARTERS) -> NDArray[np.float64]:
    """Return rotations (n + 1, 3, 3), case to plate, at the rests before, between and after quarter turns.

    Args:
        turns: n axes of the case, (3,) unit vectors, each turned about by 90 deg to the right.

    Returns:
        The rotations; the first is the identity, the case's z up.
    """
    found = [np.eye(3)]
    for axis in turns:
        found.append(found[-1] @ rotations(np.pi / 2 * np.asarray(axis, np.float64)[None])[0])
    return np.array(found)


def calibrate(
    readings: Readings, known: ArrayLike | None = None, *, gravity: float = G, flatness: float = 5e-4
) -> Calibration:
    """Calibrate an IMU from its rests in known attitudes and the turns between them.

    Args:
        readings: the recording, which begins and ends with a rest of a second or more.
        known: (n, 3, 3) case to plate at each rest, by default those of `QUARTERS`.
        gravity: m/s2.
        flatness: rad, standard deviation of an attitude at rest about each axis: plate, faces, fence.

    Returns:
        The calibration, in the axes of the case; how well it is known comes from the residuals, and from `flatness`
        where they are smaller by chance.

    Raises:
        InputError: rests are more or fewer than attitudes, or attitudes and turns do not tell every axis.
    """
    faces = attitudes() if known is None else np.asarray(known, np.float64)
    time, rates, forces = (np.asarray(x, np.float64) for x in readings)
    rests = imu_static.rests(time, rates, forces)
    if len(rests) != len(faces):
        raise InputError(f"the recording has {len(rests)} rests of at least 0.5 s, expected {len(faces)}, one a face")
    felt = np.array([forces[rows].mean(axis=0) for rows in rests])
    matrix, offset, sharp, level = _accelerometer(felt, gravity * faces[:, 2, :], gravity, flatness)
    resting = np.array([rates[row].mean(axis=0) for row in rests])
    turns = [_turn(time, rates, before, after) for before, after in pairwise(rests)]
    turned, exact = _gyroscope(turns, np.swapaxes(faces[:-1], 1, 2) @ faces[1:], flatness)
    noise = [_noise(x, rests) for x in (rates, forces)]
    relative = float(np.hypot(exact, sharp))
    return Calibration(
        resting.mean(axis=0), noise[0], matrix, offset, noise[1], turned, exact, sharp, relative, level
    )  # fmt: skip


def _noise(value: NDArray[np.float64], rests: Sequence[slice]) -> float:
    """Standard deviation of readings (n, 3) at rest, no less than their rounding's."""
    variance = [value[rows].var(axis=0, ddof=1) for rows in rests]
    return float(np.sqrt(np.mean(np.maximum(variance, imu_static.rounding(value) ** 2))))


def _accelerometer(
    felt: NDArray[np.float64], true: NDArray[np.float64], gravity: float, flatness: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, float]:
    """Matrix, bias and the standard deviations of the entries of either: felt = matrix^-1 true + bias."""
    design = np.hstack([true / gravity, np.ones((len(true), 1))])
    if len(true) < 4 or np.linalg.cond(design) > 100:
        raise InputError(f"tumble: {len(true)} faces do not tell the accelerometer's axes; expected rests on all six")
    found = np.linalg.lstsq(design, felt, rcond=None)[0]
    left = felt - design @ found
    variance = np.sum(left**2) / max(3 * len(felt) - 12, 1) / gravity**2
    unit = max(variance, flatness**2)
    inverse = np.diag(np.linalg.inv(design.T @ design))
    sharp, level = np.sqrt(unit * np.mean(inverse[:3])), gravity * np.sqrt(unit * inverse[3])
    return np.linalg.inv(found[:3].T / gravity), found[3], float(sharp), float(level)


def _turn(
    time: NDArray[np.float64], rates: NDArray[np.float64], before: slice, after: slice
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Durations (m,) s and mean rates (m, 3) of the intervals from the middle of a rest to that of the next."""
    rows = slice((before.start + before.stop) // 2, (after.start + after.stop) // 2 + 1)
    bias = (rates[before].mean(axis=0) + rates[after].mean(axis=0)) / 2
    value = rates[rows] - bias
    return np.diff(time[rows]), (value[1:] + value[:-1]) / 2


def _gyroscope(
    turns: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]], true: NDArray[np.float64], flatness: float
) -> tuple[NDArray[np.float64], float]:
    """Matrix that makes the rates integrate to the turns (n, 3, 3), and the standard deviation of its entries."""
    matrix = np.eye(3)
    for _ in range(6):
        rows = [_integrated(matrix, *turn) for turn in turns]
        errors = np.concatenate(
            [log(end.T @ goal) for (end, _), goal in zip(rows, true, strict=True)]
        )  # fmt: skip
        slopes = np.concatenate([slope for _, slope in rows])
        if len(errors) < 9 or np.linalg.cond(slopes) > 100:
            raise InputError(
                f"tumble: {len(errors) // 3} turns do not tell the gyroscope's axes; expected some about all three"
            )
        matrix = matrix + np.linalg.lstsq(slopes, errors, rcond=None)[0].reshape(3, 3)
    variance = np.sum(errors**2) / max(len(errors) - 9, 1)
    # Both rests of a turn have an error.
    spread = max(variance, 2 * flatness**2) * np.mean(np.diag(np.linalg.inv(slopes.T @ slopes)))
    return matrix, float(np.sqrt(spread))


def _integrated(
    matrix: NDArray[np.float64], dt: NDArray[np.float64], value: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation at the end of a turn, and what the matrix' entries (9) do to it on the right, (3, 9)."""
    steps = rotations(value @ matrix.T * dt[:, None])
    left = np.empty_like(steps)  # from after each step to the end
    behind = np.eye(3)
    for i in range(len(steps) - 1, -1, -1):
        left[i] = behind
        behind = steps[i] @ behind
    slope = np.einsum("tji,tk,t->ijk", left, value, dt).reshape(3, 9)
    return behind, slope


__all__ = ["QUARTERS", "G", "attitudes", "calibrate", "log"]
