"""Finished pieces of the parts, kept in `--work`, so that a stopped run goes on from there."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest import files
from jaxest.io import npz

Arrays = Mapping[str, NDArray[Any]]


def piece(work: Path | None, name: str, compute: Callable[[], Arrays]) -> Arrays:
    """Return a piece as it was kept, or compute and keep it.

    Args:
        work: folder, or None to keep nothing.
        name: of the piece, all that it depends on in it.
        compute: makes the arrays.

    Returns:
        The arrays.
    """
    if work is None:
        return compute()
    path = work / "santaera2015" / f"{name}.npz"
    if path.is_file():
        with files.kept(path):
            return npz.load(path).arrays
    made = {key: np.asarray(value) for key, value in compute().items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    npz.save(path, made)
    return made


__all__ = ["piece"]
