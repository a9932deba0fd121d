"""The streams that a `[columns]` table names, read from a file's arrays."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.io import units
from jaxest.io.columns import Column, ColumnTable, Number, parse
from jaxest.io.log import SensorLog, Stream
from jaxest.io.raw import Raw, pick
from jaxest.types import InputError


def apply(raw: Raw, table: ColumnTable | Mapping[str, Any]) -> SensorLog:
    """Read the streams that a table names.

    Args:
        raw: the file.
        table: a `ColumnTable`, or the config's dict.

    Returns:
        The log in SI units, not checked yet.

    Raises:
        InputError: an array, column or unit does not exist (closest one named), or lengths do not fit.
    """
    if not isinstance(table, ColumnTable):
        table = parse(table, f"{raw.source}: columns")
    streams = {}
    for name, column in table.streams.items():
        own = column.time is not None or column.rate is not None
        merged = column if own else column._replace(time=table.time, rate=table.rate)
        merged = merged._replace(
            time_unit=column.time_unit or table.time_unit or "s",
            start=column.start if column.start is not None else table.start,
        )
        streams[name] = _stream(raw, name, merged)
    return SensorLog(streams, raw.source)


def _stream(raw: Raw, name: str, column: Column) -> Stream:
    place = f"{raw.source}: columns.{name}"
    value, blank = _value(raw, column, place)
    time, absent = _time(raw, column, len(value), place)
    if (blank | absent).any():  # a CSV line without cells for this stream is no sample of it
        value, time = value[~(blank | absent)], time[~(blank | absent)]
    unit = column.unit or units.default_unit(name)
    try:
        entry = units.for_stream(name, unit) if unit else units.Unit("")
    except InputError as error:
        raise InputError(f"{place}.unit: {error}") from error
    value = units.convert(_affine(value, column, place), entry)
    if column.order == "xyzw":
        if value.shape[1:] != (4,):
            raise InputError(f"{place}.order: is for quaternions (n, 4), this stream has shape {value.shape}")
        value = value[:, [3, 0, 1, 2]]
    return Stream(time, value, entry.si, column.frame, column.names)


def _value(raw: Raw, column: Column, place: str) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return the raw values and which rows are empty."""
    if column.array:
        value = pick(raw, column.array)
        value = value.T if column.transposed else value
        if value.ndim == 0:
            raise InputError(f"{place}: {raw.word} {column.array!r} is one number, expected one row for each sample")
        blank = raw.empty.get(column.array, np.zeros(len(value), bool))
        return _numeric(_columns(value, column, place) if column.columns else value, place), blank
    names = [_called(raw, c, place) for c in column.columns]
    parts = [_numeric(pick(raw, name), place) for name in names]
    shapes = {part.shape for part in parts}
    if len(shapes) > 1 or parts[0].ndim != 1:
        raise InputError(f"{place}: {names} have shapes {[p.shape for p in parts]}, expected equal (n,)")
    blank = np.logical_and.reduce([raw.empty.get(name, np.zeros(len(parts[0]), bool)) for name in names])
    return np.stack(parts, axis=-1), blank


def _columns(value: NDArray[Any], column: Column, place: str) -> NDArray[Any]:
    if value.ndim != 2 or any(isinstance(c, str) for c in column.columns):
        raise InputError(
            f"{place}.columns: got {list(column.columns)} of an array of shape {value.shape}, expected column numbers "
            "of an (n, m) array"
        )
    return value[:, [_index(int(c), value.shape[1], place) for c in column.columns]]


def _called(raw: Raw, column: int | str, place: str) -> str:
    """Return the name of a column that is given by its name or its number in the file."""
    return list(raw.arrays)[_index(column, len(raw.arrays), place)] if isinstance(column, int) else column


def _index(number: int, count: int, place: str) -> int:
    if not 0 <= number < count:
        raise InputError(f"{place}: there is no column {number}, expected 0 to {count - 1}")
    return number


def _numeric(value: NDArray[Any], place: str) -> NDArray[Any]:
    if value.dtype.kind not in "biuf":
        raise InputError(f"{place}: values are of dtype {value.dtype}, expected numbers")
    return value


def _affine(value: NDArray[Any], column: Column, place: str) -> NDArray[Any]:
    if column.scale == 1 and column.offset == 0:
        return value
    for key, entry in (("scale", column.scale), ("offset", column.offset)):
        if np.shape(entry) not in ((), value.shape[1:]):
            raise InputError(f"{place}.{key}: {np.size(entry)} numbers for values of shape {value.shape}")
    dtype = value.dtype if value.dtype.kind == "f" else np.dtype(np.float64)
    return (value.astype(np.float64) * np.asarray(column.scale) + np.asarray(column.offset)).astype(dtype)


def _time(raw: Raw, column: Column, n: int, place: str) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the stamps in seconds, and where a CSV has none."""
    here = np.zeros(n, bool)
    if column.time is None:
        if column.rate is None:
            raise InputError(f"{place}: needs `time` (stamps) or `rate` (Hz)")
        return float(column.start or 0) + np.arange(n) / rate_of(raw, column.rate, place), here
    if isinstance(column.time, int) and column.array:
        source = _columns(pick(raw, column.array), column._replace(columns=(column.time,)), place)[:, 0]
    else:
        name = _called(raw, column.time, place)
        source, here = pick(raw, name), raw.empty.get(name, here)
    if source.size != n or source.shape[:1] not in ((n,), (1,)):
        raise InputError(f"{place}: {n} rows, but its stamps {column.time!r} have shape {source.shape}")
    try:
        return units.seconds(source.reshape(n), column.time_unit), here
    except InputError as error:
        raise InputError(f"{place}.time_unit: {error}") from error


def rate_of(raw: Raw, rate: Number | str, place: str) -> float:
    """Return a sampling rate in Hz, given as a number or by the name of a scalar.

    Args:
        raw: the file.
        rate: the number or name.
        place: for error messages.

    Returns:
        The rate (Hz).

    Raises:
        InputError: no such scalar, several numbers, or not positive.
    """
    value = np.asarray(pick(raw, rate) if isinstance(rate, str) else rate)
    if value.size != 1 or value.dtype.kind not in "iuf":
        raise InputError(f"{place}.rate: {rate!r} has shape {value.shape} and dtype {value.dtype}, expected one number")
    hertz = float(value.reshape(()))
    if not (np.isfinite(hertz) and hertz > 0):
        raise InputError(f"{place}.rate: {rate!r} is {hertz}, expected a positive number of Hz")
    return hertz
