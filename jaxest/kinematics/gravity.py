"""Joint torques that hold a robot still against gravity."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.coordinates import Links
from jaxest.kinematics.fold import fold
from jaxest.kinematics.forward import configuration, links
from jaxest.kinematics.inertia import Lump, check_inertia, lump
from jaxest.kinematics.jacobian import velocity_axes
from jaxest.kinematics.plan import Plan, plan
from jaxest.kinematics.poses import joint_poses
from jaxest.kinematics.robot import Robot
from jaxest.kinematics.sequence import Sequence, inward
from jaxest.kinematics.take import take
from jaxest.types import Array, ArrayLike


def gravity_torque(robot: Robot, q: ArrayLike) -> Array:
    """Compute the joint torques that hold the robot still against gravity.

    This is the generalised gravity g of M a + c + g = tau, MuJoCo's bias force at rest: an arm held level needs a
    torque that pushes it up.

    Args:
        robot: the robot; differentiable in its masses, centres of mass and offsets.
        q: (nq,) joint coordinates, rad or m; batch with `jax.vmap`.

    Returns:
        (nv,) N m (N for slides and a free joint's translation).

    Raises:
        ValueError: q has the wrong shape.
        InputError: a moving body has no inertia.
    """
    q = configuration(robot, q)
    check_inertia(robot)
    folded = fold(robot)
    lumps = jax.tree.map(lambda x: jnp.asarray(x, q.dtype), lump(robot, folded))
    planned = plan(robot, _carried_bodies(robot), folded).whole()
    gravity = jnp.asarray(robot.gravity, q.dtype)
    return _gravity_torque(planned, links(robot, folded, q.dtype), lumps, gravity, q)


def _carried_bodies(robot: Robot) -> tuple[int, ...]:
    """Return the body of the last joint of each joint's body: frames whose plan covers every joint."""
    return tuple(sorted(set(robot.topology.joint_body)))


@partial(jax.jit, static_argnums=0)
def _gravity_torque(planned: Plan, constants: Links, lumps: Lump, gravity: Array, q: Array) -> Array:
    order = planned.order
    if not order.joint:
        return jnp.zeros((0,), q.dtype)
    pose = joint_poses(planned, constants, q)
    rows = np.array(order.joint)
    mass = lumps.mass[rows]
    moment = c.add(c.rotate(pose.quaternion, c.split(lumps.moment[rows])), c.scale(pose.position, mass))
    mass, moment = _carried(order, mass, moment)
    axes = velocity_axes(order, constants, pose)
    mass, moment = jax.tree.map(lambda x: take(x, axes.step), (mass, moment))
    lever = c.sub(moment, c.scale(axes.point, mass))
    pull = c.split(gravity)
    torque = -(c.dot(axes.rotation, c.cross(lever, pull)) + c.dot(axes.translation, c.scale(pull, mass)))
    return take(torque, np.argsort(axes.velocity).tolist())


def _carried(order: Sequence, mass: Array, moment: c.Vector) -> tuple[Array, c.Vector]:
    """Sum mass and first moment from the tips inwards: what each joint carries, components (n,)."""

    def add(beyond: Any, own: Any) -> tuple[Any, Any]:
        total = jax.tree.map(jnp.add, beyond, own)
        return total, total

    zero = jnp.zeros((), mass.dtype)
    return inward(order, add, (zero, (zero, zero, zero)), (mass, moment))
