"""HDF5 files: datasets `NAME/time`, `NAME/value` and JSON text `NAME/meta`, as in NPZ files; and other people's.

Of other people's files, each dataset is an array by its path (`imu/gyr`), each member of a compound dataset one of its
own (`samples.gx`), and each numeric attribute one as `PATH@NAME` (`@fs` for one of the file). Text and references are
left out, and neither links into other files nor datasets that keep their numbers there are followed.
"""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike, existing, replacing
from jaxest.io.extras import need
from jaxest.io.growth import excessive
from jaxest.io.log import SensorLog
from jaxest.io.npz import meta_of, to_text
from jaxest.io.raw import Raw
from jaxest.types import InputError


def load(path: PathLike) -> Raw:
    """Read every dataset of an HDF5 file.

    Args:
        path: the file.

    Returns:
        The arrays; what holds no numbers is listed as refused, a damaged dataset as broken.

    Raises:
        InputError: h5py is not installed; no such file; not HDF5, or truncated, with the sizes found and expected.
    """
    path = existing(path)
    h5py = need("h5py", "hdf5", path)
    arrays: dict[str, NDArray[Any]] = {}
    refused: dict[str, str] = {}
    broken: dict[str, str] = {}
    claimed, stored = [0], path.stat().st_size

    def visit(named: str | bytes, item: Any) -> None:
        name = named if isinstance(named, str) else named.decode(errors="replace")
        _attributes(name, item, arrays)
        if not isinstance(item, h5py.Dataset):
            return
        try:
            if item.external or item.is_virtual:
                refused[name] = f"dataset {name!r} keeps its numbers in other files, which are not followed"
                return
            if excessive(claimed[0] + item.nbytes, stored):
                broken[name] = (
                    f"dataset {name!r} claims {item.nbytes} bytes, those before it {claimed[0]}, out of {stored} stored"
                )
                return
            claimed[0] += item.nbytes
            _dataset(name, item, h5py, arrays, refused)
        except (OSError, RuntimeError, ValueError, TypeError) as error:
            broken[name] = f"dataset {name!r} cannot be read ({error})"

    try:
        with h5py.File(path, "r") as file:
            _attributes("", file, arrays)
            file.visititems(visit)
    except (OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: not a readable HDF5 file ({error}); of a truncated one nothing can be read, as its parts are "
            "found only through one another"
        ) from error
    if not arrays and not refused and not broken:
        raise InputError(f"{path}: the HDF5 file is empty: it holds no dataset")
    if broken and any(name.endswith(("/time", "/value", "/meta")) for name in broken):
        whole = sum(name not in broken for name in arrays)
        raise InputError(f"{path}: {next(iter(broken.values()))}; {whole} other datasets can be read")
    return Raw(str(path), arrays, refused, broken, {}, "dataset")


def _attributes(name: str, item: Any, arrays: dict[str, NDArray[Any]]) -> None:
    for key, entry in item.attrs.items():
        value = np.asarray(entry)
        if value.dtype.kind in "biuf":
            arrays[f"{name}@{key}"] = value.reshape(()) if value.size == 1 else value


def _dataset(name: str, item: Any, h5py: Any, arrays: dict[str, NDArray[Any]], refused: dict[str, str]) -> None:
    if h5py.check_string_dtype(item.dtype) is not None:
        if name.endswith("/meta") and item.shape == ():
            arrays[name] = np.array(item.asstr()[()])
        else:
            refused[name] = f"dataset {name!r} holds text, expected numbers"
    elif item.dtype.names:
        value = item[()]
        for member in item.dtype.names:
            if value[member].dtype.kind in "biuf":
                arrays[f"{name}.{member}"] = np.ascontiguousarray(value[member])
            else:
                refused[f"{name}.{member}"] = f"member {member!r} of dataset {name!r} does not hold numbers"
    elif item.dtype.kind not in "biuf" or item.shape is None:
        refused[name] = f"dataset {name!r} is of type {item.dtype}, expected numbers"
    else:
        value = item[()]
        arrays[name] = np.asarray(value if item.dtype.isnative else value.astype(item.dtype.newbyteorder("=")))


def write_log(log: SensorLog, path: PathLike, overwrite: bool = False) -> None:
    """Write a log as HDF5; dtypes are kept bit for bit, each dataset with a checksum.

    Args:
        log: a checked log.
        path: where it goes.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: h5py is not installed, one stream's name is the folder of another's arrays, or the output exists or
            cannot be written.
    """
    h5py = need("h5py", "hdf5", path)
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        for name, item in log.streams.items():
            meta = to_text(meta_of(item), f"{path}: stream {name!r}")
            try:
                for part, value in (("time", item.time), ("value", item.value)):
                    file.create_dataset(f"{name}/{part}", data=value, **({"fletcher32": True} if value.size else {}))
                file.create_dataset(f"{name}/meta", data=meta)
            except (ValueError, TypeError, OSError) as error:
                raise InputError(f"{path}: stream {name!r}: HDF5 cannot hold it ({error})") from error
    with replacing(path, overwrite) as out:
        out.write(buffer.getbuffer())
