"""Several frames with their Jacobians at once: one pass over the robot instead of one for each frame."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.coordinates import Links
from jaxest.kinematics.fold import fold
from jaxest.kinematics.forward import Frames, configuration, links, place_frames, selection
from jaxest.kinematics.jacobian import velocity_axes
from jaxest.kinematics.plan import Plan, plan
from jaxest.kinematics.poses import joint_poses
from jaxest.kinematics.robot import Robot
from jaxest.kinematics.take import take
from jaxest.types import Array, ArrayLike


class Moving(NamedTuple):
    """Frames, and how joint velocities move them."""

    frames: Frames
    jacobian: Array
    """(n, 6, k) rows rotation (rad/s) and translation of the origin (m/s), along the world's axes."""


def moving_frames(
    robot: Robot, q: ArrayLike, frames: Sequence[int | str], velocities: Sequence[int] | None = None
) -> Moving:
    """Compute the poses of frames and their Jacobians.

    Args:
        robot: the robot.
        q: (nq,) joint coordinates, rad or m; batch with `jax.vmap`.
        frames: static selection of frames by index or name.
        velocities: static, the k coordinates of v whose columns are wanted; all of them if None.

    Returns:
        Poses of the n frames as `forward` has them, and what `jacobian` gives for each, with k columns.

    Raises:
        ValueError: q has the wrong shape, or an index is out of range.
        InputError: a frame's name does not exist.
    """
    q = configuration(robot, q)
    folded = fold(robot)
    planned = plan(robot, selection(robot, frames), folded).whole()
    offsets = jnp.asarray(folded.frame_translation, q.dtype), jnp.asarray(folded.frame_quaternion, q.dtype)
    columns = tuple(range(robot.nv)) if velocities is None else tuple(velocities)
    return _moving(planned, columns, links(robot, folded, q.dtype), offsets, q)


@partial(jax.jit, static_argnums=(0, 1))
def _moving(
    planned: Plan, columns: tuple[int, ...], constants: Links, offsets: tuple[Array, Array], q: Array
) -> Moving:
    count = len(planned.frames)
    if not planned.order.joint:
        position, quaternion = place_frames(planned, joint_poses(planned, constants, q), offsets)
        return Moving(Frames(jnp.stack(position, -1), jnp.stack(quaternion, -1)), jnp.zeros((count, 6, 0), q.dtype))
    poses = joint_poses(planned, constants, q)
    position, quaternion = place_frames(planned, poses, offsets)
    axes = velocity_axes(planned.order, constants, poses)
    where = {v: row for row, v in enumerate(axes.velocity)}
    source = [where.get(v, -1) for v in columns]
    turn, shift, point = jax.tree.map(lambda x: take(x, source), (axes.rotation, axes.translation, axes.point))
    moves = jnp.asarray(_reach(planned, axes.step, source))

    def over(x: Array) -> Array:
        return jnp.broadcast_to(x[None], moves.shape)

    turn, shift, point = jax.tree.map(over, (turn, shift, point))
    lever = c.sub(tuple(jnp.broadcast_to(p[:, None], moves.shape) for p in position), point)
    moved = (*turn, *c.add(shift, c.cross(turn, lever)))
    jacobian = jnp.stack([jnp.where(moves, x, 0) for x in moved], 1)
    return Moving(Frames(jnp.stack(position, -1), jnp.stack(quaternion, -1)), jacobian)


def _reach(planned: Plan, steps: tuple[int, ...], source: Sequence[int]) -> np.ndarray:
    """Tell which columns' joints lie between each frame and the world, (n, k)."""
    reach = np.zeros((len(planned.frames), len(source)), bool)
    for row, last in enumerate(planned.rows):
        step, before = last, set()
        while step >= 0:
            before.add(step)
            step = planned.order.parent[step]
        reach[row] = [at >= 0 and steps[at] in before for at in source]
    return reach


__all__ = ["Moving", "moving_frames"]
