"""Charts of numbers: each kept in its own range, or several in their order, their sum or their equality."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.tuning._chart import UNIT, Bijection, Constraint, finite
from jaxest.types import Array


def _elementwise(value: NDArray[Any], there: Callable[[Array], Array], back: Callable[[Array], Array]) -> Bijection:
    shape = value.shape
    return Bijection(
        value.size, lambda z: there(z).reshape(shape), lambda x: back(jnp.asarray(x)).reshape(-1)
    )  # fmt: skip


def real(value: Any) -> Bijection:
    """Leave any numbers as they are."""
    return _elementwise(finite(value), lambda z: z, lambda x: x)


def positive(value: Any) -> Bijection:
    """Keep numbers above 0, by their logarithms: concentrations, variances, gains."""
    array = finite(value)
    if not (array > 0).all():
        raise ValueError(f"got {array.tolist()}, expected numbers above 0")
    return _elementwise(array, jnp.exp, jnp.log)


def nonpositive(value: Any) -> Bijection:
    """Keep numbers below 0, by the logarithms of their sizes; those that are 0 stay 0."""
    array = finite(value)
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
    array = finite(value)
    if not ((array > low) & (array < high)).all():
        raise ValueError(f"got {array.tolist()}, expected numbers strictly between {low:g} and {high:g}")

    def constrain(z: Array) -> Array:
        # From the nearer end, so that 1 - 1e-6 keeps its digits.
        return jnp.where(z < 0, low + (high - low) * jax.nn.sigmoid(z), high - (high - low) * jax.nn.sigmoid(-z))

    return _elementwise(array, constrain, lambda x: jnp.log(x - low) - jnp.log(high - x))


def simplex(value: Any) -> Bijection:
    """Keep k shares above 0 that sum to one, by the logarithms of their ratios to the last."""
    array = finite(value)
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
    array = finite(value)
    levels, where = np.unique(-array, return_inverse=True)  # ascending sizes, the first 0
    if array.ndim != 1 or levels[0] != 0 or levels.size < 2:
        raise ValueError(f"got {array.tolist()}, expected concentrations whose largest is 0 and not all 0")
    first = np.array([int(np.flatnonzero(where == k)[0]) for k in range(levels.size)])

    def constrain(z: Array) -> Array:
        return -jnp.concatenate([jnp.zeros(1, z.dtype), jnp.cumsum(jnp.exp(z))])[where]

    return Bijection(levels.size - 1, constrain, lambda x: jnp.log(jnp.diff(-jnp.asarray(x)[first])))


def equal(constraint: Constraint) -> Constraint:
    """Let all entries of a leaf be one number, constrained by another constraint.

    Args:
        constraint: of one number, such as `positive`.

    Returns:
        The constraint; its value must have equal entries.
    """
    return partial(_equal, constraint)


def _equal(constraint: Constraint, value: Any) -> Bijection:
    array = finite(value)
    if array.size < 1 or not (array == array.reshape(-1)[0]).all():
        raise ValueError(f"got {array.tolist()}, expected equal entries")
    one = constraint(array.reshape(-1)[0])
    return Bijection(
        one.size,
        lambda z: jnp.broadcast_to(one.constrain(z), array.shape),
        lambda x: one.unconstrain(jnp.asarray(x).reshape(-1)[0]),
    )


__all__ = ["bingham", "equal", "interval", "nonpositive", "positive", "real", "simplex"]
