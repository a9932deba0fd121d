"""What a log is: named streams of stamped values, and the one check that every log passes."""

import re
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.io import units
from jaxest.types import InputError, unknown_name


class Stream(NamedTuple):
    """One sensor's samples, in time order."""

    time: NDArray[np.float64]
    """(n,) s, strictly increasing."""
    value: NDArray[Any]
    """(n, ...) in `unit`; bool, integer, float32 or float64; NaN where the sensor had nothing to say."""
    unit: str = ""
    """SI unit such as `rad/s`; `1` for a number without unit (quaternions), empty where nobody knows."""
    frame: str = ""
    """Name of the frame that the values are expressed in; empty where nobody knows."""
    names: tuple[str, ...] = ()
    """Name of each column, for example of each joint; empty where there are none."""
    extra: Mapping[str, Any] = {}
    """Further metadata that JSON can hold; kept as it is."""


class SensorLog(NamedTuple):
    """Streams by name. Several sensors of a kind are told apart by a prefix: `imu0/gyroscope`, `imu1/gyroscope`."""

    streams: dict[str, Stream]
    source: str = ""
    """Where the log came from, for error messages."""
    notes: tuple[str, ...] = ()
    """What was assumed while reading it, one sentence each."""


def stream(log: SensorLog, name: str) -> Stream:
    """Return the stream of that name.

    Args:
        log: the log.
        name: the stream's name.

    Returns:
        The stream.

    Raises:
        InputError: there is none; the message names the closest ones.
    """
    if name not in log.streams:
        raise InputError(f"{where(log)}{unknown_name('stream', name, log.streams)}")
    return log.streams[name]


def where(log: SensorLog) -> str:
    """Return the beginning of an error message about this log, `"FILE: "` or nothing."""
    return f"{log.source}: " if log.source else ""


def check(log: SensorLog, nan: Literal["missing", "error"] = "missing") -> SensorLog:
    """Check a log on the host, before anything is computed from it.

    Names, shapes and dtypes must be right, stamps finite and strictly increasing. A value that is not finite means
    a missing sample: it stays in the log, and each consumer decides (`ticks(..., nan="invalid")` masks it).

    Args:
        log: the log.
        nan: `"missing"` lets values that are not finite pass, `"error"` refuses them.

    Returns:
        The same log.

    Raises:
        InputError: names the stream, the row and its time, what was found and what was expected.
    """
    if nan not in ("missing", "error"):
        raise ValueError(f"nan: got {nan!r}, expected 'missing' or 'error'")
    if not log.streams:
        raise InputError(f"{where(log)}the log is empty: it holds no stream")
    for name, item in log.streams.items():
        place = f"{where(log)}stream {name!r}"
        _check_name(name, place)
        _check_shape(name, item, place)
        _check_time(item.time, place)
        if nan == "error":
            refuse_nan(item, place)
    return log


def _check_name(name: str, place: str) -> None:
    parts = name.split("/")
    if any(part in ("", ".", "..") for part in parts) or "\\" in name or re.search(r"[\x00-\x1f\x7f]", name):
        raise InputError(f"{place}: not a usable name; expected words joined by '/', for example 'imu0/gyroscope'")


def _check_shape(name: str, item: Stream, place: str) -> None:
    time, value = item.time, item.value
    if not isinstance(time, np.ndarray) or not isinstance(value, np.ndarray):
        raise InputError(f"{place}: time and value must be NumPy arrays, got {type(time).__name__} and "
                         f"{type(value).__name__}")  # fmt: skip
    if time.dtype != np.float64 or time.ndim != 1:
        raise InputError(f"{place}: time is {time.dtype} {time.shape}, expected float64 (n,)")
    if value.dtype.kind not in "biuf" or value.dtype.itemsize > 8:
        raise InputError(f"{place}: value is of dtype {value.dtype}, expected bool, integer, float32 or float64")
    if value.ndim == 0 or len(value) != len(time):
        raise InputError(f"{place}: value has shape {value.shape} and time {time.shape}, expected equal lengths")
    if len(time) == 0:
        raise InputError(f"{place} is empty: it has no rows")
    expected = units.shape_of(name)
    if expected is not None and value.shape[1:] != expected:
        turned = "; is it transposed?" if value.shape[:-1] == expected else ""
        raise InputError(f"{place}: value has shape {value.shape}, expected (n, {expected[0]}){turned}")
    columns = value.shape[1] if value.ndim > 1 else 1
    if item.names and len(item.names) != columns:
        raise InputError(f"{place}: {len(item.names)} names for {columns} columns")


def _check_time(time: NDArray[np.float64], place: str) -> None:
    bad = ~np.isfinite(time)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(f"{place}: the stamp of row {row} is {time[row]}, expected a finite time in seconds")
    back = np.diff(time) <= 0
    if back.any():
        row = int(np.argmax(back)) + 1
        kind = "a duplicate of" if time[row] == time[row - 1] else "earlier than"
        more = int(back.sum()) - 1
        rest = f" ({more} more like it)" if more else ""
        raise InputError(
            f"{place}: the stamp of row {row}, {time[row]:.9f} s, is {kind} row {row - 1}'s {time[row - 1]:.9f} s"
            f"{rest}; expected strictly increasing stamps: leave such rows out, or say rate = ... (Hz) in place of "
            "time in [columns]"
        )


def finite_rows(value: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which rows are finite in every column.

    Args:
        value: (n, ...).

    Returns:
        (n,) bool.
    """
    if value.dtype.kind != "f":
        return np.ones(len(value), bool)
    return np.isfinite(value).all(axis=tuple(range(1, value.ndim)))


def refuse_nan(item: Stream, place: str, remedy: str = "pass nan='invalid'") -> None:
    """Refuse a stream that holds values that are not finite.

    Args:
        item: the stream.
        place: where it stands, for the message.
        remedy: how to have such rows taken as missing.

    Raises:
        InputError: names the first such row and its time.
    """
    bad = ~finite_rows(item.value)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            f"{place}: row {row} at {item.time[row]:.6f} s is not finite: {item.value[row]} ({int(bad.sum())} of "
            f"{len(bad)} rows); expected numbers, or {remedy} to take such rows as missing"
        )


def to_si(log: SensorLog) -> SensorLog:
    """Convert streams that state another known unit to SI; others stay as they are.

    Args:
        log: a log, for example one in jaxest's own layout that says `deg/s`.

    Returns:
        The log in SI units.

    Raises:
        InputError: a stream states a unit of another quantity, such as an angle for a gyroscope.
    """
    streams = {}
    for name, item in log.streams.items():
        try:
            unit = units.for_stream(name, item.unit) if item.unit in units.UNITS else units.Unit(item.unit)
        except InputError as error:
            raise InputError(f"{where(log)}stream {name!r}: {error}") from error
        streams[name] = item._replace(value=units.convert(item.value, unit), unit=unit.si)
    return log._replace(streams=streams)
