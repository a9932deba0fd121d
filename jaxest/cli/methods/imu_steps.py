"""The streams of one or several IMUs as one sequence of steps, with a rate of each gyroscope on every step."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxest.io import SensorLog, Stream, ticks
from jaxest.io.align import Steps
from jaxest.io.log import refuse_nan, stream, where
from jaxest.types import Reading

KINDS = ("gyroscope", "accelerometer", "magnetometer")
HOLD = 1.5
"""Median intervals of a gyroscope for which its last reading stands in at a step of other sensors."""
MISSING = 0.1
"""Share of steps without a gyroscope's rate above which that is told."""


def merged(log: SensorLog, prefixes: Sequence[str], kinds: Sequence[str], nan: str) -> Steps:
    """Merge the streams; a gyroscope's last reading stands in where only other sensors have one.

    Args:
        log: the log, in SI units.
        prefixes: of the IMUs' streams: `hand/`, or nothing.
        kinds: of `KINDS`, the gyroscope among them.
        nan: `error`, or `missing`.

    Returns:
        The steps, in float32.

    Raises:
        InputError: a stream is missing, or holds NaN that the config does not allow.
    """
    names = [prefix + kind for prefix in prefixes for kind in kinds]
    if nan == "error":
        for name in names:
            refuse_nan(stream(log, name), f"{where(log)}stream {name!r}", 'nan = "missing" in a config')
    gyros = {prefix + KINDS[0]: stream(log, prefix + KINDS[0]) for prefix in prefixes}
    fastest = max(gyros.values(), key=lambda item: len(item.time))
    steps = ticks(log, names, tolerance=_interval(fastest) / 2, dtype=np.float32, nan="invalid")
    held = {name: _held(steps, name, HOLD * _interval(item)) for name, item in gyros.items()}
    return steps._replace(readings={**steps.readings, **held})


def rateless(steps: Steps, prefixes: Sequence[str]) -> list[str]:
    """Say of which IMUs too many of the steps that `merged` gave have no rate."""
    share = {prefix: float(np.mean(~np.asarray(steps.readings[prefix + KINDS[0]].valid))) for prefix in prefixes}
    return [
        f"{100 * lacks:.0f} % of the steps have no angular rate of {prefix}{KINDS[0]}, more than {100 * MISSING:.0f} %"
        for prefix, lacks in share.items() if lacks > MISSING
    ]  # fmt: skip


def _interval(item: Stream) -> float:
    return float(np.median(np.diff(item.time))) if len(item.time) > 1 else 0.0


def _held(steps: Steps, name: str, longest: float) -> Reading:
    value, valid = steps.readings[name]
    last = np.maximum.accumulate(np.where(valid, np.arange(len(steps.time)), -1))
    near = (last >= 0) & (steps.time - steps.time[last] <= longest)
    held: Any = np.where(near[:, None], value[last], value), near
    return Reading(*held)


__all__ = ["HOLD", "KINDS", "MISSING", "merged", "rateless"]
