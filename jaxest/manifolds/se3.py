"""Rigid motions: the element is a `Pose`, the tangent (6,) is [rotation (rad), translation (m)].

`T_world_link` is a `Pose` that maps link coordinates to world coordinates (`apply`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.manifolds import _algebra as algebra
from jaxest.manifolds import _coefficients as coefficient
from jaxest.manifolds import quaternion
from jaxest.manifolds.base import as_array, normalized
from jaxest.types import Array, ArrayLike

dim = 6


class Pose(NamedTuple):
    """A rigid motion, or where a frame is."""

    rotation: Array
    """(4,) unit quaternion wxyz."""
    translation: Array
    """(3,) m, in the destination frame."""


def _pose(name: str, pose: Pose) -> Pose:
    rotation, translation = pose
    return Pose(as_array(f"{name}.rotation", rotation, 4), as_array(f"{name}.translation", translation, 3))


def _halves(v: ArrayLike) -> tuple[Array, Array]:
    v = as_array("v", v, 6)
    return v[:3], v[3:]


def identity(dtype: jnp.dtype | None = None) -> Pose:
    """Return the motion that moves nothing."""
    return Pose(quaternion.identity(dtype), jnp.zeros(3, dtype))


def exp(v: ArrayLike) -> Pose:
    """Return the screw motion of a twist held for unit time.

    Args:
        v: (6,) [rotation, translation], rad and m.

    Returns:
        The motion; its translation is left_jacobian(rotation) translation.

    Raises:
        ValueError: the shape is wrong.

    Source: Sola, Deray, Atchuthan 2018 (A micro Lie theory), eq. 172, with the rotation first.
    """
    phi, rho = _halves(v)
    s = algebra.dot(phi, phi)
    turned = algebra.cross(phi, rho)
    bent = coefficient.one_minus_cos(s) * turned + coefficient.t_minus_sin(s) * algebra.cross(phi, turned)
    return Pose(quaternion.exp(phi), rho + bent)


def log(x: Pose) -> Array:
    """Return the twist of a motion.

    Args:
        x: the motion.

    Returns:
        (6,) [rotation, translation], rad and m; the rotation is at most pi long.

    Raises:
        ValueError: a shape is wrong.

    Source: Sola, Deray, Atchuthan 2018, eq. 173, with the rotation first.
    """
    x = _pose("x", x)
    phi = quaternion.log(x.rotation)
    turned = algebra.cross(phi, x.translation)
    straight = coefficient.inverse_jacobian(algebra.dot(phi, phi)) * algebra.cross(phi, turned) - turned / 2
    return jnp.concatenate([phi, x.translation + straight])


def compose(x: Pose, y: Pose) -> Pose:
    """Return the motion `y` followed by `x`; raises ValueError for a wrong shape."""
    x, y = _pose("x", x), _pose("y", y)
    return Pose(quaternion.compose(x.rotation, y.rotation), apply(x, y.translation))


def inverse(x: Pose) -> Pose:
    """Return the motion back; raises ValueError for a wrong shape."""
    back = quaternion.inverse(_pose("x", x).rotation)
    return Pose(back, -quaternion.rotate(back, x.translation))


def apply(x: Pose, p: ArrayLike) -> Array:
    """Return the point `p` (3,) of the source frame in the destination frame (3,), m; raises ValueError for a shape."""
    x = _pose("x", x)
    return quaternion.rotate(x.rotation, p) + x.translation


def to_matrix(x: Pose) -> Array:
    """Return the homogeneous matrix (4, 4) of a motion; raises ValueError for a wrong shape."""
    x = _pose("x", x)
    top = jnp.concatenate([quaternion.to_matrix(x.rotation), x.translation[:, None]], axis=1)
    return jnp.concatenate([top, jnp.eye(4, dtype=top.dtype)[3:]])


def from_matrix(matrix: ArrayLike) -> Pose:
    """Return the motion of a homogeneous matrix (4, 4), whose last row is not looked at; raises ValueError."""
    matrix = as_array("matrix", matrix, 4, 4)
    return Pose(quaternion.from_matrix(matrix[:3, :3]), matrix[:3, 3])


def _lower(diagonal: Array, corner: Array) -> Array:
    """Return [[diagonal, 0], [corner, diagonal]], (6, 6)."""
    top = jnp.concatenate([diagonal, jnp.zeros_like(corner)], axis=1)
    return jnp.concatenate([top, jnp.concatenate([corner, diagonal], axis=1)])


def adjoint(x: Pose) -> Array:
    """Return the adjoint of a motion.

    Args:
        x: the motion.

    Returns:
        (6, 6) [[R, 0], [[t]x R, R]], so that x exp(v) = exp(adjoint(x) v) x.

    Raises:
        ValueError: a shape is wrong.
    """
    x = _pose("x", x)
    matrix = quaternion.to_matrix(x.rotation)
    return _lower(matrix, algebra.matmul(algebra.skew(x.translation), matrix))


def left_jacobian(v: ArrayLike) -> Array:
    """Return the left Jacobian of exp.

    Args:
        v: (6,) [rotation, translation], rad and m.

    Returns:
        (6, 6) [[J, 0], [Q, J]] with the rotation's left Jacobian J, so that exp(v + d) = exp(left_jacobian(v) d) exp(v)
        to first order in d.

    Raises:
        ValueError: the shape is wrong.

    Source: Barfoot 2017 (State estimation for robotics), eq. 7.85, where translation comes first. A twist is a dual
    rotation vector, so Q is the derivative of J along the translation, which needs none of the print's products.
    """
    phi, rho = _halves(v)
    return _lower(*jax.jvp(algebra.left_jacobian, (phi,), (rho,)))


def left_jacobian_inverse(v: ArrayLike) -> Array:
    """Return the inverse of the left Jacobian; singular only at a full turn.

    Args:
        v: (6,) [rotation, translation], rad and m.

    Returns:
        (6, 6).

    Raises:
        ValueError: the shape is wrong.

    Source: Barfoot 2017, eq. 7.95; as in `left_jacobian`, the corner is a derivative along the translation.
    """
    phi, rho = _halves(v)
    return _lower(*jax.jvp(algebra.left_jacobian_inverse, (phi,), (rho,)))


def right_jacobian(v: ArrayLike) -> Array:
    """Return the right Jacobian (6, 6) of exp at `v` (6,): exp(v + d) = exp(v) exp(right_jacobian(v) d)."""
    return left_jacobian(-as_array("v", v, 6))


def right_jacobian_inverse(v: ArrayLike) -> Array:
    """Return the inverse (6, 6) of the right Jacobian at `v` (6,); singular only at a full turn."""
    return left_jacobian_inverse(-as_array("v", v, 6))


def retract(x: Pose, v: ArrayLike) -> Pose:
    """Return `x exp(v)`, its quaternion scaled to length 1.

    Args:
        x: the motion.
        v: (6,) [rotation, translation] in the source frame of `x`, rad and m.

    Returns:
        The motion.

    Raises:
        ValueError: a shape is wrong.
    """
    rotation, translation = compose(x, exp(v))
    return Pose(quaternion.normalize(rotation), translation)


def local(x: Pose, y: Pose) -> Array:
    """Return the twist (6,) [rotation, translation] that takes `x` to `y` from the right; raises ValueError."""
    return log(compose(inverse(x), y))


def interpolate(x: Pose, y: Pose, t: ArrayLike) -> Pose:
    """Return the motion at the fraction `t` () of the screw from `x` to `y`, at constant twist; raises ValueError."""
    return retract(x, t * local(x, y))


def mean(xs: Pose, weights: ArrayLike | None = None) -> Pose:
    """Return the motion from which the weighted twists `local` sum to zero (the exponential barycenter).

    No metric on motions is invariant on both sides; this mean is, and needs none.

    Args:
        xs: poses with leaves (N, 4) and (N, 3).
        weights: (N,), any scale; all equal if None.

    Returns:
        The mean; its rotation is `quaternion.mean`'s, and given that, its translation solves a linear equation.

    Raises:
        ValueError: a shape is wrong.

    Source: Pennec, Arsigny 2013 (Exponential barycenters of the canonical Cartan connection).
    """
    rotations, translations = as_array("xs.rotation", xs[0], None, 4), as_array("xs.translation", xs[1], None, 3)
    weights = normalized(weights, rotations)
    rotation = quaternion.mean(rotations, weights)
    near = jnp.sum(weights[:, None] * translations, axis=0)

    def straighten(q: Array, p: Array) -> tuple[Array, Array]:
        bend = algebra.left_jacobian_inverse(quaternion.local(rotation, q))
        return bend, algebra.matvec(bend, quaternion.rotate(quaternion.inverse(rotation), p - near))

    bends, offsets = jax.vmap(straighten)(rotations, translations)
    slope = jnp.sum(weights[:, None, None] * bends, axis=0)
    offset = algebra.solve3(slope, jnp.sum(weights[:, None] * offsets, axis=0))
    return Pose(rotation, near + quaternion.rotate(rotation, offset))


__all__ = [
    "Pose",
    "adjoint",
    "apply",
    "compose",
    "dim",
    "exp",
    "from_matrix",
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
    "to_matrix",
]
