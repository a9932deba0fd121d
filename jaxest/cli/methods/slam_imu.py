"""What an IMU on a free root says between two scans of a log."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.io import SensorLog, interpolate
from jaxest.io.log import stream, where
from jaxest.stamps import longest
from jaxest.types import InputError, Reading


def driven(log: SensorLog, settings: Mapping[str, Any], given: Any) -> Any:
    """Put a log's IMU beside what else a robot with a free root measures.

    Args:
        log: in SI units; streams `gyroscope` and `accelerometer` (n, 3), or those that the config names.
        settings: the config's table `[slam]`.
        given: `slam.Free`, a step for each row of the ranges.

    Returns:
        `slam_inertial.Driven`: each sample belongs to the first scan that is not earlier. Those of a scan are missing
        where a gap lies between it and the scan before: they say nothing of the way over the gap.

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
    blind, spacing = _gaps(time, scans, step)
    rank = np.arange(len(time)) - np.searchsorted(step, step)
    most = int(rank[between].max(initial=0)) + 1
    at = (step[between], rank[between])
    read: list[Any] = []
    for name, item in zip(names, items, strict=True):
        one = SensorLog({name: item})
        value, valid = interpolate(one, None, time, max_gap=longest(item.time), nan="invalid").readings[name]
        table = np.zeros((len(scans), most, 3), np.float32)
        there = np.ones((len(scans), most), bool)
        if not np.asarray(valid)[between].any():
            raise InputError(
                f"{spot}stream {name!r}: covers {item.time[0]:.3f} to {item.time[-1]:.3f} s and has no sample between "
                f"two scans, expected some within the ranges' {scans[0]:.3f} to {scans[-1]:.3f} s"
            )
        table[at], there[at] = np.asarray(value)[between], np.asarray(valid)[between] & ~blind[at[0]]
        read.append(Reading(table, there))  # type: ignore[arg-type]
    spaced: Any = np.zeros((len(scans), most), np.float32)
    spaced[at] = spacing[between]
    return Driven(given.ranges, given.joints, read[0], read[1], spaced, given.dt)


def _gaps(
    time: NDArray[np.float64], scans: NDArray[np.float64], step: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Find the scans (T,) that an IMU does not lead to without a gap.

    Args:
        time: (n,) s, of samples.
        scans: (T,) s.
        step: (n,) the scan that each sample belongs to; T of those after the last one.

    Returns:
        (T,) whether there is a gap since the scan before, and (n,) s since the sample before, or the scan before the
        first sample.
    """
    gap = longest(time)
    spacing = np.diff(time, prepend=scans[max(int(step[0]) - 1, 0)])
    blind = scans - time[np.maximum(np.searchsorted(time, scans, side="right") - 1, 0)] > gap
    after = step[spacing > gap]
    blind[after[after < len(scans)]] = True
    return blind, spacing


__all__ = ["driven"]
