"""Angles of single joints from the rotation between their links' sensors."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.manifolds import quaternion as quat
from jaxest.types import Array, ArrayLike

GIMBAL = 1e-3  # rad from +-90 deg, below which roll and yaw of float32 input cannot be told apart


class RollPitchYaw(NamedTuple):
    """Angles of R = R_z(yaw) R_y(pitch) R_x(roll)."""

    roll: Array
    """() rad, psi of the paper, in (-pi, pi]."""
    pitch: Array
    """() rad, theta, in [-pi/2, pi/2]."""
    yaw: Array
    """() rad, phi, in (-pi, pi]."""
    gimbal: Array
    """() bool, whether the pitch is so near +-90 degrees that only the sum or difference of roll and yaw has a meaning;
    roll is then 0, and yaw carries it."""


def roll_pitch_yaw(rotation: ArrayLike) -> RollPitchYaw:
    """Return roll, pitch and yaw of a rotation.

    Args:
        rotation: (4,) unit quaternion wxyz.

    Returns:
        The angles, each by atan2, so that it is right in all four quadrants.

    Raises:
        ValueError: the shape is wrong.

    Source: Santaera 2015, eqs. 21 and 22, with atan2.
    """
    r = quat.to_matrix(rotation)
    flat = r[2, 1] ** 2 + r[2, 2] ** 2
    gimbal = flat < GIMBAL**2
    safe = jnp.where(gimbal, 1, flat)
    pitch = jnp.arctan2(-r[2, 0], jnp.where(gimbal, 0, jnp.sqrt(safe)))
    roll = jnp.where(gimbal, 0, jnp.arctan2(jnp.where(gimbal, 0, r[2, 1]), jnp.where(gimbal, 1, r[2, 2])))
    y, x = jnp.where(gimbal, -r[0, 1], r[1, 0]), jnp.where(gimbal, r[1, 1], r[0, 0])
    return RollPitchYaw(roll, pitch, jnp.arctan2(y, x), gimbal)


def hinge_angle(rotation: ArrayLike, axis: ArrayLike) -> Array:
    """Return the signed angle about an axis: the turn about it that comes nearest to a rotation.

    With `rotation` = R_o' R_n (the sensors' rotation now, seen from the zero posture) and the axis in the second
    sensor's frame this is the joint's angle, however the sensors are mounted; eq. 24 needs parallel ones.

    Args:
        rotation: (4,) unit quaternion wxyz.
        axis: (3,) unit vector.

    Returns:
        () rad, in (-pi, pi]; 0 for half a turn about an axis across, where no angle is nearest.

    Raises:
        ValueError: a shape is wrong.

    Source: the twist of the swing-twist decomposition.
    """
    q, axis = jnp.asarray(rotation), jnp.asarray(axis)
    if q.shape != (4,) or axis.shape != (3,):
        raise ValueError(f"rotation, axis: got shapes {q.shape} and {axis.shape}, expected (4,) and (3,)")
    along = jnp.sum(axis * q[1:])
    some = along * along + q[0] * q[0] > 16 * float(jnp.finfo(q.dtype).eps) ** 2
    half = jnp.arctan2(jnp.where(some, along, 0), jnp.where(some, q[0], 1))
    return 2 * half - 2 * np.pi * jnp.round(half / np.pi)


def since_zero(zero: ArrayLike, now: ArrayLike) -> Array:
    """Return R_o' R_n: how the sensors' rotation has changed since the zero posture, in the second sensor's frame.

    Args:
        zero: (4,) unit quaternion, R_o.
        now: (4,) unit quaternion, R_n.

    Returns:
        (4,) unit quaternion.

    Source: Santaera 2015, eq. 25.
    """
    return quat.compose(quat.inverse(zero), now)


__all__ = ["GIMBAL", "RollPitchYaw", "hinge_angle", "roll_pitch_yaw", "since_zero"]
