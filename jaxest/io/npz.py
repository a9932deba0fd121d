"""NPZ files: arrays `NAME/time`, `NAME/value` and JSON text `NAME/meta`; never a pickle."""

import json
import zipfile
import zlib
from collections.abc import Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike, existing, replacing
from jaxest.io.growth import refuse_excess
from jaxest.io.log import SensorLog, Stream, check
from jaxest.io.raw import Raw
from jaxest.types import InputError


def load(path: PathLike) -> Raw:
    """Read every array of an NPZ file without ever unpickling.

    Args:
        path: the file.

    Returns:
        The arrays; pickled objects are listed as refused.

    Raises:
        InputError: no such file, not an NPZ, truncated, or members that no array can have.
    """
    path = existing(path)
    arrays: dict[str, NDArray[Any]] = {}
    refused: dict[str, str] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            claimed = sum(info.file_size for info in archive.infolist())
            refuse_excess(path, "what it holds", claimed, path.stat().st_size)
            for info in archive.infolist():
                name = _member_name(str(path), info, arrays)
                with archive.open(info) as member:
                    value = _array(str(path), name, info, member)
                if isinstance(value, str):
                    refused[name] = value
                else:
                    arrays[name] = value
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a readable NPZ file ({error}); expected a zip of .npy arrays") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not arrays and not refused:
        raise InputError(f"{path}: the NPZ file is empty: it holds no array")
    return Raw(str(path), arrays, refused)


def _member_name(path: str, info: zipfile.ZipInfo, seen: Mapping[str, Any]) -> str:
    if not info.filename.endswith(".npy"):
        raise InputError(f"{path}: member {info.filename!r} is not a .npy array; is this an NPZ file?")
    name = info.filename.removesuffix(".npy")
    if name in seen:
        raise InputError(f"{path}: member {info.filename!r} is there twice")
    return name


def _array(path: str, name: str, info: zipfile.ZipInfo, file: IO[bytes]) -> NDArray[Any] | str:
    """Read one member, or say why not where only this member is concerned."""
    place = f"{path}: array {name!r}"
    try:
        version = np.lib.format.read_magic(file)
        header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in header:
            return f"array {name!r} is in .npy format {version}, expected 1.0 or 2.0"
        shape, fortran, dtype = header[version](file)
    except ValueError as error:
        raise InputError(f"{place} is not in .npy format ({error})") from error
    if dtype.hasobject:
        return f"array {name!r} holds pickled Python objects, which are never loaded; store numbers or JSON text"
    if dtype.names or dtype.subdtype:
        return f"array {name!r} is structured ({dtype}), expected plain numbers or text"
    if min(shape, default=0) < 0:
        raise InputError(f"{place} claims shape {shape}")
    size = int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
    if size > info.file_size:
        raise InputError(f"{place} claims shape {shape} of {dtype}, {size} bytes, but holds {info.file_size}")
    data = file.read(size)
    if len(data) < size or file.read(1):  # reading to the end also verifies the checksum
        raise InputError(f"{place} of shape {shape} and {dtype} needs {size} bytes, the file holds another number")
    flat = np.frombuffer(bytearray(data), dtype) if size else np.zeros(shape, dtype)
    native = flat if dtype.isnative else flat.astype(dtype.newbyteorder("="))
    return native.reshape(shape, order="F" if fortran else "C")


def save(path: PathLike, arrays: Mapping[str, NDArray[Any]], overwrite: bool = False) -> None:
    """Write arrays into an NPZ file, whole or not at all.

    Args:
        path: where it goes.
        arrays: by name; `/` in a name makes folders of the zip.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the output exists or cannot be written, or an array holds Python objects.
    """
    for name, value in arrays.items():
        if value.dtype.hasobject:
            raise InputError(f"{path}: array {name!r} holds Python objects; expected numbers or text")
    with replacing(path, overwrite) as file, zipfile.ZipFile(file, "w") as archive:
        for name, value in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(value), allow_pickle=False)


def is_log(raw: Raw) -> bool:
    """Say whether the arrays are laid out as `NAME/time`, `NAME/value`."""
    names = {*raw.arrays, *raw.refused}
    return any(name.endswith("/time") and f"{name[:-5]}/value" in names for name in names)


def read_log(raw: Raw) -> SensorLog:
    """Read a log in the layout that `write_log` writes.

    Args:
        raw: the file.

    Returns:
        The log, checked.

    Raises:
        InputError: an array of a stream is missing, has a wrong shape, or its `meta` is not JSON text.
    """
    names = dict.fromkeys(
        n.rsplit("/", 1)[0] for n in (*raw.arrays, *raw.refused) if n.endswith(("/time", "/value", "/meta"))
    )
    streams, notes = {}, []
    for name in names:
        for part in ("time", "value"):
            if f"{name}/{part}" not in raw.arrays:
                why = raw.refused.get(f"{name}/{part}", "is missing")
                raise InputError(f"{raw.source}: stream {name!r} has no array {name + '/' + part!r}: {why}")
        meta = _meta(raw, name)
        if not meta:
            notes.append(f"{name}: no {name}/meta, so that unit and frame are not known")
        time = raw.arrays[f"{name}/time"]
        streams[name] = Stream(
            time.astype(np.float64) if time.dtype.kind in "iuf" else time,
            raw.arrays[f"{name}/value"],
            str(meta.pop("unit", "")),
            str(meta.pop("frame", "")),
            tuple(str(n) for n in meta.pop("names", ())),
            meta,
        )
    return check(SensorLog(streams, raw.source, tuple(notes)))


def _meta(raw: Raw, name: str) -> dict[str, Any]:
    key = f"{name}/meta"
    if key in raw.refused:
        raise InputError(f"{raw.source}: {raw.refused[key]}")
    if key not in raw.arrays:
        return {}
    text = raw.arrays[key]
    if text.size != 1 or text.dtype.kind not in "US":
        raise InputError(f"{raw.source}: {key!r} is {text.dtype} {text.shape}, expected one JSON text")
    item = text.reshape(()).item()
    try:
        meta = json.loads(item.decode() if isinstance(item, bytes) else item)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{raw.source}: {key!r} is not JSON: {error}") from error
    if not isinstance(meta, dict) or not isinstance(meta.get("names", []), list):
        raise InputError(f"{raw.source}: {key!r} must be an object with unit, frame and a list of names")
    return meta


def meta_of(item: Stream, **more: Any) -> dict[str, Any]:
    """Return what is stored beside a stream's arrays."""
    named = {"names": list(item.names)} if item.names else {}
    return {**item.extra, "unit": item.unit, "frame": item.frame, **named, **more}


def to_text(meta: Any, place: str) -> str:
    """Return metadata as JSON text, or raise `InputError` where JSON cannot hold it."""
    try:
        return json.dumps(meta)
    except (TypeError, ValueError) as error:
        raise InputError(f"{place}: JSON cannot hold this metadata ({error})") from error


def write_log(log: SensorLog, path: PathLike, overwrite: bool = False) -> None:
    """Write a log as NPZ; dtypes are kept bit for bit.

    Args:
        log: a checked log.
        path: where it goes.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the output exists or cannot be written.
    """
    arrays: dict[str, NDArray[Any]] = {}
    for name, item in log.streams.items():
        arrays[f"{name}/time"], arrays[f"{name}/value"] = item.time, item.value
        arrays[f"{name}/meta"] = np.array(to_text(meta_of(item), f"{path}: stream {name!r}"))
    save(path, arrays, overwrite)
