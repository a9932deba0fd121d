"""The text of a CSV file as header and cells, whatever its encoding, separator and decimal mark.

People's files open with comments (`#`, `%`, `//`), the last of which may be the header (`#timestamp [ns],w_x,...`);
they state units in a line below the header, and write a decimal comma where something else separates the cells.
"""

import csv
import io
import itertools
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike, existing
from jaxest.io import units
from jaxest.types import InputError

MARK = "# jaxest-log "
_COMMENTS = ("#", "%", "//")
_SEPARATORS = ",;\t|"
_WESTERN = "°²³µ·".encode("latin-1")  # what units need of the encoding of a Western spreadsheet
_MISSING = ("na", "n/a", "#n/a", "null", "none", "nil", "missing")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
_EUROPEAN = re.compile(r"(\d\d)\.(\d\d)\.(\d{4})[T ](\d\d:\d\d(?::\d\d(?:[.,]\d+)?)?)")
_DATE = re.compile(r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?) ?(Z|UTC|[+-]\d\d:?\d\d)?")


class Cells(NamedTuple):
    """A CSV file as text."""

    source: str
    meta: dict[str, Any] | None
    """What the first line says in jaxest's own layout, None in others."""
    header: tuple[str, ...]
    columns: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    """Line number of each row, counted from 1."""


def cells(path: PathLike) -> Cells:
    """Read a CSV file (comma, semicolon, tab, bar or blanks) as text.

    Args:
        path: the file, in UTF-8, UTF-16 with its mark, or Latin-1 if it needs no more of it than `°²³µ·`.

    Returns:
        Its columns; without a header they are called `0`, `1`, ..., and one without a name `column N`.

    Raises:
        InputError: no such file, not text, no rows, or a line with another number of cells than the header.
    """
    source, text = str(path), _text(existing(path))
    head = list(itertools.takewhile(lambda s: s.startswith(_COMMENTS) or not s.strip(), io.StringIO(text)))
    meta = _meta(source, head[0]) if head and head[0].startswith(MARK) else None
    body = text[sum(map(len, head)) :]
    separator = "," if meta is not None else _separator(body)
    rows, lines = _rows(source, body, separator, len(head))
    if separator != ",":
        rows = _decimal_points(rows)
    header, start = _header(rows, [line.strip().lstrip("#%/ ") for line in head], separator)
    for i, (row, line) in enumerate(zip(rows, lines, strict=True)):
        if len(row) == len(header) + 1 and not row[-1]:  # each line ends in a separator
            rows[i] = row[:-1]
        elif len(row) != len(header):
            raise InputError(f"{source}: line {line}: {len(row)} cells, expected {len(header)} as in the first line")
    if meta is None and len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise InputError(f"{source}: line {lines[0]}: column {twice!r} is there twice")
    if len(rows) == start:
        raise InputError(f"{source}: the file is empty: it has a header and no rows")
    return Cells(source, meta, header, tuple(zip(*rows[start:], strict=True)), tuple(lines[start:]))


def _text(path: Path) -> str:
    data = path.read_bytes()
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        if not {byte for byte in data if byte >= 0x80 or byte == 0} <= set(_WESTERN):
            raise InputError(f"{path}: byte {error.start} is not text; expected CSV in UTF-8") from error
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _meta(source: str, line: str) -> dict[str, Any]:
    try:
        meta = json.loads(line.removeprefix(MARK))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source}: line 1: what follows '{MARK.strip()}' is not JSON ({error})") from error
    if not isinstance(meta, dict) or not all(isinstance(entry, dict) for entry in meta.values()):
        raise InputError(f"{source}: line 1: expected one JSON object with an object for each stream")
    return meta


def _separator(body: str) -> str:
    first, _, second = body.partition("\n")
    best = max(_SEPARATORS, key=first.count)
    blanks = first.strip().count(" ") and second.partition("\n")[0].strip().count(" ")
    return " " if best not in first and blanks else best


