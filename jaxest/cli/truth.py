"""A truth at an estimate's times."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.io import SensorLog, Stream, interpolate
from jaxest.io.log import stream, where
from jaxest.stamps import apart, longest
from jaxest.types import InputError

UNIT_LENGTH = 0.02  # what a recorded unit quaternion may be off


def at(
    log: SensorLog, name: str, movement: Stream | None, time: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_] | None]:
    """Bring a true orientation to the times of an estimate.

    Args:
        log: the log that holds it.
        name: its stream.
        movement: () bool stream of the samples that count, if there is one.
        time: (T,) s.

    Returns:
        (T, 4) quaternions, as they are where the stamps coincide and interpolated elsewhere, NaN where the truth is
        unknown or more than a gap away; and (T,) bool, or None without `movement`.

    Raises:
        InputError: no such stream, or it holds none of the times.
    """
    item = stream(log, name)
    refuse_other_times(f"{where(log)}stream {name!r}", item, time)
    streams = {"orientation": item} | ({} if movement is None else {"movement": movement._replace(unit="1")})
    found = interpolate(SensorLog(streams, log.source), None, time, max_gap=longest(item.time), nan="invalid").readings
    value, valid = found["orientation"]
    truth = np.where(np.asarray(valid)[:, None], np.asarray(value, np.float64), np.nan)
    return truth, _flags(found.get("movement"))


def refuse_other_times(place: str, item: Stream, time: NDArray[np.float64]) -> None:
    """Refuse a stream that begins after an estimate has ended, or ends before it begins.

    Args:
        place: where the stream stands, for the message.
        item: the stream.
        time: (T,) s, of the estimate.

    Raises:
        InputError: says which times both cover.
    """
    if item.time[-1] < time[0] or item.time[0] > time[-1]:
        raise InputError(
            f"{place} covers {item.time[0]:.3f} to {item.time[-1]:.3f} s, the estimate {time[0]:.3f} to "
            f"{time[-1]:.3f} s; expected times in common"
        )


def joints(
    item: Stream, columns: Mapping[int, int], angles: Sequence[bool] | NDArray[np.bool_], time: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Bring true joint coordinates to the times of an estimate.

    Args:
        item: the stream that holds them.
        columns: its column, by number of the coordinate.
        angles: (c,) which coordinates are angles; a jump of a whole turn is none.
        time: (T,) s.

    Returns:
        (T, c), interpolated; NaN where the truth is unknown or more than a gap away.
    """
    value = np.asarray(item.value, np.float64).reshape(len(item.time), -1)
    gap = longest(item.time)
    found = np.full((len(time), len(angles)), np.nan)
    for at, column in columns.items():
        there = np.isfinite(value[:, column])
        if not there.any():
            continue
        known, series = item.time[there], value[there, column]
        series = np.unwrap(series) if angles[at] else series
        near = apart(known, time) <= gap
        found[near, at] = np.interp(time[near], known, series)
    return found


def _flags(reading: Any) -> NDArray[np.bool_] | None:
    return None if reading is None else (np.asarray(reading.value) != 0) & np.asarray(reading.valid)


def refuse_odd(log: SensorLog, name: str) -> None:
    """Refuse quaternions that are not of unit length, and a covariance beside them that does not fit.

    Args:
        log: the log.
        name: the stream `orientation`; its covariance is `NAME_covariance`, if there is one.

    Raises:
        InputError: names the stream, the row, what was found and what was expected.
    """
    value = stream(log, name).value.astype(np.float64)
    length = np.linalg.norm(value, axis=-1)
    off = np.abs(length - 1) > UNIT_LENGTH  # False where NaN
    if off.any():
        row = int(np.argmax(off))
        raise InputError(
            f"{where(log)}stream {name!r}: row {row} has length {length[row]:.4g}, expected unit quaternions (wxyz)"
        )
    covariance = log.streams.get(f"{name}_covariance")
    if covariance is not None and covariance.value.shape != (len(value), 3, 3):
        raise InputError(
            f"{where(log)}stream {name + '_covariance'!r}: shape {covariance.value.shape}, expected "
            f"{(len(value), 3, 3)}, one for each row of {name!r}"
        )


def find(log: SensorLog, name: str) -> str:
    """Find the orientation of a log.

    Args:
        log: the log.
        name: the stream that was asked for; empty for the only one there is.

    Returns:
        The stream's name.

    Raises:
        InputError: there is none or there are several, which are named.
    """
    if name:
        stream(log, name)
        return name
    found = [key for key, item in log.streams.items() if key.rsplit("/", 1)[-1] == "orientation"]
    if len(found) == 1:
        return found[0]
    if "orientation" in found:
        return "orientation"
    if not found:
        stream(log, "orientation")
    raise InputError(f"{where(log)}there are several orientations: {', '.join(found)}; name one with --stream")
