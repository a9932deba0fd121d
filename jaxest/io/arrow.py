"""Columns of Arrow tables as NumPy arrays, for Parquet files of any origin."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike
from jaxest.io.extras import need
from jaxest.io.growth import refuse_excess
from jaxest.types import InputError

Column = NDArray[Any]


def read_table(path: PathLike, columns: list[str] | None = None) -> Any:
    """Read a Parquet file, its checksums verified where it has any.

    Args:
        path: the file.
        columns: which columns to read, all by default.

    Returns:
        The Arrow table.

    Raises:
        InputError: pyarrow is not installed; not Parquet, truncated, or damaged, with how many rows can be read.
    """
    pyarrow, parquet = need("pyarrow", "parquet", path), need("pyarrow.parquet", "parquet", path)
    try:
        file = parquet.ParquetFile(path, page_checksum_verification=True)
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: not a readable Parquet file ({error}); its index stands at its end, so that of a truncated one "
            "nothing can be read"
        ) from error
    counts = file.metadata
    cells = sum(
        counts.row_group(i).column(j).num_values
        for i in range(counts.num_row_groups)
        for j in range(counts.num_columns)
    )
    refuse_excess(path, "the file", 8 * max(cells, 0), Path(path).stat().st_size)
    with file:
        groups, rows = [], 0
        for i in range(file.num_row_groups):
            try:
                groups.append(file.read_row_group(i, columns=columns))
            except (pyarrow.ArrowException, OSError) as error:
                raise InputError(
                    f"{path}: damaged behind row {rows} of {file.metadata.num_rows} (row group {i}: {error}); the "
                    f"{rows} rows before can be read"
                ) from error
            rows += groups[-1].num_rows
        return pyarrow.concat_tables(groups) if groups else file.schema_arrow.empty_table()


def to_numpy(column: Any) -> tuple[Column, NDArray[np.bool_]]:
    """Turn a column into an array.

    Args:
        column: Arrow array of n numbers, times, durations (s), or lists of one length.

    Returns:
        (n,) or (n, ...) values, and (n,) where the column has none (null); rows without a value hold 0 or NaN.

    Raises:
        ValueError: the column holds something else.
    """
    import pyarrow as pa

    array = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    if isinstance(array, pa.ChunkedArray):
        array = pa.concat_arrays(array.chunks) if array.num_chunks else pa.array([], array.type)
    blank = np.asarray(array.is_null())
    kind = array.type
    if isinstance(array, pa.ExtensionArray):
        array, kind = array.storage, array.storage.type
    if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        return _lists(array, blank), blank
    if pa.types.is_decimal(kind):
        array, kind = array.cast(pa.float64()), pa.float64()
    if pa.types.is_date(kind):
        array, kind = array.cast(pa.timestamp("ms")), pa.timestamp("ms")
    if pa.types.is_duration(kind):
        steps = array.cast(pa.int64()).to_numpy(zero_copy_only=False).astype(np.float64)
        return steps / {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}[kind.unit], blank
    if pa.types.is_timestamp(kind):
        return array.to_numpy(zero_copy_only=False).astype("datetime64[ns]"), blank
    if pa.types.is_boolean(kind) or pa.types.is_integer(kind) or pa.types.is_floating(kind):
        filled = array.fill_null(False if pa.types.is_boolean(kind) else 0) if blank.any() else array
        value = np.array(filled.to_numpy(zero_copy_only=False))
        if blank.any() and value.dtype.kind == "f":
            value[blank] = np.nan
        return value, blank
    raise ValueError(f"is of type {kind}, expected numbers")


def _lists(array: Any, blank: NDArray[np.bool_]) -> Column:
    """Turn lists of one length into a matrix; rows without a list hold 0 or NaN."""
    lengths = np.asarray(array.drop_null().value_lengths())
    if len(lengths) and (lengths != lengths[0]).any():
        raise ValueError(f"holds lists of {lengths.min()} to {lengths.max()} numbers, expected one length")
    inner, hollow = to_numpy(array.flatten())  # without the rows that have no list
    if hollow.any() and inner.dtype.kind != "f":
        inner = inner.astype(np.float64)
        inner[hollow] = np.nan
    if inner.dtype.kind not in "biuf":
        raise ValueError("holds lists of something else than numbers")
    width = int(lengths[0]) if len(lengths) else 0
    empty = np.nan if inner.dtype.kind == "f" else 0
    value = np.full((len(blank), width, *inner.shape[1:]), empty, inner.dtype)
    value[~blank] = inner.reshape((-1, width, *inner.shape[1:])) if width else 0
    return value
