"""Parquet files: other people's columns, and our own layout.

Ours: a column `time` (float64, s) with each stamp that any stream has, and one column for each stream under its name:
numbers, or lists of a fixed length (a matrix is flattened by rows), null where the stream has no sample at that stamp.
What a stream is (unit, frame, names, dtype, shape) stands as JSON under the key `jaxest-log` of the schema's metadata.
Numbers are kept bit for bit, and pages carry checksums.
"""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike, existing, replacing
from jaxest.io.arrow import read_table, to_numpy
from jaxest.io.extras import need
from jaxest.io.log import SensorLog, Stream, check
from jaxest.io.npz import meta_of, to_text
from jaxest.io.raw import Raw
from jaxest.types import InputError

_KEY = b"jaxest-log"


def load(path: PathLike) -> tuple[Raw, dict[str, Any] | None]:
    """Read every column of a Parquet file; members of structs become columns, `imu.x`.

    Args:
        path: the file.

    Returns:
        The columns, with what is not numeric listed as refused; and what a file in our own layout says of its streams.

    Raises:
        InputError: pyarrow is not installed, no such file, not Parquet, truncated or damaged.
    """
    path = existing(path)
    table = read_table(path)
    meta = _meta(str(path), table)
    if meta is None:  # names of our streams are kept as they are
        while any(str(kind).startswith("struct<") for kind in table.schema.types):
            table = table.flatten()
    arrays: dict[str, NDArray[Any]] = {}
    refused: dict[str, str] = {}
    empty: dict[str, NDArray[np.bool_]] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name in arrays or name in refused:
            raise InputError(f"{path}: column {name!r} is there twice")
        try:
            value, blank = to_numpy(column)
        except ValueError as error:
            refused[name] = f"column {name!r} {error}"
            continue
        if blank.all() and len(blank):
            refused[name] = f"column {name!r} is empty"
            continue
        if blank.any():
            empty[name] = blank
            if meta is None and value.dtype.kind in "biu" and np.abs(value.astype(np.float64)).max() < 2**53:
                value = np.where(blank, np.nan, value)  # a stamp in ns since 1970 would not survive that
        arrays[name] = value
    return Raw(str(path), arrays, refused, {}, empty, "column"), meta


def _meta(source: str, table: Any) -> dict[str, Any] | None:
    text = (table.schema.metadata or {}).get(_KEY)
    if text is None:
        return None
    try:
        meta = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source}: its metadata {_KEY.decode()!r} is not JSON: {error}") from error
    if not isinstance(meta, dict) or not all(isinstance(entry, dict) for entry in meta.values()):
        raise InputError(f"{source}: its metadata {_KEY.decode()!r} must be an object with an object for each stream")
    return meta


def read_log(raw: Raw, meta: dict[str, Any]) -> SensorLog:
    """Read a log in our own layout.

    Args:
        raw: its columns.
        meta: what its metadata say of each stream.

    Returns:
        The log, checked.

    Raises:
        InputError: a column is missing or has another dtype or shape than the metadata say.
    """
    streams = {}
    for name, stated in meta.items():
        entry, place = dict(stated), f"{raw.source}: stream {name!r}"
        for column in ("time", name):
            if column not in raw.arrays:
                raise InputError(f"{place}: column {column!r} is missing")
        try:
            shape, dtype = tuple(int(n) for n in entry.pop("shape")), np.dtype(entry.pop("dtype"))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{place}: its metadata must state shape and dtype ({error!r})") from error
        there = ~raw.empty.get(name, np.zeros(len(raw.arrays[name]), bool))
        value = raw.arrays[name][there]
        if value.dtype != dtype or value.size != there.sum() * np.prod(shape, dtype=int):
            raise InputError(f"{place}: column is {value.dtype} {value.shape[1:]}, its metadata say {dtype} {shape}")
        unit, frame, names = entry.pop("unit", ""), entry.pop("frame", ""), tuple(entry.pop("names", ()))
        time = raw.arrays["time"][there]
        streams[name] = Stream(time, value.reshape((len(value), *shape)), unit, frame, names, entry)
    return check(SensorLog(streams, raw.source))


def write_log(log: SensorLog, path: PathLike, overwrite: bool = False) -> None:
    """Write a log as Parquet in the layout that the module describes.

    Args:
        log: a checked log.
        path: where it goes.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: pyarrow is not installed, a stream is called `time` or has no columns, or the output exists or
            cannot be written.
    """
    pa, parquet = need("pyarrow", "parquet", path), need("pyarrow.parquet", "parquet", path)
    stamps = np.unique(np.concatenate([item.time for item in log.streams.values()]))
    columns, meta = {"time": pa.array(stamps)}, {}
    for name, item in log.streams.items():
        if name == "time" or item.value.size == 0:
            raise InputError(f"{path}: stream {name!r} has no columns or a reserved name; write .npz")
        shape, rows = item.value.shape[1:], np.searchsorted(stamps, item.time)
        meta[name] = meta_of(item, dtype=str(item.value.dtype), shape=list(shape))
        absent = np.ones(len(stamps), bool)
        absent[rows] = False
        full = np.zeros((len(stamps), *shape), item.value.dtype)
        full[rows] = item.value
        if not shape:
            columns[name] = pa.array(full, mask=absent)
        else:
            width = int(np.prod(shape))
            columns[name] = pa.FixedSizeListArray.from_arrays(pa.array(full.ravel()), width, mask=pa.array(absent))
    table = pa.table(columns).replace_schema_metadata({_KEY: to_text(meta, str(path)).encode()})
    with replacing(path, overwrite) as file:
        parquet.write_table(table, file, write_page_checksum=True, row_group_size=65536)
