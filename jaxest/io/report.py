"""The JSON object that every command prints: figures with their unit, spread and reference."""

import json
import math
import os
from collections.abc import Sequence
from importlib import metadata
from typing import Any, NamedTuple


class Row(NamedTuple):
    """One figure."""

    metric: str
    condition: str
    value: float | None
    unit: str
    spread: float | None = None
    """Of the same unit, for example the interquartile range of repetitions."""
    n: int | None = None
    """How many samples or repetitions the value stands for."""
    reference: float | None = None
    """What it is compared with: a paper's figure, a peer's time."""
    reference_name: str | None = None
    ratio: float | None = None
    """How much better than the reference, as the metric defines it."""


class Report(NamedTuple):
    """Figures, and the environment that they come from."""

    name: str
    jaxest: str
    jax: str
    mujoco: str
    devices: tuple[str, ...]
    flags: tuple[str, ...]
    rows: tuple[Row, ...]


class Environment(NamedTuple):
    """Versions, devices and flags; the fields of a `Report` of the same names."""

    jaxest: str
    jax: str
    mujoco: str
    devices: tuple[str, ...]
    flags: tuple[str, ...]


def environment() -> Environment:
    """Gather what figures depend on; asks JAX for its devices, which starts its backend.

    Returns:
        Versions, devices, and the flags given to XLA and JAX by environment variables.
    """
    import jax

    import jaxest

    devices = tuple(f"{device.platform}:{device.device_kind}" for device in jax.devices())
    flags = [*os.environ.get("XLA_FLAGS", "").split()]
    flags += [f"{name}={os.environ[name]}" for name in ("JAX_ENABLE_X64", "JAX_PLATFORMS") if name in os.environ]
    return Environment(jaxest.__version__, jax.__version__, _version("mujoco"), devices, tuple(flags))


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "absent"


def report(name: str, rows: Sequence[Row]) -> Report:
    """Put rows into a report of this environment.

    Args:
        name: of the command or benchmark.
        rows: the figures.

    Returns:
        The report.
    """
    return Report(name, *environment(), rows=tuple(rows))


def to_json(item: Report) -> str:
    """Write a report as one JSON object.

    Args:
        item: the report; values may be NumPy or JAX scalars.

    Returns:
        Valid JSON on several lines; what is not finite becomes null.
    """
    fields = {**item._asdict(), "rows": [row._asdict() for row in item.rows]}
    return json.dumps(_plain(fields), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    """Turn scalars of any library into Python's, and what is not finite into None."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    if hasattr(value, "item"):
        return _plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    raise ValueError(f"report: cannot write {value!r} of type {type(value).__name__}, expected numbers and text")
