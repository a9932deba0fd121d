"""Forward kinematics: poses of frames from joint coordinates."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.coordinates import Links
from jaxest.kinematics.fold import Folded, fold
from jaxest.kinematics.plan import Plan, plan
from jaxest.kinematics.poses import joint_poses
from jaxest.kinematics.robot import Robot, frame
from jaxest.kinematics.scan import Pose
from jaxest.kinematics.take import take
from jaxest.types import Array, ArrayLike


class Frames(NamedTuple):
    """Poses of frames in the world."""

    position: Array
    """(n, 3) m."""
    quaternion: Array
    """(n, 4) wxyz, frame to world."""


def forward(robot: Robot, q: ArrayLike, frames: Sequence[int | str] | None = None) -> Frames:
    """Compute the poses of frames.

    One configuration; batch it with `jax.vmap`. Close over the robot where its numbers are fixed (they are then folded
    into constants); pass it as an argument where they are tuned.

    Args:
        robot: the robot.
        q: (nq,) joint coordinates, rad or m; quaternions of ball and free joints wxyz, normalised on use.
        frames: static selection of frames by index or name; all of them, in the order of `robot.frame_names`, if None.

    Returns:
        Positions (n, 3) in m and quaternions (n, 4) wxyz of the n frames in the world, of the dtype of q.

    Raises:
        ValueError: q has the wrong shape, or an index is out of range.
        InputError: a frame's name does not exist.
    """
    q = configuration(robot, q)
    folded = fold(robot)
    planned = plan(robot, selection(robot, frames), folded)
    offsets = jnp.asarray(folded.frame_translation, q.dtype), jnp.asarray(folded.frame_quaternion, q.dtype)
    return _forward(planned, links(robot, folded, q.dtype), offsets, q)


def configuration(robot: Robot, q: ArrayLike) -> Array:
    """Check one configuration's shape and make it floating point."""
    q = jnp.asarray(q)
    if q.shape != (robot.nq,):
        raise ValueError(f"q: shape {q.shape}, expected ({robot.nq},); batch with jax.vmap")
    return q if jnp.issubdtype(q.dtype, jnp.floating) else q.astype(float)


def selection(robot: Robot, frames: Sequence[int | str] | None) -> tuple[int, ...]:
    """Turn a selection of frames into indices."""
    count = len(robot.frame_names)
    if isinstance(frames, (str, int)):
        raise ValueError(f"frames: got {frames!r}, expected a sequence of indices or names, such as [{frames!r}]")
    if frames is None:
        return tuple(range(count))
    indices = tuple(frame(robot, f) if isinstance(f, str) else int(f) for f in frames)
    for index in indices:
        if not 0 <= index < count:
            raise ValueError(f"frames: index {index}, expected 0 to {count - 1}")
    return indices


def links(robot: Robot, folded: Folded, dtype: Any) -> Links:
    """Cast the folded constants that the joints' poses depend on."""
    numbers = (folded.translation, folded.quaternion, folded.axis, robot.joint_reference)
    return Links(*(jnp.asarray(x, dtype) for x in numbers))


@partial(jax.jit, static_argnums=0)
def _forward(planned: Plan, constants: Links, offsets: tuple[Array, Array], q: Array) -> Frames:
    if not planned.frames:
        return Frames(jnp.zeros((0, 3), q.dtype), jnp.zeros((0, 4), q.dtype))
    moved = _by_joint(planned)
    if _mostly(moved, planned):
        position, quaternion = place_frames(planned, joint_poses(planned, constants, q), offsets)
        return Frames(jnp.stack(position, -1), jnp.stack(quaternion, -1))
    pose = joint_poses(planned._replace(stacked=True), constants, q)
    if moved:
        own = _take(Pose(c.split(pose.position), c.split(pose.quaternion)), [planned.rows[i] for i in moved])
        placed = Pose(*_offset(own, offsets, [planned.frames[i] for i in moved])).stacked()
        pose = jax.tree.map(lambda *parts: jnp.concatenate(parts), pose, placed)
    rows = _rows_after(planned, moved)
    return Frames(take(pose.position, rows), take(pose.quaternion, rows, np.array(c.IDENTITY)))


def place_frames(planned: Plan, pose: Pose, offsets: tuple[Array, Array]) -> tuple[c.Vector, c.Quaternion]:
    """Place the frames on the joints' poses.

    Args:
        planned: the plan.
        pose: the joints' poses, as the plan wants them.
        offsets: (nf, 3) and (nf, 4), all frames in their joints' frames.

    Returns:
        Positions and quaternions by component, (n,).
    """
    rows, moved = planned.rows, _by_joint(planned)
    if not moved:
        return _take(pose, rows)
    if _mostly(moved, planned):  # then all: a frame on its joint comes out the same
        return _offset(_take(pose, rows), offsets, planned.frames)
    placed = _offset(_take(pose, [rows[i] for i in moved]), offsets, [planned.frames[i] for i in moved])
    both = jax.tree.map(lambda *parts: jnp.concatenate(parts), pose, Pose(*placed))
    return _take(both, _rows_after(planned, moved))


def _mostly(moved: Sequence[int], planned: Plan) -> bool:
    """Tell whether so many frames are not their joints' own that all of them are placed alike."""
    return 5 * len(moved) > 2 * len(planned.rows) or (bool(moved) and not planned.kept)


def _rows_after(planned: Plan, moved: Sequence[int]) -> list[int]:
    """Return where each frame stands when the moved ones follow the joints' own poses."""
    there = {i: len(planned.kept) + place for place, i in enumerate(moved)}
    return [there.get(i, row) for i, row in enumerate(planned.rows)]


def _take(pose: Pose, rows: Sequence[int]) -> tuple[c.Vector, c.Quaternion]:
    """Take rows of a pose's components; -1 is the world."""
    position = tuple(take(x, rows) for x in pose.position)
    return position, tuple(take(x, rows, i) for x, i in zip(pose.quaternion, c.IDENTITY, strict=True))


def _offset(pose: tuple[c.Vector, c.Quaternion], offsets: tuple[Array, Array], frames: Sequence[int]) -> Any:
    """Put frames, fixed to joints, where these are."""
    position, quaternion = pose
    rows = np.array(frames)
    return (
        c.add(position, c.rotate(quaternion, c.split(offsets[0][rows]))),
        c.multiply(quaternion, c.split(offsets[1][rows])),
    )


def _by_joint(planned: Plan) -> list[int]:
    """Return which frames are not their joints' own: first one of each joint, then a second of each, and so on.

    In this order they are taken from few runs of consecutive joints.
    """
    seen: dict[int, int] = {}
    order: list[tuple[int, int, int]] = []
    for i, row in enumerate(planned.rows):
        if planned.moved[i]:
            order.append((seen.get(row, 0), row, i))
            seen[row] = seen.get(row, 0) + 1
    return [i for _, _, i in sorted(order)]
