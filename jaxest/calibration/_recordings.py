"""Recordings as they come from a person or a file, looked at before anything is computed from them."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.types import InputError


def finite(name: str, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rows (n, ...) as they are; raises InputError naming the first that is not finite."""
    good = np.isfinite(rows).reshape(len(rows), -1).all(axis=1)
    if not good.all():
        raise InputError(f"{name}: row {int(np.argmin(good))} is not finite")
    return rows


def recorded(time: tuple[str, ArrayLike], **vectors: ArrayLike) -> tuple[NDArray[np.float64], ...]:
    """Return a recording as arrays.

    Args:
        time: its name, and stamps (n,) s.
        **vectors: readings (n, 3) by the names that the caller knows them by.

    Returns:
        Stamps and readings, in the order given.

    Raises:
        InputError: shapes are wrong, a value is not finite, or stamps do not increase; what it is about is named.
    """
    name, stamps = time[0], np.asarray(time[1], np.float64)
    found = {key: np.asarray(value, np.float64) for key, value in vectors.items()}
    if stamps.ndim != 1 or any(x.shape != (len(stamps), 3) for x in found.values()):
        shapes = ", ".join(str(x.shape) for x in (stamps, *found.values()))
        raise InputError(f"{', '.join((name, *found))}: got {shapes}, expected (n,), (n, 3)")
    for key, x in ((name, stamps), *found.items()):
        finite(key, x)
    if len(stamps) < 2 or not (np.diff(stamps) > 0).all():
        raise InputError(f"{name}: expected at least two increasing stamps")
    return stamps, *found.values()


__all__ = ["finite", "recorded"]
