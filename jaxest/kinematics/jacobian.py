"""Geometric Jacobian of a frame."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.chains import Chain, Plan, plan
from jaxest.kinematics.fold import fold
from jaxest.kinematics.forward import configuration, links, place_frames, selection
from jaxest.kinematics.poses import joint_poses
from jaxest.kinematics.robot import FREE, NV, SLIDE, Robot
from jaxest.kinematics.scan import Links, Pose
from jaxest.types import Array, ArrayLike


def jacobian(robot: Robot, q: ArrayLike, frame: int | str) -> Array:
    """Compute the Jacobian from joint velocities to a frame's velocity in the world.

    Velocities are MuJoCo's: rad/s or m/s; a ball joint's angular in its body; a free joint's linear in the world, then
    angular in its body.

    Args:
        robot: the robot.
        q: (nq,) joint coordinates, rad or m; batch with `jax.vmap`.
        frame: static, a frame's index or name.

    Returns:
        (6, nv): rows rotation (rad/s), then translation of the frame's origin (m/s), along the world's axes.

    Raises:
        ValueError: q has the wrong shape, or the index is out of range.
        InputError: the frame's name does not exist.
    """
    q = configuration(robot, q)
    folded = fold(robot)
    planned = plan(robot, selection(robot, (frame,)), folded)
    offsets = jnp.asarray(folded.frame_translation, q.dtype), jnp.asarray(folded.frame_quaternion, q.dtype)
    return _jacobian(planned, robot.nv, links(robot, folded, q.dtype), offsets, q)


@partial(jax.jit, static_argnums=(0, 1))
def _jacobian(planned: Plan, nv: int, constants: Links, offsets: tuple[Array, Array], q: Array) -> Array:
    if planned.blocks[0].chain < 0:
        return jnp.zeros((6, nv), q.dtype)
    whole = planned.whole()
    poses = joint_poses(whole, constants, q)
    point = c.split(place_frames(whole, poses, offsets, whole.blocks[0])[0][0])
    columns: list[Array] = []
    at: list[int] = []
    for chain, pose in zip(whole.chains, poses, strict=True):
        rotation, translation = velocity_axes(whole, chain, constants, pose)
        arm = c.sub(tuple(p[:, None] for p in point_like(point, pose)), tuple(p[:, None] for p in pose.position))
        moved = c.add(translation, c.cross(rotation, arm))
        twist = jnp.stack((*rotation, *moved))
        for row, joint in enumerate(chain.joints):
            width = NV[whole.joint_kind[joint]]
            columns.append(twist[:, row, :width])
            at += range(whole.joint_v[joint], whole.joint_v[joint] + width)
    padded = jnp.concatenate([*columns, jnp.zeros((6, 1), q.dtype)], axis=1)
    source = np.full(nv, len(at))
    source[at] = np.arange(len(at))
    return padded[:, source]


def point_like(point: c.Vector, pose: Pose) -> c.Vector:
    """Repeat a point for every joint of a chain."""
    return tuple(jnp.broadcast_to(x, p.shape) for x, p in zip(point, pose.position, strict=True))


def velocity_axes(planned: Plan, chain: Chain, constants: Links, pose: Pose) -> tuple[c.Vector, c.Vector]:
    """Return how each velocity coordinate turns and shifts its joint's frame, in the world.

    Args:
        planned: the plan.
        chain: one of its chains.
        constants: what the poses depend on.
        pose: the poses of all joints of the chain, components (n,).

    Returns:
        rotation and translation, components (n, w) with w = 1 for a scalar chain; for balls and free joints w = 6,
        of which a ball uses the first 3.
    """
    if chain.scalar:
        axis = c.rotate(pose.quaternion, c.split(constants.axis[np.array(chain.joints)]))
        sliding = np.array([planned.joint_kind[j] == SLIDE for j in chain.joints])[:, None]
        columns: Any = tuple(a[:, None] for a in axis)
        turned, shifted = (tuple(jnp.where(mask, a, 0) for a in columns) for mask in (~sliding, sliding))
        return turned, shifted
    rotation = [[jnp.zeros_like(pose.position[0])] * 6 for _ in range(3)]
    translation = [[jnp.zeros_like(pose.position[0])] * 6 for _ in range(3)]
    free = np.array([planned.joint_kind[j] == FREE for j in chain.joints])
    zero, one = jnp.zeros_like(pose.position[0]), jnp.ones_like(pose.position[0])
    for i in range(3):
        unit: Any = tuple(one if k == i else zero for k in range(3))
        axis = c.rotate(pose.quaternion, unit)
        for k in range(3):
            rotation[k][i] = jnp.where(free, 0, axis[k])
            rotation[k][i + 3] = jnp.where(free, axis[k], 0)
            translation[k][i] = jnp.where(free, unit[k], 0)
    turned, shifted = (tuple(jnp.stack(row, -1) for row in rows) for rows in (rotation, translation))
    return turned, shifted
