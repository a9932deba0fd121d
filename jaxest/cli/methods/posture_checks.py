"""What an IMU's streams give away about units, axes, stuck or saturated channels, before they become a posture."""

import itertools

import numpy as np
from numpy.typing import NDArray

from jaxest.io import SensorLog, Stream, plausible
from jaxest.io.log import stream, where
from jaxest.stamps import gaps
from jaxest.types import InputError

ALIKE = 0.02
"""Share of samples at a channel's largest value above which it counts as saturated."""
SPREAD = 0.25
"""Scatter of a magnetometer's norm, as a share of it, above which it counts as not calibrated."""
AGREES = 0.8
"""Correlation of the measured turn of gravity with the gyroscope's that says that axes fit."""
AXES = "xyz"


def check(log: SensorLog, imu: str, kinds: tuple[str, ...]) -> list[str]:
    """Refuse readings of one IMU that cannot be used, and say what is doubtful.

    Args:
        log: the log, in SI units.
        imu: the prefix of the IMU's streams.
        kinds: of its streams.

    Returns:
        A sentence for each doubt.

    Raises:
        InputError: an axis is missing, a channel is constant or saturated, a unit is wrong, axes are swapped, or the
            magnetometer is not calibrated; stream, what was found and what was expected are named.
    """
    items = {kind: stream(log, f"{imu}/{kind}") for kind in kinds}
    for kind, item in items.items():
        _channels(f"{where(log)}stream '{imu}/{kind}'", item)
    place = f"{where(log)}stream '{imu}/accelerometer'"
    norm = plausible.median_norm(items["accelerometer"].value)
    if plausible.acceleration_unit(items["accelerometer"].value) != "m/s2":
        guess = "; is it in g?" if plausible.acceleration_unit(items["accelerometer"].value) == "g" else ""
        raise InputError(f"{place}: its median norm is {norm:.3g}, expected about 9.8 m/s2{guess}")
    _turns(log, imu, items)
    if "magnetometer" in items:
        _field(f"{where(log)}stream '{imu}/magnetometer'", items["magnetometer"])
    return [note for kind, item in items.items() for note in _gaps(f"{imu}/{kind}", item)]


def _channels(place: str, item: Stream) -> None:
    value = np.asarray(item.value, np.float64)
    if value.ndim != 2 or value.shape[1] != 3:
        raise InputError(f"{place}: got shape {value.shape}, expected (n, 3); is an axis missing?")
    if len(value) < 20:
        return
    for axis, name in enumerate(AXES):
        channel = value[np.isfinite(value[:, axis]), axis]
        if len(channel) == 0 or np.ptp(channel) == 0:
            at = f" at {channel[0]:g}" if len(channel) else ""
            raise InputError(f"{place}: channel {name} is constant{at}, expected readings; is it connected?")
        top = np.abs(channel).max()
        share = float(np.mean(np.abs(channel) >= top))
        # A quiet channel sits at its largest value as well, but has few values in all: steps of its converter.
        if share > ALIKE and len(np.unique(channel)) > 20:
            raise InputError(
                f"{place}: channel {name} is at {top:g} in {100 * share:.0f} % of the samples, expected fewer than "
                f"{100 * ALIKE:.0f} %; it is saturated, choose a wider range"
            )


def _turns(log: SensorLog, imu: str, items: dict[str, Stream]) -> None:
    """Compare the gyroscope with how gravity turns."""
    gyro, acc = items["gyroscope"], items["accelerometer"]
    place = f"{where(log)}stream '{imu}/gyroscope'"
    if plausible.too_fast(gyro.value):
        raise InputError(f"{place}: rates beyond {plausible.FASTEST:g} rad/s, expected rad/s; is it in deg/s?")
    columns = [np.interp(gyro.time, acc.time, np.asarray(acc.value, np.float64)[:, k]) for k in range(3)]
    force = np.stack(columns, axis=1)
    rate = np.asarray(gyro.value, np.float64)
    found = plausible.rate_check(gyro.time, rate, force)
    if plausible.in_degrees(found):
        raise InputError(
            f"{place}: gravity turns by {found.ratio:.3g} of what it says, expected 1 in rad/s; is it in deg/s?"
        )
    if not np.isfinite(found.ratio) or found.correlation > AGREES:
        return
    best = max(_arrangements(), key=lambda way: _fits(gyro.time, rate, force, way))
    if _fits(gyro.time, rate, force, best) > AGREES:
        named = ", ".join(("-" if sign < 0 else "") + AXES[axis] for axis, sign in zip(*best, strict=True))
        raise InputError(
            f"{place}: its axes are not those of the accelerometer, expected both along the same x, y, z; ({named}) of "
            "the gyroscope would fit"
        )


def _arrangements() -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    return [
        (axes, signs) for axes in itertools.permutations(range(3)) for signs in itertools.product((1, -1), repeat=3)
    ]


def _fits(
    time: NDArray[np.float64],
    rate: NDArray[np.float64],
    force: NDArray[np.float64],
    way: tuple[tuple[int, ...], tuple[int, ...]],
) -> float:
    axes, signs = way
    return plausible.rate_check(time, rate[:, list(axes)] * np.array(signs), force).correlation


def _field(place: str, item: Stream) -> None:
    value = np.asarray(item.value, np.float64)
    norm = np.linalg.norm(value[np.isfinite(value).all(axis=1)], axis=1)
    if len(norm) and norm.std() > SPREAD * norm.mean():
        raise InputError(
            f"{place}: its norm scatters by {100 * norm.std() / norm.mean():.0f} %, expected up to {100 * SPREAD:.0f}; "
            "calibrate it (jaxest.calibration.ellipsoid) or set magnetometer = false"
        )


def _gaps(name: str, item: Stream) -> list[str]:
    long = np.diff(item.time)[gaps(item.time)]
    if len(long) == 0:
        return []
    many = "a gap of" if len(long) == 1 else f"{len(long)} gaps, the longest"
    return [f"{name} has {many} {long.max():.2f} s: bridged by prediction, with a growing covariance"]


__all__ = ["check"]
