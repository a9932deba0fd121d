"""Samples of two IMUs at a sensor's limit."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.systems.onsite_simulation import Pair
from jaxest.types import Reading

CLIPPED = 3  # equal readings in a row, at the largest value of the axis, that look like a limit and not like chance


def clipped(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell which of readings (n, 3) stand at a limit of their sensor: the extreme value, again and again in a row."""
    found = np.zeros(values.shape, bool)
    for axis, column in enumerate(np.asarray(values).T):
        for extreme in (column.max(), column.min()):
            at = column == extreme
            if np.ptp(column) > 0 and any(np.all(at[i : i + CLIPPED]) for i in np.flatnonzero(at)[: -CLIPPED + 1]):
                found[:, axis] |= at
    return np.any(found, axis=1)


def without_clipped(measurements: Pair) -> Pair:
    """Mask samples at a sensor's limit; of P, whose samples were interpolated, those within its flat pieces."""
    kept: dict[str, Any] = {}
    for name in Pair._fields[:4]:
        reading = getattr(measurements, name)
        value = np.asarray(reading.value)
        flat = clipped(value) if name.endswith("_a") else _flat(value)
        valid: Any = np.asarray(reading.valid) & ~flat
        kept[name] = Reading(reading.value, valid)
    return measurements._replace(**kept)


def _flat(value: NDArray[Any]) -> NDArray[np.bool_]:
    """Rows within a millionth of an axis' span of its extreme, if there are three in a row."""
    span = np.ptp(value, axis=0)
    near = np.minimum(np.abs(value - value.max(axis=0)), np.abs(value - value.min(axis=0))) < 1e-6 * span
    runs = near[2:] & near[1:-1] & near[:-2]
    found = np.zeros(value.shape, bool)
    for shift in range(3):
        found[shift : len(value) - 2 + shift] |= runs
    return np.any(found, axis=1)


__all__ = ["clipped", "without_clipped"]
