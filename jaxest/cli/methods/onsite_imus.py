"""The IMUs of `--method onsite`: their recordings, calibrated, and what their axes may still be off."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.io import SensorLog
from jaxest.io.log import finite_rows, refuse_nan, stream, where
from jaxest.stamps import GAP, around, longest
from jaxest.types import InputError, unknown_name

KINDS = ("gyroscope", "accelerometer")
AXES = ("gyroscope_axes", "accelerometer_axes")
FEWEST = 50  # samples of an IMU


def recording(log: SensorLog, name: str, nan: str, known: Mapping[str, Any]) -> Any:
    """Return one IMU's recording, calibrated; the accelerometer at the gyroscope's stamps, where it has others.

    What lies in a gap of either is left out; which readings stand at a limit is told from those before calibration.

    Args:
        log: the log, in SI units.
        name: the IMU's.
        nan: `error`, or `missing`.
        known: calibrations by the IMU's name, as `calibrations` reads them.

    Returns:
        An `onsite_recording.Imu`.

    Raises:
        InputError: a stream is missing or too short, or holds NaN that the config does not allow; or the two have no
            time in common, or the accelerometer is much slower than the gyroscope.
    """
    from jaxest.calibration import imu as calibrated
    from jaxest.systems.onsite_recording import Imu, clipped, resampled

    gyro, force = (stream(log, f"{name}/{kind}") for kind in KINDS)
    for item, kind in ((gyro, KINDS[0]), (force, KINDS[1])):
        if nan == "error":
            refuse_nan(item, f"{where(log)}stream '{name}/{kind}'", 'nan = "missing" in a config')
    time, rates, forces = gyro.time, np.asarray(gyro.value, np.float64), np.asarray(force.value, np.float64)
    flat = [clipped(rates), clipped(forces)]
    if not np.array_equal(time, force.time):
        there = finite_rows(forces)
        stamps, forces = force.time[there], forces[there]
        _refuse_apart(log, name, time, stamps)
        flat[1] = flat[1][there][around(stamps, time)].any(axis=1)
        forces, there = resampled(stamps, forces, time)
        forces = np.where(there[:, None], forces, np.nan)
    kept = finite_rows(rates) & finite_rows(forces)
    time, rates, forces = time[kept], rates[kept], forces[kept]
    if len(time) < FEWEST:
        raise InputError(f"{where(log)}{name}: {len(time)} samples, expected at least {FEWEST}")
    if name in known:
        rates, forces = calibrated.apply(known[name], rates, forces)
    return Imu(time, rates, forces, np.column_stack(flat)[kept])


def _refuse_apart(log: SensorLog, name: str, gyro: NDArray[np.float64], force: NDArray[np.float64]) -> None:
    """Refuse stamps of a gyroscope (n,) and an accelerometer (m,) that cannot be brought together."""
    one, other = (f"{name}/{kind}" for kind in KINDS)
    if len(force) < FEWEST:
        raise InputError(f"{where(log)}{other}: {len(force)} samples, expected at least {FEWEST}")
    if gyro[0] > force[-1] or force[0] > gyro[-1]:
        raise InputError(
            f"{where(log)}{one} and {other} do not overlap: one from {gyro[0]:.3f} to {gyro[-1]:.3f} s, the other from "
            f"{force[0]:.3f} to {force[-1]:.3f} s"
        )
    if longest(force) > GAP * longest(gyro):
        rates = [GAP / longest(time) for time in (force, gyro)]
        raise InputError(
            f"{where(log)}{other}: {rates[0]:.4g} Hz beside {rates[1]:.4g} Hz of {one}, expected at least "
            f"{rates[1] / GAP:.4g} Hz: between its samples the motion is not known"
        )


def calibrations(settings: Mapping[str, Any], names: Sequence[str]) -> tuple[dict[str, Any], list[str]]:
    """Return what the config's file of calibrations says of each IMU, and which IMUs it is of.

    Args:
        settings: the config's table `[onsite]`.
        names: of the IMUs that are used.

    Returns:
        Calibrations by name, none where there is no file; and notes.

    Raises:
        InputError: the file knows none of the IMUs.
    """
    from jaxest.calibration import imu as calibrated

    if "calibration" not in settings:
        return {}, []
    file = settings["calibration"]
    known = calibrated.load(file)
    there, missing = ([n for n in names if (n in known) is which] for which in (True, False))
    if not there:
        raise unknown_name(f"{file}: calibration of", names[0], known)
    without = f"; not of {', '.join(missing)}, taken as they come" if missing else ""
    return known, [f"{file}: calibration of {', '.join(there)}{without}"]


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
