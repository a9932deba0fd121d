"""Which file suffix is read and written by what; a further format is one row in `FORMATS`."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jaxest.io import columns as table_module
from jaxest.io import csv, npz, proposal
from jaxest.io.columns import ColumnTable
from jaxest.io.files import PathLike, existing
from jaxest.io.log import SensorLog, check
from jaxest.io.proposal import Proposal
from jaxest.io.raw import Raw
from jaxest.io.table_text import to_toml
from jaxest.types import InputError


class Format(NamedTuple):
    """One kind of file."""

    load: Callable[[PathLike], tuple[Raw, Callable[[], SensorLog] | None]]
    """Reads the arrays, and returns how to read the log where the file is in our own layout."""
    write: Callable[[SensorLog, PathLike, bool], None]


def _load_npz(path: PathLike) -> tuple[Raw, Callable[[], SensorLog] | None]:
    raw = npz.load(path)
    return raw, (lambda: npz.read_log(raw)) if npz.is_log(raw) else None


def _load_csv(path: PathLike) -> tuple[Raw, Callable[[], SensorLog] | None]:
    cells, raw = csv.load(path)
    return raw, (lambda: csv.read_log(cells)) if cells.meta is not None else None


FORMATS = {".npz": Format(_load_npz, npz.write_log), ".csv": Format(_load_csv, csv.write_log)}


def _format(path: PathLike) -> Format:
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise InputError(
            f"{path}: logs are read and written as {' or '.join(FORMATS)}, not {suffix or 'without suffix'}"
        )
    return FORMATS[suffix]


def read(path: PathLike, columns: ColumnTable | Mapping[str, Any] | None = None) -> SensorLog:
    """Read a log.

    A file in our own layout is recognised. Other people's files are read through a column table; without one,
    through the table that `propose` guesses, if the file settles everything that matters.

    Args:
        path: an `.npz` or `.csv` file.
        columns: the `[columns]` table of a config, as a dict or parsed; for a file in another layout. A file in our
            own layout needs none, and one that names nothing in it is passed over.

    Returns:
        The log, checked: float64 stamps in seconds, SI units (a log in our own layout keeps the unit it states).
        What was assumed is in its `notes`. NaN stays, as missing samples.

    Raises:
        InputError: no such file, unreadable, bad stamps or shapes, unknown array or unit; and for a layout that
            leaves something open, the lines to paste into a config.
    """
    existing(path)
    raw, own = _format(path).load(path)
    table = _table(path, columns)
    if table is not None and (own is None or _speaks_of(table, raw)):
        return check(table_module.apply(raw, table))
    if own is not None:
        return own()
    guess = proposal.guess(raw)
    if guess.unsure:
        raise InputError(
            f"{path}: not in jaxest's own layout, and its names leave something open: {'; '.join(guess.unsure)}. "
            f"Put the right lines into a config:\n{to_toml(guess)}"
        )
    log = table_module.apply(raw, guess.table)
    return check(log._replace(notes=guess.assumed))


def _table(path: PathLike, columns: ColumnTable | Mapping[str, Any] | None) -> ColumnTable | None:
    if columns is None or isinstance(columns, ColumnTable):
        return columns
    return table_module.parse(columns, f"{path}: columns")


def _speaks_of(table: ColumnTable, raw: Raw) -> bool:
    """Say whether a table names anything that is in the file; one config may serve a foreign log and our estimate."""
    return any(name in raw.arrays for c in table.streams.values() for name in (c.array, *c.columns))


def write(log: SensorLog, path: PathLike, overwrite: bool = False) -> None:
    """Write a log, whole or not at all.

    Args:
        log: the log.
        path: ends in `.npz` (exact and quick) or `.csv` (readable).
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the log is not valid, the output exists (and `overwrite` is off) or cannot be written.
    """
    _format(path).write(check(log), path, overwrite)


def propose(path: PathLike) -> Proposal:
    """Guess the column table of somebody else's file from its names, shapes and magnitudes.

    Args:
        path: an `.npz` or `.csv` file.

    Returns:
        The table, what was assumed, and what remains open (`to_toml` turns it into lines to paste).

    Raises:
        InputError: the file cannot be read, is in our own layout already, or holds nothing that looks like a stream.
    """
    existing(path)
    raw, own = _format(path).load(path)
    if own is not None:
        raise InputError(f"{path}: is in jaxest's own layout and needs no column table")
    return proposal.guess(raw)
