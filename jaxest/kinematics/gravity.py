"""Joint torques that hold a robot still against gravity."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.chains import Plan, plan
from jaxest.kinematics.fold import fold
from jaxest.kinematics.forward import configuration, links
from jaxest.kinematics.inertia import Lump, check_inertia, lump
from jaxest.kinematics.jacobian import velocity_axes
from jaxest.kinematics.poses import joint_poses
from jaxest.kinematics.robot import NV, Robot
from jaxest.kinematics.scan import Links, Pose
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
    poses = joint_poses(planned, constants, q)
    torques: list[Array] = [jnp.zeros((0,), q.dtype)] * len(planned.joint_kind)
    above: list[Any] = [None] * len(planned.chains)
    for index in reversed(range(len(planned.chains))):
        chain, pose = planned.chains[index], poses[index]
        rows = np.array(chain.joints)
        mass = lumps.mass[rows]
        moment = c.add(c.rotate(pose.quaternion, c.split(lumps.moment[rows])), c.scale(pose.position, mass))
        carried, total = _carried(mass, moment, above[index])
        if chain.parent >= 0:
            above[chain.parent] = _sum(above[chain.parent], total)
        for joint, torque in zip(chain.joints, _hold(planned, index, constants, pose, carried, gravity), strict=True):
            torques[joint] = torque[: NV[planned.joint_kind[joint]]]
    return jnp.concatenate([*torques, jnp.zeros((0,), q.dtype)])


def _sum(a: Any, b: Any) -> Any:
    return b if a is None else jax.tree.map(jnp.add, a, b)


def _carried(mass: Array, moment: c.Vector, beyond: Any) -> tuple[Any, Any]:
    """Sum mass and first moment from each joint outwards; returns those sums and the whole chain's."""
    start = jax.tree.map(lambda x: jnp.zeros((), x.dtype), (mass, moment)) if beyond is None else beyond

    def add(total: Any, own: Any) -> tuple[Any, Any]:
        total = _sum(total, own)
        return total, total

    whole, sums = jax.lax.scan(add, start, (mass, moment), reverse=True)
    return sums, whole


def _hold(planned: Plan, index: int, constants: Links, pose: Pose, carried: Any, gravity: Array) -> Array:
    """Project the weight that each joint of a chain carries on its axes, (n, w)."""
    mass, moment = carried
    rotation, translation = velocity_axes(planned, planned.chains[index], constants, pose)
    lever = c.sub(moment, c.scale(pose.position, mass))
    pull = c.split(gravity)
    force = tuple((mass * g)[:, None] for g in pull)
    torque = tuple(t[:, None] for t in c.cross(lever, pull))
    return -(c.dot(rotation, torque) + c.dot(translation, force))
