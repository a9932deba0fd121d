"""Which file suffix is read and written by what; a further format is one row in `FORMATS`."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jaxest.files import PathLike, existing
from jaxest.io import bags, csv, hdf5, lerobot, mcap, npz, parquet, proposal, tum
from jaxest.io.bags import arrays_of
from jaxest.io.columns import ColumnTable, parse
from jaxest.io.log import SensorLog, check
from jaxest.io.proposal import Proposal
from jaxest.io.raw import Raw
from jaxest.io.table_streams import apply
from jaxest.io.table_text import to_toml
from jaxest.types import InputError

Own = Callable[[], SensorLog]


class Format(NamedTuple):
    """One kind of file."""

    load: Callable[[PathLike], tuple[Raw, Own | None]]
    """Reads the arrays, and returns how to read the log where the file says itself which streams it holds."""
    write: Callable[[SensorLog, PathLike, bool], None] | None = None
    """None for what is only read."""


def _load_npz(path: PathLike) -> tuple[Raw, Own | None]:
    raw = npz.load(path)
    return raw, (lambda: npz.read_log(raw)) if npz.is_log(raw) else None


def _load_csv(path: PathLike) -> tuple[Raw, Own | None]:
    cells, raw = csv.load(path)
    return raw, (lambda: csv.read_log(cells)) if cells.meta is not None else None


def _load_parquet(path: PathLike) -> tuple[Raw, Own | None]:
    raw, meta = parquet.load(path)
    return raw, None if meta is None else lambda: parquet.read_log(raw, meta)


def _load_hdf5(path: PathLike) -> tuple[Raw, Own | None]:
    raw = hdf5.load(path)
    return raw, (lambda: npz.read_log(raw)) if npz.is_log(raw) else None


def _load_whole(reader: Callable[[PathLike], SensorLog]) -> Callable[[PathLike], tuple[Raw, Own]]:
    """For formats that say themselves what they hold: their streams' arrays are there for a column table to rename."""

    def load(path: PathLike) -> tuple[Raw, Own]:
        log = reader(path)
        return arrays_of(log), lambda: log

    return load


_PARQUET, _HDF5 = Format(_load_parquet, parquet.write_log), Format(_load_hdf5, hdf5.write_log)
_BAG, _LEROBOT = Format(_load_whole(bags.read)), Format(_load_whole(lerobot.read))
FORMATS = {
    ".npz": Format(_load_npz, npz.write_log),
    ".csv": Format(_load_csv, csv.write_log),
    ".parquet": _PARQUET,
    ".pq": _PARQUET,
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".mcap": Format(_load_whole(bags.read), mcap.write_log),
    ".bag": _BAG,
    ".db3": _BAG,
    ".tum": Format(_load_whole(tum.read_log), tum.write_log),
}
FOLDERS = "the folder of a ROS 2 bag (with metadata.yaml) or of a LeRobot dataset (with meta/info.json)"


def is_log_folder(path: PathLike) -> bool:
    """Say whether a folder is a log: a ROS 2 bag or a LeRobot dataset."""
    return Path(path).is_dir() and (bags.is_bag_folder(path) or lerobot.is_dataset(path))


def _format(path: PathLike, reading: bool = True) -> Format:
    if reading and is_log_folder(path):
        return _BAG if bags.is_bag_folder(path) else _LEROBOT
    if reading and Path(path).is_dir():
        raise InputError(f"{path}: is a folder, expected a file, or {FOLDERS}")
    if reading:
        existing(path)
    suffix = Path(path).suffix.lower()
    usable = [s for s, entry in FORMATS.items() if reading or entry.write]
    if suffix not in usable:
        verb = "read" if reading else "written"
        raise InputError(f"{path}: logs are {verb} as {', '.join(usable)}, not {suffix or 'without suffix'}")
    return FORMATS[suffix]


def read(path: PathLike, columns: ColumnTable | Mapping[str, Any] | None = None) -> SensorLog:
    """Read a log.

    A file in our own layout is recognised. Other people's files are read through a column table; without one,
    through the table that `propose` guesses, if the file settles everything that matters.

    Args:
        path: an `.npz`, `.csv`, `.parquet`, `.h5`, `.tum`, `.bag`, `.mcap` or `.db3` file, or the folder of a ROS 2
            bag or of a LeRobot dataset.
        columns: the `[columns]` table of a config, as a dict or parsed; for a file in another layout. A file in our
            own layout needs none, and one that names nothing in it is passed over.

    Returns:
        The log, checked: float64 stamps in seconds, SI units (a log in our own layout keeps the unit it states).
        What was assumed is in its `notes`. NaN stays, as missing samples.

    Raises:
        InputError: no such file, unreadable, bad stamps or shapes, unknown array or unit; and for a layout that
            leaves something open, the lines to paste into a config.
    """
    raw, own = _format(path).load(path)
    table = _table(path, columns)
    if table is not None and (own is None or _speaks_of(table, raw)):
        return check(apply(raw, table))
    if own is not None:
        return own()
    guess = proposal.guess(raw)
    if guess.unsure:
        raise InputError(
            f"{path}: not in jaxest's own layout, and its names leave something open: {'; '.join(guess.unsure)}\n"
            f"Put the right lines into a config:\n{to_toml(guess)}"
        )
    log = apply(raw, guess.table)
    return check(log._replace(notes=guess.assumed))


def _table(path: PathLike, columns: ColumnTable | Mapping[str, Any] | None) -> ColumnTable | None:
    if columns is None or isinstance(columns, ColumnTable):
        return columns
    return parse(columns, f"{path}: columns")


def _speaks_of(table: ColumnTable, raw: Raw) -> bool:
    """Say whether a table names anything that is in the file; one config may serve a foreign log and our estimate."""
    return any(name in raw.arrays for c in table.streams.values() for name in (c.array, *c.columns))


def write(log: SensorLog, path: PathLike, overwrite: bool = False) -> None:
    """Write a log, whole or not at all.

    Args:
        log: the log.
        path: ends in `.npz` (exact and quick), `.csv` (readable), `.parquet` or `.h5` (exact, for other programs),
            `.mcap` (ROS 2 messages; float64, ns), or `.tum` (one pose).
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the log is not valid, the output exists (and `overwrite` is off) or cannot be written.
    """
    writer = _format(path, reading=False).write
    assert writer is not None
    writer(check(log), path, overwrite)


def propose(path: PathLike) -> Proposal:
    """Guess the column table of somebody else's file from its names, shapes and magnitudes.

    Args:
        path: a file in somebody else's layout, `.npz`, `.csv`, `.parquet` or `.h5`.

    Returns:
        The table, what was assumed, and what remains open (`to_toml` turns it into lines to paste).

    Raises:
        InputError: the file cannot be read, is in our own layout already, or holds nothing that looks like a stream.
    """
    raw, own = _format(path).load(path)
    if own is not None:
        raise InputError(
            f"{path}: is in jaxest's own layout, or says otherwise which streams it holds, and needs no column table"
        )
    return proposal.guess(raw)
