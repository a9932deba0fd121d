"""A file before anybody knows what its parts mean: named arrays, and what could not be read of them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.types import InputError, unknown_name


class Raw(NamedTuple):
    """Arrays of a file by name, in the file's order."""

    source: str
    arrays: dict[str, NDArray[Any]]
    refused: Mapping[str, str] = {}
    """Name and reason of what cannot be read as numbers at all (text, pickled objects): in nobody's way."""
    broken: Mapping[str, str] = {}
    """Name and reason of what is numeric but damaged: an error as soon as somebody guesses or asks."""
    empty: Mapping[str, NDArray[np.bool_]] = {}
    """For CSV columns with empty cells: (n,) where they are."""
    word: str = "array"
    """What one of them is called in this kind of file."""


def pick(raw: Raw, name: str) -> NDArray[Any]:
    """Return the array of that name.

    Args:
        raw: the file.
        name: the array's (NPZ) or column's (CSV) name.

    Returns:
        The array.

    Raises:
        InputError: it does not exist (closest names given), is damaged, or does not hold numbers.
    """
    reason = raw.broken.get(name) or raw.refused.get(name)
    if reason:
        raise InputError(f"{raw.source}: {reason}")
    if name not in raw.arrays:
        raise InputError(f"{raw.source}: {unknown_name(raw.word, name, raw.arrays)}")
    return raw.arrays[name]
