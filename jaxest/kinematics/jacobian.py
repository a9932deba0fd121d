"""Geometric Jacobian of a frame."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.coordinates import Links, only
from jaxest.kinematics.fold import fold
from jaxest.kinematics.forward import configuration, links, place_frames, selection
from jaxest.kinematics.plan import Plan, plan
from jaxest.kinematics.poses import joint_poses
from jaxest.kinematics.robot import FREE, HINGE, NV, SLIDE, Robot
from jaxest.kinematics.scan import Pose
from jaxest.kinematics.sequence import Sequence
from jaxest.kinematics.take import take
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
    planned = plan(robot, selection(robot, (frame,)), folded).whole()
    offsets = jnp.asarray(folded.frame_translation, q.dtype), jnp.asarray(folded.frame_quaternion, q.dtype)
    return _jacobian(planned, robot.nv, links(robot, folded, q.dtype), offsets, q)


@partial(jax.jit, static_argnums=(0, 1))
def _jacobian(planned: Plan, nv: int, constants: Links, offsets: tuple[Array, Array], q: Array) -> Array:
    if planned.rows[0] < 0:
        return jnp.zeros((6, nv), q.dtype)
    poses = joint_poses(planned, constants, q)
    point = place_frames(planned, poses, offsets)[0]
    axes = velocity_axes(planned.order, constants, poses)
    moved = c.add(axes.translation, c.cross(axes.rotation, c.sub(point, axes.point)))
    source = np.full(nv, -1)
    source[list(axes.velocity)] = np.arange(len(axes.velocity))
    return jnp.stack([take(x, source.tolist()) for x in (*axes.rotation, *moved)])


class Axes(NamedTuple):
    """How velocity coordinates turn and shift their joints' frames, in the world: components (m,)."""

    rotation: c.Vector
    translation: c.Vector
    point: c.Vector
    """m, the joint's origin."""
    step: tuple[int, ...]
    """The step of each coordinate's joint."""
    velocity: tuple[int, ...]
    """Where each coordinate stands in v."""


def velocity_axes(order: Sequence, constants: Links, pose: Pose) -> Axes:
    """Return how each velocity coordinate turns and shifts its joint's frame, in the world.

    Args:
        order: the steps, one per joint.
        constants: what the poses depend on.
        pose: the poses of all joints, components (n,).

    Returns:
        A row per velocity coordinate, m of them.
    """
    rows = [(step, joint, k) for step, joint in enumerate(order.joint) for k in range(NV[order.joint_kind[joint]])]
    steps, joints, places = (tuple(row[i] for row in rows) for i in range(3))
    kind = [order.joint_kind[joint] for joint in joints]
    single = np.array([k in (HINGE, SLIDE) for k in kind])
    unit = np.eye(3)[np.array(places) % 3]
    local = tuple(
        jnp.where(single, a, u.astype(a.dtype))
        for a, u in zip(c.split(constants.axis[np.array(joints)]), unit.T, strict=True)
    )
    point, quaternion = jax.tree.map(lambda x: take(x, steps), tuple(pose))
    axis = c.rotate(quaternion, local)
    slides = np.array([k == SLIDE for k in kind])
    drifts = np.array([k == FREE and place < 3 for k, place in zip(kind, places, strict=True)])
    rotation = tuple(only(~(slides | drifts), a) for a in axis)
    translation = tuple(
        jnp.where(drifts, u.astype(a.dtype), only(slides, a)) for a, u in zip(axis, unit.T, strict=True)
    )
    velocity = tuple(v + k for v, k in zip((order.velocity[s] for s in steps), places, strict=True))
    return Axes(rotation, translation, point, steps, velocity)
