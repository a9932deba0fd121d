"""The IMUs of `--method onsite`: their recordings, calibrated, and what their axes may still be off."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxest.io import SensorLog
from jaxest.io.log import refuse_nan, stream, where
from jaxest.types import InputError

KINDS = ("gyroscope", "accelerometer")
AXES = ("gyroscope_axes", "accelerometer_axes")


def recording(log: SensorLog, name: str, nan: str, known: Mapping[str, Any]) -> Any:
    """Return one IMU's recording, calibrated; the accelerometer at the gyroscope's stamps, where it has others.

    Args:
        log: the log, in SI units.
        name: the IMU's.
        nan: `error`, or `missing`.
        known: calibrations by the IMU's name, as `calibrations` reads them.

    Returns:
        An `onsite_recording.Imu`.

    Raises:
        InputError: a stream is missing or too short, or holds NaN that the config does not allow.
    """
    from jaxest.calibration import imu as calibrated
    from jaxest.io import interpolate
    from jaxest.systems.onsite_recording import Imu

    gyro, force = (stream(log, f"{name}/{kind}") for kind in KINDS)
    for item, kind in ((gyro, KINDS[0]), (force, KINDS[1])):
        if nan == "error":
            refuse_nan(item, f"{where(log)}stream '{name}/{kind}'", 'nan = "missing" in a config')
    time, rates = gyro.time, np.asarray(gyro.value, np.float64)
    if not np.array_equal(time, force.time):
        inside = (time >= force.time[0]) & (time <= force.time[-1])
        time, rates = time[inside], rates[inside]
        found = interpolate(log, [f"{name}/{KINDS[1]}"], time, nan="invalid").readings[f"{name}/{KINDS[1]}"]
        forces = np.where(np.asarray(found.valid)[:, None], np.asarray(found.value, np.float64), np.nan)
    else:
        forces = np.asarray(force.value, np.float64)
    kept = np.isfinite(rates).all(axis=1) & np.isfinite(forces).all(axis=1)
    time, rates, forces = time[kept], rates[kept], forces[kept]
    if len(time) < 50:
        raise InputError(f"{where(log)}{name}: {len(time)} samples, expected at least 50")
    if name in known:
        rates, forces = calibrated.apply(known[name], rates, forces)
    return Imu(time, rates, forces)


def calibrations(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the config's file of calibrations says of each IMU; empty where there is none."""
    from jaxest.calibration import imu as calibrated

    return calibrated.load(settings["calibration"]) if "calibration" in settings else {}


def axes_off(
    settings: Mapping[str, Any], names: Sequence[str], known: Mapping[str, Any], of: Callable[..., float]
) -> list[Any]:
    """Return what the gyros' and the accelerometers' axes may be off, in the order of `AXES`.

    Args:
        settings: the config's table `[onsite]`, which has the first word.
        names: of the IMUs.
        known: calibrations by the IMU's name.
        of: makes one number of what their calibrations say.

    Returns:
        Two shares of 1.

    Raises:
        InputError: a number of the config is negative or not finite.
    """
    from jaxest.calibration.imu import UNCALIBRATED

    found = []
    for key in AXES:
        usual = of([getattr(known[name], key) if name in known else UNCALIBRATED for name in names])
        value = float(settings.get(key, usual))
        if not (value >= 0 and math.isfinite(value)):
            raise InputError(f"[onsite] {key}: got {value}, expected a number of 0 or more, such as 0.01 for 1 %")
        found.append(np.float64(value))
    return found


def single(tree: Any) -> Any:
    """Return a pytree of arrays in single precision."""
    import jax

    def one(x: Any) -> Any:
        x = np.asarray(x)
        return x.astype(np.float32) if x.dtype.kind == "f" else x

    return jax.tree.map(one, tree)


__all__ = ["AXES", "axes_off", "calibrations", "recording", "single"]
