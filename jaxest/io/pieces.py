"""What a long run keeps to go on from: whole files, told apart by the run and the code that made them.

A folder of pieces is opened by `folder`, which refuses one that other code filled. In it a piece is any file that is
there or computed and then written (`made`), or a checkpoint (`save`, `load`) that carries a `mark`: the checksum of all
that its numbers depend on.
"""

import functools
import hashlib
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

import jaxest
from jaxest.files import PathLike, kept, write_text
from jaxest.io.checkpoint import load_state, save_state
from jaxest.types import InputError, PyTree

RECORD = "made_by.txt"
SIMULATION = ("derivatives", "linalg", "manifolds", "distributions", "kinematics", "models", "sensors", "simulate")
"""Parts of the package that simulated data depend on."""
ESTIMATE = (*SIMULATION, "filters", "mapping", "parallel", "mcmc", "calibration", "systems", "metrics")
"""Parts that an estimate depends on."""
T = TypeVar("T")


@functools.cache
def code(parts: tuple[str, ...] = ESTIMATE) -> str:
    """Return which code makes results: the version, and a checksum of the sources that they come from.

    Args:
        parts: folders and files of the package that results depend on, for example `"reproduce/sato2023"`.

    Returns:
        One line; it changes with every line of those sources.
    """
    root = Path(jaxest.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root).as_posix()
        if any(name.startswith((f"{part}/", f"{part}.")) for part in parts):
            digest.update(name.encode() + b"\0" + path.read_bytes())
    return f"jaxest {jaxest.__version__}, code {digest.hexdigest()[:12]}"


def folder(path: PathLike, parts: tuple[str, ...] = ESTIMATE) -> Path:
    """Open a folder of pieces, made if it is not there.

    Args:
        path: where.
        parts: as for `code`.

    Returns:
        The folder.

    Raises:
        InputError: the folder holds pieces that other code made, or nobody knows which; or it cannot be made.
    """
    place, now = Path(path), code(parts)
    record = place / RECORD
    try:
        place.mkdir(parents=True, exist_ok=True)
        before = record.read_text(errors="replace").strip() if record.exists() else ""
        filled = any(file.suffix in (".npz", ".json") for file in place.iterdir())
    except OSError as error:
        raise InputError(f"{place}: no folder to keep pieces in: {error.strerror or error}") from error
    if filled and before != now:
        raise InputError(
            f"{place}: its pieces were made by {before or 'code that left no record'}, expected {now}, which may give "
            "other numbers: choose another folder, or delete this one to compute all anew"
        )
    if before != now:
        write_text(record, f"{now}\n", overwrite=True)
    return place


def made(file: Path | None, compute: Callable[[], T], read: Callable[[Path], T], write: Callable[[Path, T], None]) -> T:
    """Return a piece as it was kept, or compute and keep it.

    Args:
        file: its name says all that it depends on, but for the code; None to keep nothing.
        compute: makes it.
        read: reads it.
        write: writes it, whole or not at all.

    Returns:
        The piece.

    Raises:
        InputError: the file cannot be read.
    """
    if file is None:
        return compute()
    if file.is_file():
        with kept(file):
            return read(file)
    found = compute()
    write(file, found)
    return found


def save(file: PathLike, tree: PyTree, mark: int, overwrite: bool = False) -> None:
    """Keep a tree as a checkpoint that belongs to the run with this `mark`."""
    save_state(file, {"mark": np.uint32(mark), "kept": tree}, overwrite)


def load(file: PathLike, like: PyTree, mark: int) -> PyTree:
    """Read what `save` wrote.

    Args:
        file: the checkpoint.
        like: a tree of the same structure, shapes and dtypes.
        mark: of the run that goes on.

    Returns:
        The tree.

    Raises:
        InputError: it cannot be read, or belongs to a run with another mark.
    """
    with kept(file):
        found = load_state(file, {"mark": np.uint32(0), "kept": like})
    if int(found["mark"]) != mark:
        raise InputError(f"{file}: belongs to a run with other data, settings, starts or code; choose another place")
    return found["kept"]


def fingerprint(tree: PyTree) -> int:
    """Return a checksum of a tree's arrays and texts, and of where they stand: it tells pieces of other runs apart."""
    import jax

    mark = 0
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        key = hasattr(leaf, "dtype") and jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        array = np.ascontiguousarray(np.asarray(jax.random.key_data(leaf) if key else leaf))
        place = f"{jax.tree_util.keystr(path)} {array.dtype} {np.shape(leaf)}"
        mark = zlib.crc32(array.tobytes(), zlib.crc32(place.encode(), mark))
    return mark


__all__ = ["ESTIMATE", "RECORD", "SIMULATION", "code", "fingerprint", "folder", "load", "made", "save"]
