"""Units that logs come in, and what each kind of stream is measured in."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.types import InputError, unknown_name

STANDARD_GRAVITY = 9.80665  # m/s2, exact by definition


class Unit(NamedTuple):
    """`value_SI = factor * value + offset`."""

    si: str
    factor: float = 1.0
    offset: float = 0.0


class Kind(NamedTuple):
    """What a stream of a known name holds."""

    units: tuple[str, ...]
    shape: tuple[int, ...] | None = None


_DEG = math.pi / 180

# Case matters: g and mg are accelerations, G and mG magnetic flux densities.
UNITS = {
    "1": Unit("1"), "%": Unit("1", 0.01),
    "rad": Unit("rad"), "mrad": Unit("rad", 1e-3), "deg": Unit("rad", _DEG), "rev": Unit("rad", 2 * math.pi),
    "rad/s": Unit("rad/s"), "mrad/s": Unit("rad/s", 1e-3), "deg/s": Unit("rad/s", _DEG), "dps": Unit("rad/s", _DEG),
    "mdps": Unit("rad/s", 1e-3 * _DEG), "rpm": Unit("rad/s", math.pi / 30),
    "rad/s2": Unit("rad/s2"), "deg/s2": Unit("rad/s2", _DEG),
    "m/s2": Unit("m/s2"), "cm/s2": Unit("m/s2", 1e-2), "mm/s2": Unit("m/s2", 1e-3),
    "g": Unit("m/s2", STANDARD_GRAVITY), "mg": Unit("m/s2", 1e-3 * STANDARD_GRAVITY),
    "T": Unit("T"), "mT": Unit("T", 1e-3), "uT": Unit("T", 1e-6), "nT": Unit("T", 1e-9),
    "G": Unit("T", 1e-4), "gauss": Unit("T", 1e-4), "Gauss": Unit("T", 1e-4), "mG": Unit("T", 1e-7),
    "s": Unit("s"), "ms": Unit("s", 1e-3), "us": Unit("s", 1e-6), "ns": Unit("s", 1e-9), "min": Unit("s", 60.0),
    "m": Unit("m"), "cm": Unit("m", 1e-2), "mm": Unit("m", 1e-3), "um": Unit("m", 1e-6), "km": Unit("m", 1e3),
    "m/s": Unit("m/s"), "cm/s": Unit("m/s", 1e-2), "mm/s": Unit("m/s", 1e-3), "km/h": Unit("m/s", 1 / 3.6),
    "Nm": Unit("Nm"), "mNm": Unit("Nm", 1e-3), "Ncm": Unit("Nm", 1e-2),
    "N": Unit("N"), "mN": Unit("N", 1e-3), "kN": Unit("N", 1e3),
    "Hz": Unit("Hz"), "kHz": Unit("Hz", 1e3),
    "K": Unit("K"), "degC": Unit("K", 1.0, 273.15),
    "Pa": Unit("Pa"), "hPa": Unit("Pa", 1e2), "mbar": Unit("Pa", 1e2), "kPa": Unit("Pa", 1e3), "bar": Unit("Pa", 1e5),
    "A": Unit("A"), "mA": Unit("A", 1e-3), "V": Unit("V"), "mV": Unit("V", 1e-3),
}  # fmt: skip

_ALIASES = {
    "rad/sec": "rad/s", "deg/sec": "deg/s", "degrees": "deg", "degree": "deg", "radians": "rad", "radian": "rad",
    "m/s/s": "m/s2", "ms-2": "m/s2", "m*s-2": "m/s2", "rads-1": "rad/s", "tesla": "T", "microtesla": "uT",
    "sec": "s", "seconds": "s", "second": "s", "millis": "ms", "micros": "us", "nanos": "ns", "N*m": "Nm", "N.m": "Nm",
    "Gs": "G", "mGauss": "mG", "mgauss": "mG", "C": "degC", "metre": "m", "meter": "m", "hz": "Hz", "mps2": "m/s2",
}  # fmt: skip

KINDS = {
    "gyroscope": Kind(("rad/s",), (3,)),
    "accelerometer": Kind(("m/s2",), (3,)),
    "magnetometer": Kind(("T", "1"), (3,)),
    "orientation": Kind(("1",), (4,)),
    "joint_position": Kind(("rad", "m")),
    "joint_velocity": Kind(("rad/s", "m/s")),
    "joint_acceleration": Kind(("rad/s2", "m/s2")),
    "joint_torque": Kind(("Nm", "N")),
}


def kind_of(name: str) -> str:
    """Return the last part of a stream's name, which says what it holds: `gyroscope` for `imu0/gyroscope`."""
    return name.rsplit("/", 1)[-1]


