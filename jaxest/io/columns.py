"""The `[columns]` table: which array or column of somebody else's file is which stream, in which unit.

```toml
[columns]
time = "t"            # stamps of every stream that names none of its own
time_unit = "us"      # s by default
# rate = 285.714      # without stamps; Hz, or the name of a scalar such as "fs"; `start` (s) is the first, 0 by default

[columns."imu0/gyroscope"]
array = "imu0"        # an array of the file
columns = [2, 3, 4]   # of its columns; or without `array` the names (or numbers) of columns of a CSV
time = 0              # a column of that array, or an array's name
unit = "deg/s"        # converted to SI: unit factor * (scale * raw + offset)
scale = 1.0           # a number, or one for each column
offset = 0.0
frame = "imu0"
names = ["x", "y", "z"]
order = "xyzw"        # orientation only: how the file orders a quaternion, wxyz by default
transposed = true     # the array has a column for each sample, not a row
```
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from jaxest.io import units
from jaxest.io.log import SensorLog, Stream
from jaxest.io.raw import Raw, pick
from jaxest.types import InputError, unknown_name

Number = int | float
_ORDERS = ("wxyz", "xyzw")


class Column(NamedTuple):
    """Where one stream comes from; the module's docstring explains the fields."""

    array: str = ""
    columns: tuple[int | str, ...] = ()
    unit: str = ""
    frame: str = ""
    scale: Number | tuple[Number, ...] = 1.0
    offset: Number | tuple[Number, ...] = 0.0
    time: str | int | None = None
    time_unit: str = ""
    rate: Number | str | None = None
    start: Number | None = None
    names: tuple[str, ...] = ()
    order: str = ""
    transposed: bool = False


class ColumnTable(NamedTuple):
    """Streams by name, and what holds for all of them."""

    streams: dict[str, Column]
    time: str | int | None = None
    time_unit: str = ""
    rate: Number | str | None = None
    start: Number | None = None


_COMMON = tuple(name for name in ColumnTable._fields if name != "streams")


def parse(data: Mapping[str, Any], place: str = "columns") -> ColumnTable:
    """Turn the `[columns]` table of a config into a `ColumnTable`.

    Args:
        data: the table as `tomllib` reads it.
        place: where it stands, for error messages.

    Returns:
        The table.

    Raises:
        InputError: an unknown key (closest one named), a value of the wrong type, or both stamps and a rate.
    """
    common = {key: _typed(f"{place}.{key}", ColumnTable, key, data[key]) for key in _COMMON if key in data}
    _one_clock(place, common)
    streams: dict[str, Column] = {}
    for name, entry in data.items():
        if name in common:
            continue
        if not isinstance(entry, Mapping):
            raise InputError(f"{place}: {unknown_name('key', name, _COMMON)}; a stream is a table, [columns.NAME]")
        streams[name] = _parse_column(entry, f"{place}.{name}")
    if not streams:
        raise InputError(f"{place}: holds no stream; expected tables such as [columns.gyroscope]")
    return ColumnTable(streams, **common)


def _parse_column(entry: Mapping[str, Any], place: str) -> Column:
    for key in entry:
        if key not in Column._fields:
            raise InputError(f"{place}: {unknown_name('key', key, Column._fields)}")
    column = Column(**{key: _typed(f"{place}.{key}", Column, key, value) for key, value in entry.items()})
    if not column.array and not column.columns:
        raise InputError(f"{place}: needs `array` or `columns`")
    _one_clock(place, entry)
    if column.order not in ("", *_ORDERS):
        raise InputError(f"{place}.order: got {column.order!r}, expected one of {_ORDERS}")
    return column


def _one_clock(place: str, given: Mapping[str, Any]) -> None:
    if "time" not in given:
        return
    for key in ("rate", "start"):
        if key in given:
            raise InputError(f"{place}: got both time and {key}, expected stamps (time) or a rate (with its start)")


def _typed(place: str, owner: type[Column] | type[ColumnTable], key: str, value: Any) -> Any:
    """Check a value against the field's annotation; lists become tuples."""
    wanted = owner.__annotations__[key]
    options = get_args(wanted) if not hasattr(wanted, "__origin__") and get_args(wanted) else (wanted,)
    for option in options:
        inner = get_args(option)
        if inner and isinstance(value, list | tuple):
            if all(isinstance(v, inner[0]) and not isinstance(v, bool) for v in value):
                return tuple(value)
        elif inner or not isinstance(option, type):
            continue
        elif isinstance(value, option) and isinstance(value, bool) == (option is bool):
            return value
    raise InputError(f"{place}: got {value!r}, expected {wanted.__name__ if isinstance(wanted, type) else wanted}")


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
        return (
            (_numeric(_columns(value, column, place), place), blank)
            if column.columns
            else (_numeric(value, place), blank)
        )
    names = [list(raw.arrays)[_index(c, len(raw.arrays), place)] if isinstance(c, int) else c for c in column.columns]
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
        name = (
            list(raw.arrays)[_index(column.time, len(raw.arrays), place)]
            if isinstance(column.time, int)
            else column.time
        )
        source, here = pick(raw, name), raw.empty.get(name, here)
    if source.size != n or source.shape[:1] not in ((n,), (1,)):
        raise InputError(f"{place}: {n} rows, but its stamps {column.time!r} have shape {source.shape}")
    try:
        return seconds(source.reshape(n), column.time_unit), here
    except InputError as error:
        raise InputError(f"{place}.time_unit: {error}") from error


def seconds(stamps: NDArray[Any], unit: str) -> NDArray[np.float64]:
    """Convert stamps to float64 seconds.

    Integers are split into whole seconds and rest, as nanoseconds since 1970 do not fit in a float64.

    Args:
        stamps: (n,) numbers or datetime64.
        unit: unit of time that numbers are in.

    Returns:
        (n,) s.

    Raises:
        InputError: not a unit of time, or not numbers.
    """
    entry = units.lookup(unit)
    if entry.si != "s":
        raise InputError(f"{unit!r} is no unit of time; expected s, ms, us or ns")
    if stamps.dtype.kind == "M":
        known, whole = ~np.isnat(stamps), seconds(stamps.astype("datetime64[ns]").astype(np.int64), "ns")
        return np.where(known, whole, np.nan)
    if stamps.dtype.kind in "iu" and entry.factor < 1:
        per_second = round(1 / entry.factor)
        whole, rest = np.divmod(stamps, per_second)
        return whole.astype(np.float64) + rest.astype(np.float64) / per_second
    if stamps.dtype.kind not in "iuf":
        raise InputError(f"stamps are of dtype {stamps.dtype}, expected numbers")
    return stamps.astype(np.float64) * entry.factor


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
