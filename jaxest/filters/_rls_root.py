"""Recursive least squares on a triangular factor of the information."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxest import linalg
from jaxest.types import Array, ArrayLike


class Triangle(NamedTuple):
    """Square-root information: R with R'R = P^-1, and R x."""

    root: Array
    """(n, n) upper triangular."""
    right: Array
    """(n,) R x."""


def square_root_step(state: Triangle, regressor: Array, target: Array, forgetting: ArrayLike = 1.0) -> Triangle:
    """Take in one whitened observation by orthogonal rotations of the factor.

    Args:
        state: the factor; zeros before any data.
        regressor: (m, n) O, each row divided by its observation's standard deviation.
        target: (m,) y, likewise.
        forgetting: () as in `Params`.

    Returns:
        The next factor. x = R^-1 right once R is regular.

    Source: Bierman 1977 (Factorization Methods for Discrete Sequential Estimation), section IV.
    """
    n = state.root.shape[0]
    kept = jnp.sqrt(jnp.asarray(forgetting, state.root.dtype))
    stacked = jnp.concatenate(
        [
            kept * jnp.concatenate([state.root, state.right[:, None]], axis=1),
            jnp.concatenate([regressor, target[:, None]], axis=1),
        ]
    )
    top = linalg.upper(stacked)[:n]
    return Triangle(top[:, :n], top[:, n])


__all__ = ["Triangle", "square_root_step"]
