"""Constrained values as functions of free numbers: what an optimiser may move without leaving the domain.

A constraint takes a value on the host, checks it, and returns a `Bijection` between the domain and all of R^n. Values
on curved spaces are charted from the value itself, so that the chart is smooth around the start.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest import linalg
from jaxest.manifolds import quaternion, so3
from jaxest.types import Array, unknown_name

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


def _array(value: Any) -> NDArray[np.float64]:
    array = np.asarray(value, np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"got {array.tolist()}, expected finite numbers")
    return array


def _elementwise(value: NDArray[Any], there: Callable[[Array], Array], back: Callable[[Array], Array]) -> Bijection:
    shape = value.shape
    return Bijection(
        value.size, lambda z: there(z).reshape(shape), lambda x: back(jnp.asarray(x)).reshape(-1)
    )  # fmt: skip


def real(value: Any) -> Bijection:
    """Leave any numbers as they are."""
    return _elementwise(_array(value), lambda z: z, lambda x: x)


def positive(value: Any) -> Bijection:
    """Keep numbers above 0, by their logarithms: concentrations, variances, gains."""
    array = _array(value)
    if not (array > 0).all():
        raise ValueError(f"got {array.tolist()}, expected numbers above 0")
    return _elementwise(array, jnp.exp, jnp.log)


def nonpositive(value: Any) -> Bijection:
    """Keep numbers below 0, by the logarithms of their sizes; those that are 0 stay 0."""
    array = _array(value)
    moving = np.flatnonzero(array.reshape(-1))
    if not (array <= 0).all() or not moving.size:
        raise ValueError(f"got {array.tolist()}, expected numbers of 0 and below, not all 0")

    def constrain(z: Array) -> Array:
        return jnp.zeros(array.size, z.dtype).at[moving].set(-jnp.exp(z)).reshape(array.shape)

    return Bijection(moving.size, constrain, lambda x: jnp.log(-jnp.asarray(x).reshape(-1)[moving]))


def interval(low: float, high: float) -> Constraint:
    """Keep numbers strictly between two ends, by their logits: forgetting factors, shares.

    Args:
        low: lower end.
        high: upper end.

    Returns:
        The constraint.

    Raises:
        ValueError: the ends are not in order.
    """
    if not low < high:
        raise ValueError(f"interval: got ({low}, {high}), expected two ends in order")
    return partial(_interval, float(low), float(high))


def _interval(low: float, high: float, value: Any) -> Bijection:
    array = _array(value)
    if not ((array > low) & (array < high)).all():
        raise ValueError(f"got {array.tolist()}, expected numbers strictly between {low:g} and {high:g}")

    def constrain(z: Array) -> Array:
        # From the nearer end, so that 1 - 1e-6 keeps its digits.
        return jnp.where(z < 0, low + (high - low) * jax.nn.sigmoid(z), high - (high - low) * jax.nn.sigmoid(-z))

    return _elementwise(array, constrain, lambda x: jnp.log(x - low) - jnp.log(high - x))


def simplex(value: Any) -> Bijection:
    """Keep k shares above 0 that sum to one, by the logarithms of their ratios to the last."""
    array = _array(value)
    if array.ndim != 1 or array.size < 2 or not (array > 0).all() or abs(array.sum() - 1) > UNIT:
        raise ValueError(f"got {array.tolist()}, expected two or more numbers above 0 that sum to 1")

    def constrain(z: Array) -> Array:
        return jax.nn.softmax(jnp.concatenate([z, jnp.zeros(1, z.dtype)]))

    def unconstrain(x: Any) -> Array:
        logs = jnp.log(jnp.asarray(x))
        return logs[:-1] - logs[-1]

    return Bijection(array.size - 1, constrain, unconstrain)


def bingham(value: Any) -> Bijection:
    """Keep Bingham concentrations in their order, the largest 0: equal ones stay equal, gaps stay above 0.

    Each gap to the next larger concentration is charted by its logarithm, so that axisymmetric ones (0, -k, -k, 0) have
    one free number, and no pair can change places, of which the density would know nothing.
    """
    array = _array(value)
    levels, where = np.unique(-array, return_inverse=True)  # ascending sizes, the first 0
    if array.ndim != 1 or levels[0] != 0 or levels.size < 2:
        raise ValueError(f"got {array.tolist()}, expected concentrations whose largest is 0 and not all 0")
    first = np.array([int(np.flatnonzero(where == k)[0]) for k in range(levels.size)])

    def constrain(z: Array) -> Array:
        return -jnp.concatenate([jnp.zeros(1, z.dtype), jnp.cumsum(jnp.exp(z))])[where]

    return Bijection(levels.size - 1, constrain, lambda x: jnp.log(jnp.diff(-jnp.asarray(x)[first])))


def unit_vector(value: Any) -> Bijection:
    """Keep a direction (k,) of length 1, by the tangent vector that leads to it from the value along a great circle."""
    array = _array(value)
    length = np.linalg.norm(array)
    if array.ndim != 1 or array.size < 2 or abs(length - 1) > UNIT:
        raise ValueError(f"got {array.tolist()} of length {length:.6g}, expected a vector of length 1")
    # Householder's reflection takes the first axis to the value (or its opposite); the others span its tangents.
    sign = 1.0 if array[0] >= 0 else -1.0
    mirror = array / length + sign * np.eye(array.size)[0]
    frame = np.eye(array.size) - 2 * np.outer(mirror, mirror) / (mirror @ mirror)
    anchor, tangents = -sign * frame[:, 0], frame[:, 1:]

    def constrain(z: Array) -> Array:
        square = jnp.sum(z * z)
        small = square < 1e-8
        length = jnp.sqrt(jnp.where(small, 1.0, square))
        ratio = jnp.where(small, 1 - square / 6, jnp.sin(length) / length)
        cosine = jnp.where(small, 1 - square / 2, jnp.cos(length))
        found = cosine * jnp.asarray(anchor, z.dtype) + ratio * _dot(jnp.asarray(tangents, z.dtype), z)
        return found / jnp.sqrt(jnp.sum(found * found))

    def unconstrain(x: Any) -> Array:
        x = jnp.asarray(x)
        along, across = jnp.sum(x * anchor.astype(x.dtype)), _dot(jnp.asarray(tangents.T, x.dtype), x)
        square = jnp.sum(across * across)
        there = square > 0
        size = jnp.sqrt(jnp.where(there, square, 1.0))
        return across * jnp.where(there, jnp.arctan2(size, along) / size, 1.0)

    return Bijection(array.size - 1, constrain, unconstrain)


def _dot(matrix: Array, vector: Array) -> Array:
    return jnp.sum(matrix * vector[None, :], axis=1)


def rotation(value: Any) -> Bijection:
    """Keep a rotation, a quaternion (4,) wxyz or a matrix (3, 3), by the rotation vector from the value, rad."""
    array = _array(value)
    group: Any = {(4,): quaternion, (3, 3): so3}.get(array.shape)
    if group is None:
        raise ValueError(f"got shape {array.shape}, expected a quaternion (4,) or a matrix (3, 3)")
    off = np.linalg.norm(array) - 1 if group is quaternion else np.abs(array @ array.T - np.eye(3)).max()
    if abs(off) > UNIT or (group is so3 and np.linalg.det(array) < 0):
        raise ValueError(f"got {array.tolist()}, expected a unit quaternion or a rotation matrix")

    def constrain(z: Array) -> Array:
        return group.retract(jnp.asarray(array, z.dtype), z)

    def unconstrain(x: Any) -> Array:
        x = jnp.asarray(x)
        return group.local(jnp.asarray(array, x.dtype), x)

    return Bijection(3, constrain, unconstrain)


def covariance(value: Any) -> Bijection:
    """Keep a symmetric positive definite matrix (n, n), by its Cholesky factor with logarithms on the diagonal."""
    array = _array(value)
    n = len(array) if array.ndim else 0
    scale = np.abs(array).max() if array.size else 0.0
    if array.shape != (n, n) or n == 0 or np.abs(array - array.T).max() > UNIT * scale:
        raise ValueError(f"got shape {array.shape}, expected a symmetric matrix (n, n)")
    if np.linalg.eigvalsh((array + array.T) / 2)[0] <= 0:
        raise ValueError(f"got {array.tolist()}, expected a positive definite matrix")
    below = np.tril_indices(n, -1)

    def constrain(z: Array) -> Array:
        lower = jnp.zeros((n, n), z.dtype).at[np.diag_indices(n)].set(jnp.exp(z[:n])).at[below].set(z[n:])
        return jnp.matmul(lower, lower.T, precision=jax.lax.Precision.HIGHEST)

    def unconstrain(x: Any) -> Array:
        lower = linalg.cholesky(jnp.asarray(x))
        return jnp.concatenate([jnp.log(jnp.diagonal(lower)), lower[below]])

    return Bijection(n * (n + 1) // 2, constrain, unconstrain)


def equal(constraint: Constraint) -> Constraint:
    """Let all entries of a leaf be one number, constrained by another constraint.

    Args:
        constraint: of one number, such as `positive`.

    Returns:
        The constraint; its value must have equal entries.
    """
    return partial(_equal, constraint)


def _equal(constraint: Constraint, value: Any) -> Bijection:
    array = _array(value)
    if array.size < 1 or not (array == array.reshape(-1)[0]).all():
        raise ValueError(f"got {array.tolist()}, expected equal entries")
    one = constraint(array.reshape(-1)[0])
    return Bijection(
        one.size,
        lambda z: jnp.broadcast_to(one.constrain(z), array.shape),
        lambda x: one.unconstrain(jnp.asarray(x).reshape(-1)[0]),
    )


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
        called forgetting or share, `real` for offsets, starts, biases and what is not positive, `covariance` for a
        symmetric positive matrix, `positive` for the rest.
    """
    array, leaf = np.asarray(value, np.float64), path.rsplit(".", 1)[-1]
    if leaf == "lam":
        return "bingham"
    if leaf in ("mounting", "quaternion", "rotation") and array.shape in ((4,), (3, 3)):
        return "rotation"
    if any(word in leaf for word in ("forgetting", "share")):
        return "share"
    if any(word in leaf for word in ("offset", "start", "bias_")) or not (array > 0).all():
        square = array.ndim == 2 and array.shape[0] == array.shape[1] and bool((np.diag(array) > 0).all())
        return "covariance" if square else "real"
    return "positive"


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
