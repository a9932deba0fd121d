"""Rotation matrices: the element is (3, 3), the tangent a rotation vector (3,), rad.

Each function goes through the quaternion, which is as right near half a turn as near none. For long products prefer
`quaternion`: `retract` there restores the length, a matrix drifts from orthogonality by an eps a step.
"""

import jax
import jax.numpy as jnp

from jaxest.manifolds import quaternion
from jaxest.manifolds._algebra import (
    left_jacobian,
    left_jacobian_inverse,
    matmul,
    right_jacobian,
    right_jacobian_inverse,
)
from jaxest.manifolds.base import as_array
from jaxest.types import Array, ArrayLike

dim = 3


def identity(dtype: jnp.dtype | None = None) -> Array:
    """Return the identity matrix (3, 3)."""
    return jnp.eye(3, dtype=dtype)


def exp(v: ArrayLike) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,), rad; raises ValueError for another shape."""
    return quaternion.to_matrix(quaternion.exp(v))


def log(x: ArrayLike) -> Array:
    """Return the rotation vector (3,), rad, at most pi long, of a rotation matrix (3, 3).

    Raises ValueError for another shape.
    """
    return quaternion.log(quaternion.from_matrix(x))


def compose(x: ArrayLike, y: ArrayLike) -> Array:
    """Return the product (3, 3) of two rotation matrices (3, 3); raises ValueError for another shape."""
    return matmul(as_array("x", x, 3, 3), as_array("y", y, 3, 3))


def inverse(x: ArrayLike) -> Array:
    """Return the transpose (3, 3) of a rotation matrix (3, 3); raises ValueError for another shape."""
    return as_array("x", x, 3, 3).T


def adjoint(x: ArrayLike) -> Array:
    """Return the adjoint (3, 3), which is the rotation matrix itself; raises ValueError for another shape."""
    return as_array("x", x, 3, 3)


def retract(x: ArrayLike, v: ArrayLike) -> Array:
    """Return `x exp(v)` (3, 3) of a matrix (3, 3) and a rotation vector (3,) in its source frame, rad."""
    return compose(x, exp(v))


def local(x: ArrayLike, y: ArrayLike) -> Array:
    """Return the rotation vector (3,), rad, that takes `x` (3, 3) to `y` (3, 3) from the right, at most pi long."""
    return log(compose(inverse(x), y))


def interpolate(x: ArrayLike, y: ArrayLike, t: ArrayLike) -> Array:
    """Return the matrix (3, 3) at the fraction `t` () of the short way from `x` to `y`, at constant speed."""
    return retract(x, t * local(x, y))


def mean(xs: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the weighted Frechet mean, as `quaternion.mean`.

    Args:
        xs: (N, 3, 3) rotation matrices.
        weights: (N,), any scale; all equal if None.

    Returns:
        (3, 3) rotation matrix.

    Raises:
        ValueError: a shape is wrong.
    """
    xs = as_array("xs", xs, None, 3, 3)
    return quaternion.to_matrix(quaternion.mean(jax.vmap(quaternion.from_matrix)(xs), weights))


__all__ = [
    "adjoint",
    "compose",
    "dim",
    "exp",
    "identity",
    "interpolate",
    "inverse",
    "left_jacobian",
    "left_jacobian_inverse",
    "local",
    "log",
    "mean",
    "retract",
    "right_jacobian",
    "right_jacobian_inverse",
]
