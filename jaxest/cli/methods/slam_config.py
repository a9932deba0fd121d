"""The config's table `[slam]`: what may be in it, its numbers, and the sensors that it lays out."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.types import InputError

WORDS = ("joints", "ranges", "travel_stream", "turn_stream", "imu", "gyroscope_stream", "accelerometer_stream")
POSITIVE = ("noise", "gate", "voxel")  # the other numbers may be 0


def numbers() -> tuple[str, ...]:
    """Return the names of all parameters, in the units that `systems.slam.Params` says."""
    from jaxest.systems.slam import Params

    return Params._fields


def schema() -> dict[str, Any]:
    """Return what may be in the config's table `[slam]`, as `jaxest.io.config` takes it."""
    lengths = dict.fromkeys(("along", "radius", "field_deg", "minimum", "maximum"), float)
    ring = {"frame": str, "frames": list, **lengths, **dict.fromkeys(("count", "rows", "columns"), int)}
    one = {"frame": str, "position": list, "directions": list, "minimum": float, "maximum": float}
    return {
        **dict.fromkeys(WORDS, str), **dict.fromkeys(numbers(), float), "voxel": float, "capacity": int, "points": int,
        "align": bool, "rings": {"*": ring}, "sensors": {"*": one},
    }  # fmt: skip


def told(settings: Mapping[str, Any]) -> dict[str, float]:
    """Return the parameters that a config sets; raises InputError for a number that no parameter can be."""
    return {name: _number(name, settings[name]) for name in numbers() if name in settings}


def options(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what `systems.slam.build` is told beside robot and sensors.

    Raises:
        InputError: a size is none, or sensors are to be aligned by nothing.
    """
    from jaxest.mapping import Hashed

    sizes = {name: settings.get(name, default) for name, default in (("capacity", 16384), ("points", 128))}
    for name, value in sizes.items():
        _at_least_one(f"[slam] {name}", value)
    align = settings.get("align", False)
    if align and not settings.get("tilt", 0.0):
        raise InputError(
            "[slam] align: is true without a tilt, by which no sensor would be found turned; expected tilt too, the "
            "standard deviation of a sensor's direction about each axis in rad, such as 0.02"
        )
    return {"layout": Hashed(_number("voxel", settings.get("voxel", 0.2))), "align": align, **sizes}


def _at_least_one(place: str, value: int) -> None:
    if value < 1:
        raise InputError(f"{place}: got {value}, expected at least 1")


def _number(name: str, value: float) -> float:
    least = "more than 0" if name in POSITIVE else "at least 0"
    if not np.isfinite(value) or value < 0 or (value == 0 and name in POSITIVE):
        raise InputError(f"[slam] {name}: got {value:g}, expected a finite number, {least}")
    return float(value)


def sensors(settings: Mapping[str, Any]) -> list[Any]:
    """Read the sensors of a config: rings first, then single ones, each in the config's order.

    Raises:
        InputError: there is none, or one has no frame or place, or numbers that are none.
    """
    from jaxest.sensors.proximity import Proximity, ring

    found: list[Any] = []
    for name, table in settings.get("rings", {}).items():
        frames = table.get("frames", [table["frame"]] if "frame" in table else [])
        if not frames:
            raise InputError(f'[slam.rings.{name}]: has no frame, expected frame = "..." or frames = [...]')
        options = {k: v for k, v in table.items() if k not in ("frame", "frames", "along")}
        _at_least_one(f"[slam.rings.{name}] count", table.get("count", 1))
        for frame in frames:
            found += ring(frame, table.get("along", 0.0), **options)
    for name, table in settings.get("sensors", {}).items():
        missing = [k for k in ("frame", "position", "directions") if k not in table]
        if missing:
            raise InputError(f"[slam.sensors.{name}]: has no {', '.join(missing)}")
        place = f"[slam.sensors.{name}]"
        (position,) = _threes(f"{place} position", [table["position"]], "[x, y, z] in m")
        away = _threes(f"{place} directions", table["directions"], "a list of one or more [x, y, z]")
        away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        limits = {k: table[k] for k in ("minimum", "maximum") if k in table}
        found.append(Proximity(table["frame"], position, away, **limits))
    if not found:
        raise InputError(
            "[slam] names no sensor; expected a --config with a table for each ring of sensors about links, as in "
            '[slam.rings.arm] frames = ["link1"], or for each sensor, as in [slam.sensors.nose] frame = "hand", '
            "position = [0, 0, 0.1], directions = [[0, 0, 1]]"
        )
    return found


def _threes(place: str, given: list[Any], expected: str) -> NDArray[np.float64]:
    """Return rows (n, 3) of finite numbers; raises InputError for anything else."""
    threes = [row for row in given if isinstance(row, list) and len(row) == 3]
    numbers = [x for row in threes for x in row if isinstance(x, int | float) and np.isfinite(x)]
    if not given or len(numbers) != 3 * len(given):
        raise InputError(f"{place}: got {given if len(given) != 1 else given[0]!r}, expected {expected}")
    return np.array(numbers, float).reshape(-1, 3)


__all__ = ["numbers", "options", "schema", "sensors", "told"]
