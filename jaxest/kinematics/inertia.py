"""Masses of a robot's links, gathered on the joints that carry them."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.fold import Folded, carriers
from jaxest.kinematics.robot import Robot, is_concrete
from jaxest.types import Array, InputError


class Lump(NamedTuple):
    """Mass that a joint carries before the next joint: its own body and those fixed to it."""

    mass: Array
    """(nj,) kg."""
    moment: Array
    """(nj, 3) kg m, mass times centre of mass in the joint's frame."""
    inertia: Array
    """(nj, 3, 3) kg m2, about the joint's frame, along its axes."""


def check_inertia(robot: Robot) -> None:
    """Refuse dynamics for a robot whose inertias are unknown.

    Raises:
        InputError: names the moving bodies without inertia.
    """
    if robot.topology.massless:
        names = ", ".join(robot.topology.massless[:6])
        raise InputError(
            f"robot {robot.topology.name!r}: no inertia for {len(robot.topology.massless)} moving bodies ({names}), "
            "expected <inertial> elements or the mesh files; only its kinematics can be used"
        )


def lump(robot: Robot, folded: Folded) -> Lump:
    """Gather bodies' masses on the joints that carry them.

    Args:
        robot: the robot.
        folded: its folded offsets.

    Returns:
        Mass, first and second moment of each joint; in NumPy float64 where the robot's numbers are known.
    """
    leaves = (robot.body_mass, robot.body_com, robot.body_inertia, *folded)
    xp: Any = np if is_concrete(*leaves) else jnp
    bodies, joints = len(robot.topology.body_names), len(robot.topology.joint_names)
    mass, com, own = (xp.asarray(x) for x in (robot.body_mass, robot.body_com, robot.body_inertia))
    position, quaternion = folded.frame_translation[:bodies], folded.frame_quaternion[:bodies]
    turn = c.split(quaternion)
    centre = xp.stack(c.add(c.split(position), c.rotate(turn, c.split(com))), -1)
    columns = xp.stack([xp.stack(c.rotate(turn, unit), -1) for unit in _units(xp, mass)], -1)  # (nb, 3, 3) to the joint
    turned = xp.einsum("bij,bjk,blk->bil", columns, own, columns)
    square = (centre * centre).sum(-1)[:, None, None] * np.eye(3, dtype=mass.dtype)[None]
    spread = mass[:, None, None] * (square - centre[:, :, None] * centre[:, None, :])
    carrier = np.array(carriers(robot.topology).frame[:bodies], int)
    membership = np.equal(carrier[None, :], np.arange(joints)[:, None]).astype(mass.dtype)
    second = (membership @ (turned + spread).reshape(bodies, 9)).reshape(joints, 3, 3)
    return Lump(membership @ mass, membership @ (centre * mass[:, None]), second)


def _units(xp: Any, like: Any) -> list[c.Vector]:
    zero, one = xp.zeros_like(like), xp.ones_like(like)
    return [tuple(one if k == i else zero for k in range(3)) for i in range(3)]
