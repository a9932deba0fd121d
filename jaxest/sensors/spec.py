"""Which sensors a robot has: their names, their kinds, the frames they sit on; and what one step of them looks like."""

from collections.abc import Sequence
from functools import cache
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from jaxest.sensors import (
    end_effector_pose,
    gravity_direction,
    joint_angle,
    link_orientation,
    link_position,
    relative_orientation,
    slide_position,
)
from jaxest.types import ArrayLike, InputError, PyTree, Reading, unknown_name

KINDS = MappingProxyType(
    {
        "joint_angle": joint_angle,
        "link_orientation": link_orientation,
        "link_position": link_position,
        "end_effector_pose": end_effector_pose,
        "gravity_direction": gravity_direction,
        "relative_orientation": relative_orientation,
        "slide_position": slide_position,
    }
)
"""Name of a kind, and the module that holds it."""


class Sensor(NamedTuple):
    """One sensor of a robot."""

    kind: str
    """One of `KINDS`."""
    name: str
    """What its field in measurements and parameters is called."""
    frames: tuple[str, ...] = ()
    """The frames it looks at, as many as its kind wants; for `joint_angle` joints, all that are estimated if empty."""
    params: PyTree = None
    """Its kind's `Params`; the defaults if None."""


def module(sensor: Sensor) -> Any:
    """Return the module of a sensor's kind; raises InputError for a kind that does not exist."""
    if sensor.kind not in KINDS:
        raise unknown_name(f"sensor {sensor.name!r}: kind", sensor.kind, KINDS)
    return KINDS[sensor.kind]


def checked(sensors: Sequence[Sensor]) -> tuple[Sensor, ...]:
    """Check names, kinds and numbers of frames.

    Args:
        sensors: the sensors; a frame alone may stand for a tuple of one.

    Returns:
        The same with tuples of frames.

    Raises:
        InputError: a kind does not exist, a name cannot be a field or is there twice, or frames are missing.
    """
    found: list[Sensor] = []
    for sensor in sensors:
        kind = module(sensor)
        frames = (sensor.frames,) if isinstance(sensor.frames, str) else tuple(sensor.frames)
        if not sensor.name.isidentifier() or sensor.name.startswith("_") or sensor.name in ("dt", "others"):
            raise InputError(f"sensor {sensor.name!r}: expected a name of letters, digits and _, not dt or others")
        if any(sensor.name == other.name for other in found):
            raise InputError(f"sensor {sensor.name!r}: there are two of this name")
        if kind.FRAMES and len(frames) != kind.FRAMES:
            raise InputError(
                f"sensor {sensor.name!r}: a {sensor.kind} looks at {kind.FRAMES} frame(s), got {len(frames)}"
            )
        found.append(sensor._replace(frames=frames))
    return tuple(found)


@cache
def record(name: str, fields: tuple[str, ...]) -> Any:
    """Return a NamedTuple class with these fields; the same class for the same arguments."""
    return NamedTuple(name, [(field, Any) for field in fields])


def measurement_type(sensors: Sequence[Sensor], *, others: bool = False) -> Any:
    """Return the class of these sensors' measurements.

    Args:
        sensors: the sensors.
        others: whether measurements carry the joints that are not estimated.

    Returns:
        A NamedTuple class: a `Reading` for each sensor by its name, `others` if asked for, and `dt` () s.
    """
    names = tuple(sensor.name for sensor in checked(sensors))
    return record("Measurement", (*names, *(("others",) if others else ()), "dt"))


def default_params(sensors: Sequence[Sensor]) -> Any:
    """Return the sensors' parameters, a NamedTuple with a field for each sensor."""
    sensors = checked(sensors)
    values = [module(s).Params() if s.params is None else s.params for s in sensors]
    return record("SensorParams", tuple(s.name for s in sensors))(*values)


