"""Effective joint angles from IMUs by hand, the baseline that `deflection` is measured by.

The yaw of each IMU's orientation, which drifts, is taken out by Euler angles; a joint's angle is then that of the
rotation between its two links. Which Euler angles is the user's choice, and a trap: `heading_of_x` ('xyz' in the paper)
loses the yaw where the link's x axis stands upright, `heading_of_y` ('yxz') where its y axis does.

Source: Sato 2023, section IV-D.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp

from jaxest.manifolds import quaternion as quat
from jaxest.manifolds.base import as_array
from jaxest.types import Array, ArrayLike

Heading = Callable[[Array], Array]
"""`(quaternion (4,)) -> () rad`, the yaw to take out."""


class Hinge(NamedTuple):
    """A joint whose angle is taken from IMUs; static."""

    joint: int
    """Its coordinate."""
    child: int
    """Number of the IMU on the link that it moves."""
    parent: int | None = None
    """Number of the IMU on the link that carries it; None for a link that does not tilt."""
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """Unit vector in the links' frames."""


def heading_of_x(quaternion: ArrayLike) -> Array:
    """Return the yaw () rad of a rotation (4,) wxyz about the fixed x, then y, then z ('xyz'): where its x axis points.

    Without meaning where the x axis stands upright, y at +-90 deg (gimbal lock), and half a turn off beyond.
    """
    east, north, _ = quat.rotate(as_array("quaternion", quaternion, 4), jnp.array([1, 0, 0], _dtype(quaternion)))
    return jnp.arctan2(north, east)


def heading_of_y(quaternion: ArrayLike) -> Array:
    """Return the yaw () rad of a rotation (4,) wxyz about the fixed y, then x, then z ('yxz'): where its y axis points.

    Without meaning where the y axis stands upright, x at +-90 deg (gimbal lock), and half a turn off beyond.
    """
    east, north, _ = quat.rotate(as_array("quaternion", quaternion, 4), jnp.array([0, 1, 0], _dtype(quaternion)))
    return jnp.arctan2(-east, north)


def without_yaw(quaternion: ArrayLike, heading: Heading = heading_of_y) -> Array:
    """Return an orientation with its yaw set to 0.

    Args:
        quaternion: (4,) wxyz, link to world.
        heading: how the yaw is told.

    Returns:
        (4,) wxyz.
    """
    q = as_array("quaternion", quaternion, 4)
    half = -heading(q) / 2
    zero = jnp.zeros((), q.dtype)
    return quat.compose(jnp.stack([jnp.cos(half), zero, zero, jnp.sin(half)]), q)


def angle_between(parent: ArrayLike, child: ArrayLike, axis: ArrayLike) -> Array:
    """Return by which angle a joint turns the child against the parent.

    Args:
        parent: (4,) wxyz, link to world.
        child: (4,) wxyz, link to world.
        axis: (3,) unit vector, the joint's.

    Returns:
        () rad in [-pi, pi], the angle of the whole rotation with the axis's sign.
    """
    between = quat.compose(quat.inverse(as_array("parent", parent, 4)), as_array("child", child, 4))
    along = jnp.sum(between[1:] * jnp.asarray(axis, between.dtype))
    square = jnp.sum(between[1:] * between[1:])
    turned = square > 0  # the root's slope is infinite at no turn
    size = jnp.where(turned, jnp.sqrt(jnp.where(turned, square, 1)), 0)
    sign = jnp.where(between[0] * along < 0, -1, 1).astype(between.dtype)
    return 2 * sign * jnp.arctan2(size, jnp.abs(between[0]))


def fuse(
    reference: ArrayLike, orientations: ArrayLike, hinges: Sequence[Hinge], heading: Heading = heading_of_y
) -> Array:
    """Replace the angles of some joints by what IMUs say.

    Args:
        reference: (d,) rad, of the encoders.
        orientations: (n, 4) wxyz, link to world, of the links with an IMU.
        hinges: the joints to replace; the others keep the reference.
        heading: how the yaw is told.

    Returns:
        (d,) rad.

    Source: Sato 2023, section IV-D, steps 2 to 5; the angle carries the sign of the joint's axis.
    """
    angles = as_array("reference", reference, None)
    turned = [without_yaw(q, heading) for q in as_array("orientations", orientations, None, 4)]
    level = quat.identity(angles.dtype)
    for hinge in hinges:
        parent = level if hinge.parent is None else turned[hinge.parent]
        angles = angles.at[hinge.joint].set(
            angle_between(parent, turned[hinge.child], jnp.array(hinge.axis, angles.dtype))
        )
    return angles


def _dtype(x: ArrayLike) -> jnp.dtype:
    return jnp.result_type(x)


__all__ = ["Heading", "Hinge", "angle_between", "fuse", "heading_of_x", "heading_of_y", "without_yaw"]
