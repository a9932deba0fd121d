"""What a chart of a constrained value is, and the check that every value passes first."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.types import Array

UNIT = 1e-3
"""How far from its domain (length 1, symmetry, sum 1) a value may be rounded; relative."""


class Bijection(NamedTuple):
    """One value's chart."""

    size: int
    """n, free numbers."""
    constrain: Callable[[Array], Array]
    """`z (n,) -> value`, for every z; differentiable, in z's dtype."""
    unconstrain: Callable[[Any], Array]
    """`value -> z (n,)`."""


Constraint = Callable[[Any], Bijection]
"""`value -> Bijection`; raises ValueError (what was found, what was expected) where the value is outside the domain."""


def finite(value: Any) -> NDArray[np.float64]:
    """Return a value as an array; raises ValueError where it is not finite."""
    array = np.asarray(value, np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"got {array.tolist()}, expected finite numbers")
    return array


__all__ = ["UNIT", "Bijection", "Constraint", "finite"]