def check_params(sensors: Sequence[Sensor], params: PyTree) -> None:
    """Check the sensors' parameters on the host.

    Args:
        sensors: the sensors.
        params: a field for each sensor.

    Raises:
        InputError: a concentration is negative or a variance not positive, or a number is not finite or no rotation.
    """
    for sensor in checked(sensors):
        _check(f"sensor {sensor.name!r}", getattr(params, sensor.name))


def _check(place: str, params: Any) -> None:
    for field, value in params._asdict().items():
        if isinstance(value, tuple):
            _check(f"{place}: {field}", value)
            continue
        given = np.asarray(value, float)
        rule, bad = _RULES.get(field.split("_")[-1], ("finite numbers", lambda x: ~np.isfinite(x)))
        if np.any(~np.isfinite(given)) or np.any(bad(given)):
            raise InputError(f"{place}: {field} is {np.array2string(given)}, expected {rule}")


def _not_unit(x: np.ndarray) -> Any:
    return abs(np.sum(x * x) - 1) > 1e-3


_RULES = MappingProxyType(
    {
        "concentration": ("at least 0", lambda x: x < 0),
        "variance": ("positive numbers", lambda x: x <= 0),
        "mounting": ("a unit quaternion wxyz", lambda x: x.shape != (4,) or _not_unit(x)),
        "up": ("a unit vector", lambda x: x.shape != (3,) or _not_unit(x)),
        "lam": ("four numbers, none above the first", lambda x: x.shape != (4,) or np.max(x) > x[0]),
    }
)


def check_measurements(sensors: Sequence[Sensor], measurements: PyTree) -> None:
    """Check recorded measurements on the host, before they are run.

    Args:
        sensors: the sensors.
        measurements: leaves with a leading time axis.

    Raises:
        InputError: a valid value is not finite, a quaternion is not of unit length or seems to be xyzw, or time runs
            backwards; the sensor and the row are named.
    """
    dt = np.asarray(measurements.dt, float)
    backwards = np.flatnonzero(~(dt >= 0))
    if backwards.size:
        raise InputError(f"dt: row {backwards[0]} is {dt[backwards[0]]} s, expected at least 0; sort the times")
    for sensor in checked(sensors):
        reading: Reading = getattr(measurements, sensor.name)
        value = np.asarray(reading.value, float)
        valid = _wide(reading.valid, value)
        wrong = np.argwhere(valid & ~np.isfinite(value))
        if wrong.size:
            row = wrong[0][0]
            raise InputError(f"sensor {sensor.name!r}: row {row} is {value[row]}, expected finite numbers or not valid")
        if module(sensor).VALUE in ((4,), (7,)):
            _check_quaternions(sensor.name, value[:, -4:], valid[:, -1])


def _check_quaternions(name: str, value: np.ndarray, valid: np.ndarray) -> None:
    length = np.linalg.norm(np.where(valid[:, None], value, (1.0, 0, 0, 0)), axis=1)
    wrong = np.flatnonzero(abs(length - 1) > 1e-2)
    if wrong.size:
        row = wrong[0]
        raise InputError(f"sensor {name!r}: row {row} is a quaternion of length {length[row]:.4g}, expected 1")
    first, last = value[valid][:1], value[valid][:, 3]
    if first.size and abs(first[0, 3]) > 0.999 and np.all(last >= 0) and np.any(value[valid][:, 0] < 0):
        raise InputError(
            f"sensor {name!r}: row {np.flatnonzero(valid)[0]} is {first[0]}, which looks like xyzw; expected wxyz"
        )


def _wide(valid: ArrayLike, value: np.ndarray) -> np.ndarray:
    mask = np.asarray(valid, bool)
    return np.broadcast_to(mask.reshape(mask.shape + (1,) * (value.ndim - mask.ndim)), value.shape)


__all__ = [
    "KINDS",
    "Sensor",
    "check_measurements",
    "check_params",
    "checked",
    "default_params",
    "measurement_type",
    "module",
    "record",
]
