"""The whole calibration of an IMU from a rest and from slow turning, applied to recordings, and kept in a file.

Source: Sato 2024, section III-E: about 1000 samples at rest, 10000 while turning slowly; the rotation between the two
sensors' axes goes beyond it.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.calibration import alignment, ellipsoid, imu_static
from jaxest.calibration._rotations import skew
from jaxest.files import write_text
from jaxest.filters import savitzky_golay as sg
from jaxest.types import InputError

UNCALIBRATED = 0.01
"""Standard deviation of an entry of a small MEMS sensor's axes as it comes: data sheets allow 1 to 3 %."""


SLOW = 0.5
"""s, half of the window over which the rates of slow turning are smoothed and differentiated."""


class Calibration(NamedTuple):
    """How to correct an IMU: rates and forces are `matrix @ (reading - bias)`."""

    gyroscope_bias: NDArray[np.float64]
    """(3,) rad/s"""
    gyroscope_noise: float
    """rad/s, standard deviation of a sample about an axis"""
    accelerometer_matrix: NDArray[np.float64]
    """(3, 3), into the gyroscope's axes"""
    accelerometer_bias: NDArray[np.float64]
    """(3,) m/s2"""
    accelerometer_noise: float
    """m/s2, likewise"""
    gyroscope_matrix: NDArray[np.float64] = np.eye(3)
    """(3, 3), into the axes of the case, where `tumble` found them"""
    gyroscope_axes: float = UNCALIBRATED
    """standard deviation of an entry of the gyro's matrix"""
    accelerometer_axes: float = UNCALIBRATED
    """likewise of the accelerometer's, in the case; an ellipsoid fit leaves it as the gyro's axes are"""
    accelerometer_relative: float = UNCALIBRATED
    """likewise of the accelerometer's against the gyroscope's axes, which an ellipsoid fit does tell"""
    accelerometer_bias_deviation: float = 0.3
    """m/s2, standard deviation of the accelerometer's bias along an axis"""
    accelerometer_turn: float = 0.0
    """rad, standard deviation about an axis of the turn of the accelerometer's axes against the gyroscope's, beyond
    what independent entries of `accelerometer_relative` turn: a slow turning tells the scale better than this"""


class Readings(NamedTuple):
    """A recording of one IMU."""

    time: NDArray[np.float64]
    """(n,) s, increasing."""
    gyroscope: NDArray[np.float64]
    """(n, 3) rad/s."""
    accelerometer: NDArray[np.float64]
    """(n, 3) m/s2."""


def calibrate(rest: Readings, turning: Readings | None = None) -> Calibration:
    """Calibrate an IMU.

    Args:
        rest: a recording in which it rests for a while.
        turning: one in which it turns slowly through many attitudes; None leaves the accelerometer as it is.

    Returns:
        The calibration.

    Raises:
        InputError: it never rests, or the turning does not determine the accelerometer.
    """
    still = imu_static.calibrate(*rest)
    noise = [float(np.sqrt(np.trace(c) / 3)) for c in (still.gyroscope_covariance, still.accelerometer_covariance)]
    if turning is None:
        return Calibration(still.gyroscope_bias, noise[0], np.eye(3), np.zeros(3), noise[1])
    rates = np.asarray(turning.gyroscope, np.float64) - still.gyroscope_bias
    arms = _arms(np.asarray(turning.time, np.float64), rates)
    fitted = ellipsoid.fit(turning.accelerometer, turning=arms)
    forces = ellipsoid.apply(fitted, turning.accelerometer) - arms @ fitted.lever
    turned = alignment.align(turning.time, rates, forces)
    # Of nine independent entries of one variance, those on the diagonal have it, the symmetric and the turning parts of
    # those beside it half of it each.
    variance, turn = np.diag(fitted.covariance), np.mean(turned.deviation**2)
    spread = (np.sum(variance[:3]) + 2 * np.sum(variance[3:6])) / 6
    return Calibration(
        still.gyroscope_bias, noise[0], turned.rotation @ fitted.matrix, fitted.bias, noise[1],
        accelerometer_relative=float(np.sqrt(spread)),
        accelerometer_bias_deviation=float(np.sqrt(np.mean(variance[6:]))),
        accelerometer_turn=float(np.sqrt(max(turn - spread / 2, 0.0))),
    )  # fmt: skip


def _arms(time: NDArray[np.float64], rates: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a lever is multiplied by to give the acceleration at its end, (n, 3, 3) 1/s^2, for slow turning."""
    half_width = min(max(2, round(SLOW / float(np.median(np.diff(time))))), (len(time) - 1) // 2)
    fitted = sg.smooth(time, rates, half_width=half_width, degree=2)
    w, turn = (np.asarray(x, np.float64) for x in fitted[:2])
    squares = w[:, :, None] * w[:, None, :]
    return skew(turn) + squares - np.einsum("nii->n", squares)[:, None, None] * np.eye(3)


def apply(
    calibration: Calibration, gyroscope: ArrayLike, accelerometer: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Correct rates (n, 3) and forces (n, 3)."""
    rates = (np.asarray(gyroscope, np.float64) - calibration.gyroscope_bias) @ calibration.gyroscope_matrix.T
    forces = (
        np.asarray(accelerometer, np.float64) - calibration.accelerometer_bias
    ) @ calibration.accelerometer_matrix.T
    return rates, forces


def save(calibrations: dict[str, Calibration], path: str | Path) -> None:
    """Write calibrations by the IMUs' names as JSON, replacing the file, whole or not at all."""
    plain = {name: {k: np.asarray(v).tolist() for k, v in one._asdict().items()} for name, one in calibrations.items()}
    write_text(path, json.dumps(plain, indent=2) + "\n", overwrite=True)


def load(path: str | Path) -> dict[str, Calibration]:
    """Read what `save` wrote.

    Args:
        path: the file.

    Returns:
        Calibrations by name.

    Raises:
        InputError: no such file, or not such a file; what is missing is named. The gyro's matrix and what
            follows it may be missing: a gyro that was not tumbled.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected a calibration as `calibration.imu.save` writes it")
    try:
        plain = json.loads(path.read_text(encoding="utf-8"))
        shapes = {"gyroscope_bias": (3,), "gyroscope_noise": (), "accelerometer_matrix": (3, 3),
                  "accelerometer_bias": (3,), "accelerometer_noise": (), "gyroscope_matrix": (3, 3),
                  "gyroscope_axes": (), "accelerometer_axes": (), "accelerometer_relative": (),
                  "accelerometer_bias_deviation": (), "accelerometer_turn": ()}  # fmt: skip
        usual = Calibration._field_defaults
        found = {}
        for name, one in plain.items():
            values = {key: np.asarray({**usual, **one}[key], np.float64) for key in shapes}
            for key, value in values.items():
                if value.shape != shapes[key]:
                    raise InputError(f"{path}: {name}: {key} has shape {value.shape}, expected {shapes[key]}")
                if not np.isfinite(value).all():
                    raise InputError(f"{path}: {name}: {key} is {value.tolist()}, expected finite numbers")
            plain_ones: Any = {key: v if v.shape else float(v) for key, v in values.items()}
            found[name] = Calibration(**plain_ones)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a calibration: {type(error).__name__}: {error}") from None
    return found


__all__ = ["Calibration", "Readings", "apply", "calibrate", "load", "save"]
