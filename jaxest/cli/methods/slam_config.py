"""The config's table `[slam]`: what may be in it, its numbers, and the sensors that it lays out."""

from collections.abc import Mapping
from typing import Any

import numpy as np

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
    """Return what `systems.slam.build` is told beside robot and sensors; raises InputError for a size that is none."""
    from jaxest.mapping import Hashed

    return {
        "layout": Hashed(_number("voxel", settings.get("voxel", 0.2))), "capacity": settings.get("capacity", 16384),
        "points": settings.get("points", 128), "align": settings.get("align", False),
    }  # fmt: skip


def _number(name: str, value: float) -> float:
    least = "more than 0" if name in POSITIVE else "at least 0"
    if not np.isfinite(value) or value < 0 or (value == 0 and name in POSITIVE):
        raise InputError(f"[slam] {name}: got {value:g}, expected a finite number, {least}")
    return float(value)


def sensors(settings: Mapping[str, Any]) -> list[Any]:
    """Read the sensors of a config: rings first, then single ones, each in the config's order.

    Raises:
        InputError: there is none, or one has no frame or place.
    """
    from jaxest.sensors.proximity import Proximity, ring

    found: list[Any] = []
    for name, table in settings.get("rings", {}).items():
        frames = table.get("frames", [table["frame"]] if "frame" in table else [])
        if not frames:
            raise InputError(f'[slam.rings.{name}]: has no frame, expected frame = "..." or frames = [...]')
        options = {k: v for k, v in table.items() if k not in ("frame", "frames", "along")}
        for frame in frames:
            found += ring(frame, table.get("along", 0.0), **options)
    for name, table in settings.get("sensors", {}).items():
        missing = [k for k in ("frame", "position", "directions") if k not in table]
        if missing:
            raise InputError(f"[slam.sensors.{name}]: has no {', '.join(missing)}")
        away = np.asarray(table["directions"], float).reshape(-1, 3)
        away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        limits = {k: table[k] for k in ("minimum", "maximum") if k in table}
        found.append(Proximity(table["frame"], np.asarray(table["position"], float), away, **limits))
    if not found:
        raise InputError(
            "[slam] names no sensor; expected a --config with a table for each ring of sensors about links, as in "
            '[slam.rings.arm] frames = ["link1"], or for each sensor, as in [slam.sensors.nose] frame = "hand", '
            "position = [0, 0, 0.1], directions = [[0, 0, 1]]"
        )
    return found


__all__ = ["numbers", "options", "schema", "sensors", "told"]
