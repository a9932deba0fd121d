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
