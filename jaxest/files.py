"""Opening files for reading and writing: plain errors, and outputs that are whole or not there at all."""

import os
import uuid
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from jaxest.types import InputError

PathLike = str | os.PathLike[str]


def existing(path: PathLike) -> Path:
    """Return the path if it can be read.

    Args:
        path: a file's path.

    Returns:
        The path.

    Raises:
        InputError: no such file, a folder, a pipe, an empty file, or one that may not be read.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected a file")
    if not path.exists():
        near = sorted(p.name for p in path.parent.glob(f"{path.stem}.*")) if path.parent.is_dir() else []
        hint = f"; beside it: {', '.join(near[:3])}" if near else ""
        raise InputError(f"{path}: no such file{hint}")
    if not os.access(path, os.R_OK):
        raise InputError(f"{path}: may not be read (permission denied)")
    if not path.is_file():
        raise InputError(f"{path}: is a pipe or a device, expected a file")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty")
    return path


def refuse_existing(path: PathLike, overwrite: bool) -> Path:
    """Return the path if it may be written.

    Args:
        path: where the output goes.
        overwrite: whether an existing file may be replaced.

    Returns:
        The path, links resolved.

    Raises:
        InputError: something is there already, or its folder is absent or may not be written.
    """
    target = Path(path).resolve()
    if target.is_dir():
        raise InputError(f"{path}: is a folder, expected the name of a file to write")
    if target.exists() and not overwrite:
        raise InputError(f"{path}: exists already and is kept; pass overwrite=True (--force) to replace it")
    if not target.parent.is_dir():
        raise InputError(f"{path}: its folder does not exist")
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{path}: its folder may not be written (permission denied)")
    return target


@contextmanager
def replacing(path: PathLike, overwrite: bool = False) -> Iterator[BinaryIO]:
    """Open a temporary file that takes the path's place when the block ends well, and vanishes when it does not.

    Args:
        path: where the output goes.
        overwrite: whether an existing file may be replaced.

    Yields:
        A binary file.

    Raises:
        InputError: the output exists, or cannot be written.
    """
    target = refuse_existing(path, overwrite)
    part = target.with_name(f".{target.name[:100]}.{uuid.uuid4().hex}.part")
    try:
        with part.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        refuse_existing(path, overwrite)  # somebody may have written it meanwhile
        part.replace(target)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)


def write_text(path: PathLike, text: str, overwrite: bool = False) -> None:
    """Write a text in UTF-8, whole or not at all.

    Args:
        path: where it goes.
        text: what it will hold.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the output exists, or cannot be written.
    """
    write_bytes(path, text.encode(), overwrite)


def write_bytes(path: PathLike, content: bytes, overwrite: bool = False) -> None:
    """Write bytes, whole or not at all.

    Args:
        path: where they go.
        content: what it will hold.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the output exists, or cannot be written.
    """
    with replacing(path, overwrite) as file:
        file.write(content)


@contextmanager
def kept(path: PathLike) -> Iterator[None]:
    """Read, in the block, a file that an earlier run kept, so that this one goes on from there.

    Args:
        path: the file.

    Yields:
        Nothing.

    Raises:
        InputError: whatever came of reading it; says that the file may be deleted.
    """
    try:
        yield
    except (InputError, OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        why = str(error).removeprefix(f"{path}: ")
        raise InputError(
            f"{path}: no run can go on from this file ({why}); expected what an earlier run kept: "
            "delete it, and the same command computes it anew"
        ) from error


__all__ = ["PathLike", "existing", "kept", "refuse_existing", "replacing", "write_text"]