def _rows(source: str, body: str, separator: str, skipped: int) -> tuple[list[list[str]], list[int]]:
    reader = csv.reader(io.StringIO(body), delimiter=separator, skipinitialspace=True)
    rows, lines = [], []
    try:
        for row in reader:
            if row:
                rows.append(row)
                lines.append(reader.line_num + skipped)
    except csv.Error as error:
        raise InputError(f"{source}: line {reader.line_num + skipped}: {error}") from error
    if not rows:
        raise InputError(f"{source}: the file is empty: it holds no rows")
    return rows, lines


def _decimal_points(rows: list[list[str]]) -> list[list[str]]:
    """Turn decimal commas into points, if the file writes no number with a point."""
    shown = [cell for row in rows[:100] for cell in row]
    pointed = any("." in cell and number(cell) is not None for cell in shown)
    if pointed or not any(_DECIMAL_COMMA.fullmatch(cell) for cell in shown):
        return rows
    return [[c.replace(",", ".") if _DECIMAL_COMMA.fullmatch(c) else c for c in row] for row in rows]


def _header(rows: list[list[str]], comments: list[str], separator: str) -> tuple[tuple[str, ...], int]:
    """Return the names of the columns and the first row of values."""
    if _holds_values(rows[0]):
        for line in reversed(comments):
            names = [cell.strip() for row in csv.reader([line], delimiter=separator, skipinitialspace=True)
                     for cell in row]  # fmt: skip
            if len(names) == len(rows[0]) > 1 and not _holds_values(names):
                return _named(names), 0
        return tuple(map(str, range(len(rows[0])))), 0
    names = [cell.strip() for cell in rows[0]]
    below = [cell.strip().strip("[]()") for cell in rows[1]] if len(rows) > 2 else []
    if len(below) == len(names) and any(below) and all(not cell or _is_unit(cell) for cell in below):
        return _named([f"{name} [{unit}]" if unit else name for name, unit in zip(names, below, strict=True)]), 2
    return _named(names), 1


def _named(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(name or f"column {i}" for i, name in enumerate(names))


def _holds_values(row: list[str]) -> bool:
    """Say whether a row is one of values; a frame's header may hold numbers, but nothing above its index."""
    return bool(row[0].strip()) and all(not c.strip() or number(c) is not None or _date(c) for c in row)


def _is_unit(text: str) -> bool:
    if number(text) is not None:
        return text == "1"
    try:
        units.lookup(text)
    except InputError:
        return text in ("-", "a.u.", "quaternion")
    return True


def number(text: str) -> float | None:
    """Read a cell as a number; NaN where it says that there is none (`NA`, `null`), None where it is something else."""
    try:
        return float(text)
    except ValueError:
        return float("nan") if text.strip().lower() in _MISSING else None


def dates(column: Sequence[str]) -> NDArray[np.datetime64] | None:
    """Read a column of dates with times, such as `2026-05-01 12:30:00.250+02:00` or `01.05.2026 12:30:00,250`.

    Args:
        column: the cells; blank ones are no time.

    Returns:
        (n,) datetime64[ns] in UTC, or None where a cell is something else.
    """
    found = [_date(cell) for cell in column]
    if not any(found) or any(match is None and cell.strip() for match, cell in zip(found, column, strict=True)):
        return None
    try:
        local = np.array([match[0] if match else "NaT" for match in found], "datetime64[ns]")
    except ValueError:  # the 31st of February
        return None
    minutes = [_offset(match[1]) if match else 0 for match in found]
    return local - np.array(minutes, "timedelta64[m]")


def _date(text: str) -> tuple[str, str] | None:
    """A date's local time as ISO 8601 has it, and its zone; None for what is no date with a time."""
    iso, dotted = _DATE.fullmatch(text.strip()), _EUROPEAN.fullmatch(text.strip())
    if dotted:
        day, month, year, clock = dotted.groups()
        return f"{year}-{month}-{day}T{clock.replace(',', '.')}", ""
    return (iso[1].replace(" ", "T"), iso[2] or "") if iso else None


def _offset(zone: str) -> int:
    """Minutes that a zone such as `+02:00` is ahead of UTC."""
    if zone in ("", "Z", "UTC"):
        return 0
    digits = zone[1:].replace(":", "")
    return (-1 if zone[0] == "-" else 1) * (60 * int(digits[:2]) + int(digits[2:]))
