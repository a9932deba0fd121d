"""Three-vectors and the Jacobians of the rotation vector, shared by the quaternion, SO(3) and SE(3)."""

from functools import reduce
from operator import add

import jax
import jax.numpy as jnp

from jaxest.manifolds import _coefficients as coefficient
from jaxest.manifolds.base import as_array
from jaxest.types import Array, ArrayLike


def dot(a: Array, b: Array) -> Array:
    """Return the sum of the products of two vectors."""
    return jnp.sum(a * b)


def cross(a: Array, b: Array) -> Array:
    """Return a x b, (3,)."""
    (ax, ay, az), (bx, by, bz) = a, b
    return jnp.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def skew(v: Array) -> Array:
    """Return the matrix (3, 3) with `skew(v) @ p == cross(v, p)`; axes behind those of `v` (3,) are batches."""
    x, y, z = v
    zero = jnp.zeros_like(x)
    found: Array = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape((3, 3, *x.shape))
    return found


def matvec(a: Array, v: Array) -> Array:
    """Return `a @ v`; written out, for on a CPU a reduction over the last axis takes 6 times as long."""
    return reduce(add, (a[:, k] * v[k] for k in range(len(v))))


def matmul(a: Array, b: Array) -> Array:
    """Return `a @ b` in full precision: a GPU rounds the factors of a float32 product to 10 bits by default.

    A real matrix product on purpose: XLA fuses elementwise ones and computes the first factors of a chain again and
    again.
    """
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


def solve3(a: Array, b: Array) -> Array:
    """Return x with `a x = b` for a (3, 3) by Cramer's rule; finite where `a` is singular."""
    x, y, z = a[:, 0], a[:, 1], a[:, 2]
    rows = jnp.stack([cross(y, z), cross(z, x), cross(x, y)])
    det = dot(x, rows[0])
    return matvec(rows, b) / jnp.where(det == 0, 1.0, det)


def _skew_polynomial(v: Array, s: Array, linear: Array | float, quadratic: Array) -> Array:
    """Return I + linear [v]x + quadratic [v]x^2, (3, 3)."""
    square = v[:, None] * v[None, :] - s * jnp.eye(3, dtype=v.dtype)
    return jnp.eye(3, dtype=v.dtype) + linear * skew(v) + quadratic * square


def left_jacobian(v: ArrayLike) -> Array:
    """Return the left Jacobian of the rotation's exp.

    Args:
        v: (3,) rotation vector, rad.

    Returns:
        (3, 3), so that exp(v + d) = exp(left_jacobian(v) d) exp(v) to first order in d.

    Raises:
        ValueError: the shape is wrong.

    Source: Sola, Deray, Atchuthan 2018 (A micro Lie theory), eq. 145.
    """
    v = as_array("v", v, 3)
    s = dot(v, v)
    return _skew_polynomial(v, s, coefficient.one_minus_cos(s), coefficient.t_minus_sin(s))


def left_jacobian_inverse(v: ArrayLike) -> Array:
    """Return the inverse of the left Jacobian; singular only at a full turn.

    Args:
        v: (3,) rotation vector, rad.

    Returns:
        (3, 3).

    Raises:
        ValueError: the shape is wrong.

    Source: Sola, Deray, Atchuthan 2018, eq. 146, with the half angle so that a half turn is no exception.
    """
    v = as_array("v", v, 3)
    s = dot(v, v)
    return _skew_polynomial(v, s, -0.5, coefficient.inverse_jacobian(s))


def right_jacobian(v: ArrayLike) -> Array:
    """Return the right Jacobian of the rotation's exp.

    Args:
        v: (3,) rotation vector, rad.

    Returns:
        (3, 3), so that exp(v + d) = exp(v) exp(right_jacobian(v) d) to first order in d.

    Raises:
        ValueError: the shape is wrong.

    Source: Sola, Deray, Atchuthan 2018, eq. 143.
    """
    return left_jacobian(-as_array("v", v, 3))


def right_jacobian_inverse(v: ArrayLike) -> Array:
    """Return the inverse of the right Jacobian; singular only at a full turn.

    Args:
        v: (3,) rotation vector, rad.

    Returns:
        (3, 3).

    Raises:
        ValueError: the shape is wrong.

    Source: Sola, Deray, Atchuthan 2018, eq. 144.
    """
    return left_jacobian_inverse(-as_array("v", v, 3))


__all__ = [
    "cross",
    "dot",
    "left_jacobian",
    "left_jacobian_inverse",
    "matmul",
    "matvec",
    "right_jacobian",
    "right_jacobian_inverse",
    "skew",
    "solve3",
]
