"""Finished pieces of the parts, kept in `--work`, so that a stopped run goes on from there."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.io import npz, pieces

Arrays = Mapping[str, NDArray[Any]]
CODE = (*pieces.ESTIMATE, "reproduce/santaera2015")


def piece(work: Path | None, name: str, compute: Callable[[], Arrays]) -> Arrays:
    """Return a piece as it was kept, or compute and keep it.

    Args:
        work: folder, or None to keep nothing.
        name: of the piece, all that it depends on in it.
        compute: makes the arrays.

    Returns:
        The arrays.
    """

    def arrays() -> Arrays:
        return {key: np.asarray(value) for key, value in compute().items()}

    path = None if work is None else pieces.folder(work / "santaera2015", CODE) / f"{name}.npz"
    return pieces.made(path, arrays, lambda path: npz.load(path).arrays, npz.save)


__all__ = ["piece"]
