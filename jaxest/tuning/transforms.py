"""Constrained values as functions of free numbers: what an optimiser may move without leaving the domain.

A constraint takes a value on the host, checks it, and returns a `Bijection` between the domain and all of R^n. Values
on curved spaces are charted from the value itself, so that the chart is smooth around the start.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.tuning._chart import Bijection, Constraint
from jaxest.tuning._chart_curved import covariance, rotation, unit_vector
from jaxest.tuning._chart_numbers import bingham, equal, interval, nonpositive, positive, real, simplex
from jaxest.types import unknown_name

CONSTRAINTS: dict[str, Constraint] = {
    "real": real,
    "positive": positive,
    "nonpositive": nonpositive,
    "share": interval(0.0, 1.0),
    "simplex": simplex,
    "bingham": bingham,
    "unit_vector": unit_vector,
    "rotation": rotation,
    "covariance": covariance,
}
"""By the names that a command line uses; `equal-NAME` is `equal` of one of them."""


def named(name: str) -> Constraint:
    """Return a constraint by its name.

    Args:
        name: one of `CONSTRAINTS`, or `equal-` and one of them.

    Returns:
        The constraint.

    Raises:
        InputError: the name is unknown; the closest is given.
    """
    plain = name.removeprefix("equal-")
    if plain not in CONSTRAINTS:
        raise unknown_name("constraint", name, CONSTRAINTS)
    return equal(CONSTRAINTS[plain]) if name != plain else CONSTRAINTS[plain]


def usual(path: str, value: Any) -> str:
    """Return the name of the constraint that a parameter of this name and value usually has.

    Args:
        path: the parameter's, such as `sensors.imu2.lam`.
        value: its value.

    Returns:
        `bingham` for a `lam`, `rotation` for a `mounting` or a unit quaternion of another name, `share` for what is
        called forgetting or share, `covariance` for a symmetric positive definite matrix, `real` for offsets, starts,
        biases and what is not positive, `positive` for the rest.
    """
    array, leaf = np.asarray(value, np.float64), path.rsplit(".", 1)[-1]
    if leaf == "lam":
        return "bingham"
    if leaf in ("mounting", "quaternion", "rotation") and array.shape in ((4,), (3, 3)):
        return "rotation"
    if any(word in leaf for word in ("forgetting", "share")):
        return "share"
    if _definite(array):
        return "covariance"
    if any(word in leaf for word in ("offset", "start", "bias_")) or not (array > 0).all():
        return "real"
    return "positive"


def _definite(array: NDArray[np.float64]) -> bool:
    """Whether a value is a matrix that `covariance` takes; one of a single entry is a number."""
    if array.ndim != 2 or array.size < 2:
        return False
    try:
        covariance(array)
    except ValueError:
        return False
    return True


__all__ = [
    "CONSTRAINTS",
    "Bijection",
    "Constraint",
    "bingham",
    "covariance",
    "equal",
    "interval",
    "named",
    "nonpositive",
    "positive",
    "real",
    "rotation",
    "simplex",
    "unit_vector",
    "usual",
]
