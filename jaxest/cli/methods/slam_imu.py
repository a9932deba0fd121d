"""What an IMU on a free root says between two scans of a log."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxest.io import SensorLog
from jaxest.io.log import stream, where
from jaxest.types import InputError, Reading


def driven(log: SensorLog, settings: Mapping[str, Any], given: Any) -> Any:
    """Put a log's IMU beside what else a robot with a free root measures.

    Args:
        log: in SI units; streams `gyroscope` and `accelerometer` (n, 3), or those that the config names.
        settings: the config's table `[slam]`.
        given: `slam.Free`, a step for each row of the ranges.

    Returns:
        `slam_inertial.Driven`: each sample belongs to the first scan that is not earlier.

    Raises:
        InputError: no such stream, other than three columns, or no sample between two scans.
    """
    from jaxest.systems.slam_inertial import Driven

    scans = stream(log, settings.get("ranges", "ranges")).time
    spot, names = where(log), [settings.get(f"{n}_stream", n) for n in ("gyroscope", "accelerometer")]
    items = [stream(log, name) for name in names]
    for name, item in zip(names, items, strict=True):
        if np.asarray(item.value).reshape(len(item.time), -1).shape[1] != 3:
            raise InputError(f"{spot}stream {name!r} has {np.shape(item.value)[1:]} columns, expected three")
    time = items[0].time
    step = np.searchsorted(scans, time)
    between = (step > 0) & (step < len(scans))
    spacing = np.diff(time, prepend=time[:1])
    rank = np.arange(len(time)) - np.searchsorted(step, step)
    most = int(rank[between].max(initial=0)) + 1
    at = (step[between], rank[between])
    read: list[Any] = []
    for name, item in zip(names, items, strict=True):
        value = np.asarray(item.value, float).reshape(len(item.time), 3)
        value = np.stack([np.interp(time, item.time, column, np.nan, np.nan) for column in value.T], axis=1)
        table = np.zeros((len(scans), most, 3), np.float32)
        there = np.ones((len(scans), most), bool)
        finite = np.isfinite(value).all(axis=1)
        if not finite[between].any():
            raise InputError(
                f"{spot}stream {name!r}: covers {item.time[0]:.3f} to {item.time[-1]:.3f} s and has no sample between "
                f"two scans, expected some within the ranges' {scans[0]:.3f} to {scans[-1]:.3f} s"
            )
        table[at], there[at] = np.where(finite[:, None], value, 0)[between], finite[between]
        read.append(Reading(table, there))  # type: ignore[arg-type]
    spaced: Any = np.zeros((len(scans), most), np.float32)
    spaced[at] = spacing[between]
    return Driven(given.ranges, given.joints, read[0], read[1], spaced, given.dt)


__all__ = ["driven"]
