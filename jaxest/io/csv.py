"""CSV files: other people's, with a header of column names, and our own.

Ours: a first line `# jaxest-log {JSON: stream -> unit, frame, dtype, shape, ...}`, then the header
`time,NAME/0,NAME/1,...` (`NAME` alone for a stream of one number, `NAME/0/1` for a matrix) and one line for each stamp
that any stream has. Cells of a stream that has no sample at that stamp are empty; NaN is written `nan`. Numbers are
written so that they read back bit for bit.
"""

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike, write_text
from jaxest.io.csv_cells import MARK, Cells, cells, dates, number
from jaxest.io.log import SensorLog, Stream, check
from jaxest.io.npz import meta_of, to_text
from jaxest.io.raw import Raw
from jaxest.types import InputError


def load(path: PathLike) -> tuple[Cells, Raw]:
    """Read a CSV file as text and as numbers.

    Args:
        path: the file.

    Returns:
        The text, and its columns as float64 with NaN where a cell is empty, or as datetime64. A column of neither is
        refused, one with a bad cell is broken; both only matter to whoever asks for them.

    Raises:
        InputError: as `cells`.
    """
    table = cells(path)
    arrays: dict[str, NDArray[Any]] = {}
    refused: dict[str, str] = {}
    broken: dict[str, str] = {}
    empty: dict[str, NDArray[np.bool_]] = {}
    for name, column in zip(table.header, table.columns, strict=True):
        blank = np.array([not cell or cell.isspace() for cell in column])
        values = _values(column, blank)
        if values is None:
            found = [number(cell) is not None for cell in column]
            row = next(i for i, n in enumerate(found) if not n and not blank[i])
            reason = f"line {table.lines[row]}, column {name!r}: {column[row]!r} is not a number"
            (broken if any(found) else refused)[name] = reason
        elif blank.all():
            refused[name] = f"column {name!r} is empty"
        else:
            arrays[name] = values
            if blank.any():
                empty[name] = blank
    return table, Raw(str(path), arrays, refused, broken, empty, "column")


def _values(column: Sequence[str], blank: NDArray[np.bool_]) -> NDArray[Any] | None:
    """Return a column as numbers or dates, or None where a cell is neither."""
    for parse in (float, number):  # the quick one first
        try:
            found = [np.nan if skip else parse(cell) for cell, skip in zip(column, blank, strict=True)]
        except ValueError:
            continue
        if None not in found:
            return np.array(found, np.float64)
    return dates(column)


def read_log(table: Cells) -> SensorLog:
    """Read a log in our own layout.

    Args:
        table: the file as text, with its first line.

    Returns:
        The log, checked.

    Raises:
        InputError: names the line and column of a bad cell, or what its first line lacks.
    """
    meta = table.meta or {}
    column, streams = 1, {}
    for name, entry in meta.items():
        place = f"{table.source}: line 1, stream {name!r}"
        try:
            shape, dtype = tuple(int(n) for n in entry.pop("shape")), np.dtype(entry.pop("dtype"))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{place}: shape and dtype are needed ({error!r})") from error
        count = int(np.prod(shape, dtype=int))
        if not count or table.header[0] != "time" or table.header[column : column + count] != _headings(name, shape):
            raise InputError(
                f"{place}: columns {column} to {column + count - 1} of the header are not {_headings(name, shape)}"
            )
        rows = [i for i, cell in enumerate(table.columns[column]) if cell]
        time = _exact(table, 0, rows, np.dtype(np.float64))
        value = np.stack([_exact(table, column + i, rows, dtype) for i in range(count)], axis=-1)
        unit, frame, names = entry.pop("unit", ""), entry.pop("frame", ""), tuple(entry.pop("names", ()))
        streams[name] = Stream(time, value.reshape((len(rows), *shape)), unit, frame, names, entry)
        column += count
    return check(SensorLog(streams, table.source))


def _exact(table: Cells, column: int, rows: Sequence[int], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Convert the cells of some rows to a dtype, without passing integers through floating point."""
    text = table.columns[column]
    parse = float if dtype.kind == "f" else int
    found = []
    for i in rows:
        try:
            found.append(parse(text[i]))
        except ValueError:
            raise InputError(
                f"{table.source}: line {table.lines[i]}, column {table.header[column]!r}: {text[i]!r} is not "
                f"{'a number' if dtype.kind == 'f' else f'an integer ({dtype})'}"
            ) from None
    try:
        return np.array(found, dtype)
    except OverflowError as error:
        raise InputError(f"{table.source}: column {table.header[column]!r}: {error} ({dtype})") from error


def _headings(name: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    return tuple("/".join([name, *map(str, index)]) for index in np.ndindex(*shape))


def _strings(values: NDArray[Any]) -> NDArray[np.str_]:
    """Write numbers so that `float` and a cast bring back the same bits."""
    if values.dtype.kind != "f":
        return (values.astype(np.uint8) if values.dtype == bool else values).astype(str)
    text = values.astype(str)
    wrong = (text.astype(np.float64).astype(values.dtype) != values) & np.isfinite(values)
    return np.where(wrong, values.astype(np.float64).astype(str), text)


def write_log(log: SensorLog, path: PathLike, overwrite: bool = False) -> None:
    """Write a log as CSV in the layout that the module describes.

    Args:
        log: a checked log.
        path: where it goes.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: a stream without columns, or the output exists or cannot be written.
    """
    stamps = np.unique(np.concatenate([item.time for item in log.streams.values()]))
    header, columns, meta = ["time"], [_strings(stamps)], {}
    for name, item in log.streams.items():
        if item.value.size == 0:
            raise InputError(f"{path}: stream {name!r} has no columns, which CSV cannot hold; write .npz")
        shape = item.value.shape[1:]
        meta[name] = meta_of(item, dtype=str(item.value.dtype), shape=list(shape))
        rows = np.searchsorted(stamps, item.time)
        header += _headings(name, shape)
        for values in item.value.reshape(len(rows), -1).T:
            text = _strings(values)
            column = np.full(len(stamps), "", text.dtype)
            column[rows] = text
            columns.append(column)
    first = MARK + to_text(meta, str(path)) + "\n"
    text_file = io.StringIO(newline="")
    text_file.write(first)
    writer = csv.writer(text_file, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(zip(*(column.tolist() for column in columns), strict=True))
    write_text(path, text_file.getvalue(), overwrite)