def shape_of(name: str) -> tuple[int, ...] | None:
    """Return the shape of one sample of a stream of this name, or None where the name does not fix it."""
    kind = KINDS.get(kind_of(name))
    return kind.shape if kind else None


def lookup(text: str) -> Unit:
    """Find a unit by the name that people write.

    Args:
        text: for example `deg/s`, `m/s^2`, `µT`, `N m`.

    Returns:
        The SI unit, and the factor and offset to it.

    Raises:
        InputError: nobody knows that unit; the message names the closest ones.
    """
    plain = text.strip().replace("µ", "u").replace("μ", "u").replace("²", "2").replace("°", "deg").replace("·", "*")
    plain = plain.replace("**", "^").replace("^", "").replace(" ", "")
    plain = _ALIASES.get(plain, plain)
    if plain not in UNITS:
        raise unknown_name("unit", text, UNITS)
    return UNITS[plain]


def for_stream(name: str, text: str) -> Unit:
    """Find a unit and make sure that it can belong to the stream.

    Args:
        name: the stream's name.
        text: the unit as written.

    Returns:
        The unit.

    Raises:
        InputError: unknown unit, or one of another quantity (an angle for a gyroscope).
    """
    unit = lookup(text)
    kind = KINDS.get(kind_of(name))
    if kind and unit.si not in kind.units:
        usable = [u for u, entry in UNITS.items() if entry.si in kind.units]
        raise InputError(f"unit {text!r} is one of {unit.si}, which {name!r} is not; expected one of {usable}")
    return unit


def convert(value: NDArray[Any], unit: Unit) -> NDArray[Any]:
    """Convert to SI; float32 stays float32 (computed in float64), integers become float64 where anything changes.

    Args:
        value: (...) in the unit.
        unit: from `lookup`.

    Returns:
        (...) in `unit.si`.
    """
    if unit.factor == 1.0 and unit.offset == 0.0:
        return value
    dtype = value.dtype if value.dtype.kind == "f" else np.dtype(np.float64)
    return (value.astype(np.float64) * unit.factor + unit.offset).astype(dtype)


def seconds(stamps: NDArray[Any], unit: str) -> NDArray[np.float64]:
    """Convert stamps to float64 seconds.

    Integers are split into whole seconds and rest, as nanoseconds since 1970 do not fit in a float64.

    Args:
        stamps: (n,) numbers or datetime64.
        unit: unit of time that numbers are in.

    Returns:
        (n,) s.

    Raises:
        InputError: not a unit of time, or not numbers.
    """
    entry = lookup(unit)
    if entry.si != "s":
        raise InputError(f"{unit!r} is no unit of time; expected s, ms, us or ns")
    if stamps.dtype.kind == "M":
        known, whole = ~np.isnat(stamps), seconds(stamps.astype("datetime64[ns]").astype(np.int64), "ns")
        return np.where(known, whole, np.nan)
    if stamps.dtype.kind in "iu" and entry.factor < 1:
        per_second = round(1 / entry.factor)
        whole, rest = np.divmod(stamps, per_second)
        return whole.astype(np.float64) + rest.astype(np.float64) / per_second
    if stamps.dtype.kind not in "iuf":
        raise InputError(f"stamps are of dtype {stamps.dtype}, expected numbers")
    return stamps.astype(np.float64) * entry.factor


def default_unit(name: str) -> str:
    """Return the SI unit that a stream of this name is in where nobody says, or nothing where the name is unknown."""
    kind = KINDS.get(kind_of(name))
    return kind.units[0] if kind else ""
