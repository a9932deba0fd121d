"""Forward kinematics as scans along chains, with the geometric Jacobian as its derivative."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from jaxest.kinematics import components as c
from jaxest.kinematics.chains import Block, Chain, Plan, plan
from jaxest.kinematics.fold import Folded, fold
from jaxest.kinematics.robot import FREE, SLIDE, Robot, frame
from jaxest.types import Array, ArrayLike


class Frames(NamedTuple):
    """Poses of frames in the world."""

    position: Array
    """(n, 3) m."""
    quaternion: Array
    """(n, 4) wxyz, frame to world."""


class Pose(NamedTuple):
    """Pose of joints' frames by component; each component () or (n,) along a chain."""

    position: c.Vector
    quaternion: c.Quaternion


class Links(NamedTuple):
    """What the joints' poses depend on besides q."""

    translation: Array
    """(nj, 3) m."""
    quaternion: Array
    """(nj, 4)."""
    axis: Array
    """(nj, 3)."""
    reference: Array
    """(nq,)."""


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
    poses = joint_poses(planned, constants, q)
    parts = [_assemble(planned, poses, offsets, block, q.dtype) for block in planned.blocks]
    if not parts:
        return Frames(jnp.zeros((0, 3), q.dtype), jnp.zeros((0, 4), q.dtype))
    return Frames(*(jnp.concatenate(columns) if len(columns) > 1 else columns[0] for columns in zip(*parts, strict=True)))


def _assemble(
    planned: Plan, poses: tuple[Pose, ...], offsets: tuple[Array, Array], block: Block, dtype: Any
) -> tuple[Array, Array]:
    rows = np.array(block.frames)
    if block.chain < 0:
        return offsets[0][rows], offsets[1][rows]
    chain = planned.chains[block.chain]
    pose = poses[block.chain]
    pick = partial(_pick, every=chain.every, places=block.places)
    position, quaternion = jax.tree.map(pick, (pose.position, pose.quaternion))
    if block.moved:
        position = c.add(position, c.rotate(quaternion, c.split(offsets[0][rows])))
        quaternion = c.multiply(quaternion, c.split(offsets[1][rows]))
    return jnp.stack(position, -1), jnp.stack(quaternion, -1)


def _pick(component: Array, *, every: bool, places: tuple[int, ...]) -> Array:
    """Take the entries of a chain's component at some places, as (n,)."""
    if not every:
        return jnp.broadcast_to(component, (len(places),))
    if places == tuple(range(component.shape[0])):
        return component
    if places == tuple(range(places[0], places[-1] + 1)):
        return component[places[0] : places[-1] + 1]
    return component[np.array(places)]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def joint_poses(planned: Plan, constants: Links, q: Array) -> tuple[Pose, ...]:
    """Compute the poses of the joints' frames in the world, a `Pose` per chain.

    Args:
        planned: the plan.
        constants: what the poses depend on besides q.
        q: (nq,).

    Returns:
        For each chain the pose of its last joint, components (), or of every joint, components (n,).
    """
    poses: list[Pose] = []
    ends: list[Pose] = []
    for chain in planned.chains:
        start = _start(ends, chain, q.dtype)
        scan = _scalar_chain if chain.scalar else _quaternion_chain
        end, every = scan(planned, chain, constants, q, start)
        ends.append(end)
        poses.append(every if chain.every else end)
    return tuple(poses)


def _start(ends: list[Pose], chain: Chain, dtype: Any) -> Pose:
    if chain.parent >= 0:
        return ends[chain.parent]
    zero, one = jnp.zeros((), dtype), jnp.ones((), dtype)
    return Pose((zero, zero, zero), (one, zero, zero, zero))


def _compose(pose: Pose, translation: c.Vector, quaternion: c.Quaternion) -> Pose:
    return Pose(
        c.add(pose.position, c.rotate(pose.quaternion, translation)), c.multiply(pose.quaternion, quaternion)
    )


def _scalar_chain(planned: Plan, chain: Chain, constants: Links, q: Array, start: Pose) -> tuple[Pose, Any]:
    translation, fixed, turn, slide = _scalar_constants(planned, chain, constants)
    x, sine, cosine = _scalar_coordinates(planned, chain, constants, q)

    def link(pose: Pose, now: Any) -> tuple[Pose, Pose | None]:
        translation, fixed, turn, slide, x, sine, cosine = now
        rotation = tuple(f * cosine + t * sine for f, t in zip(fixed, turn, strict=True))
        if chain.slides:
            translation = c.add(translation, c.scale(slide, x))
        pose = _compose(pose, translation, rotation)
        return pose, pose if chain.every else None

    return jax.lax.scan(link, start, (translation, fixed, turn, slide, x, sine, cosine))


def _scalar_coordinates(planned: Plan, chain: Chain, constants: Links, q: Array) -> tuple[Array, Array, Array]:
    """Return the displacement from the reference and the half angle's sine and cosine, (n,) each."""
    at = _columns(q, [planned.joint_q[j] for j in chain.joints])
    x = at - _columns(constants.reference, [planned.joint_q[j] for j in chain.joints])
    if not chain.slides:
        return (x, *c.half_sincos(x))
    hinge = np.array([planned.joint_kind[j] != SLIDE for j in chain.joints])
    return (x, *c.half_sincos(jnp.where(hinge, x, 0)))


def _scalar_constants(planned: Plan, chain: Chain, constants: Links) -> tuple[Any, Any, Any, Any]:
    """Return translation, rotation at the reference, its product with the axis, and the slide's direction."""
    rows = np.array(chain.joints)
    translation, quaternion = c.split(constants.translation[rows]), c.split(constants.quaternion[rows])
    axis = c.split(constants.axis[rows])
    turn = c.multiply(quaternion, (jnp.zeros_like(axis[0]), *axis))
    if not chain.slides:
        return translation, quaternion, turn, None
    sliding = np.array([planned.joint_kind[j] == SLIDE for j in chain.joints])
    turn = tuple(jnp.where(sliding, 0, t) for t in turn)
    slide = tuple(jnp.where(sliding, s, 0) for s in c.rotate(quaternion, axis))
    return translation, quaternion, turn, slide


def _columns(vector: Array, at: list[int]) -> Array:
    """Take entries of a vector, as a slice where they are consecutive."""
    if at == list(range(at[0], at[-1] + 1)):
        return vector[at[0] : at[-1] + 1]
    return vector[np.array(at)]


def _quaternion_chain(planned: Plan, chain: Chain, constants: Links, q: Array, start: Pose) -> tuple[Pose, Any]:
    rows = np.array(chain.joints)
    position, unit, _ = quaternion_coordinates(planned, chain, q)
    rotation = c.multiply(c.split(constants.quaternion[rows]), unit)
    translation = c.add(c.split(constants.translation[rows]), position)

    def link(pose: Pose, now: Any) -> tuple[Pose, Pose | None]:
        pose = _compose(pose, *now)
        return pose, pose if chain.every else None

    return jax.lax.scan(link, start, (translation, rotation))


def quaternion_coordinates(planned: Plan, chain: Chain, q: Array) -> tuple[c.Vector, c.Quaternion, Array]:
    """Return free joints' positions (0 for balls), the unit quaternions, and the norms they had, (n,) each."""
    free = np.array([planned.joint_kind[j] == FREE for j in chain.joints])
    at = np.array([planned.joint_q[j] for j in chain.joints])
    turn = at + np.where(free, 3, 0)
    raw = tuple(q[turn + i] for i in range(4))
    square = raw[0] ** 2 + raw[1] ** 2 + raw[2] ** 2 + raw[3] ** 2
    good = square > jnp.finfo(q.dtype).tiny
    norm = jnp.sqrt(jnp.where(good, square, 1))
    unit = tuple(jnp.where(good, r, i) / norm for r, i in zip(raw, c.IDENTITY, strict=True))
    position = tuple(jnp.where(free, q[at + i], 0) for i in range(3))
    return position, unit, norm


@partial(joint_poses.defjvp, symbolic_zeros=True)
def _joint_poses_jvp(planned: Plan, primals: tuple[Links, Array], tangents: Any) -> tuple[Any, Any]:
    """Move every joint's frame by the twists of the joints before it.

    The derivative of a chain of transforms is a running sum of world twists about the origin, which XLA handles in
    one pass in either direction; differentiating the scan itself costs twice as much.
    """
    constants, q = primals
    constants_dot, q_dot = tangents
    whole = joint_poses(planned.whole(), constants, q)
    moves: list[tuple[c.Vector, c.Vector]] = []
    poses: list[Pose] = []
    poses_dot: list[Pose] = []
    for index, (chain, pose) in enumerate(zip(planned.chains, whole, strict=True)):
        twists = _chain_twists(planned, index, whole, constants, q, constants_dot, q_dot)
        start = moves[chain.parent] if chain.parent >= 0 else None
        every, end = _running_sum(twists, start, chain.every)
        moves.append(end)
        last = jax.tree.map(lambda x: x[-1], pose)
        poses.append(pose if chain.every else last)
        poses_dot.append(_moved(poses[-1], *(every if chain.every else end)))
    return tuple(poses), tuple(poses_dot)


def _moved(pose: Pose, rotation: c.Vector, translation: c.Vector) -> Pose:
    """Return the rate of a pose under a world twist about the origin."""
    half = c.scale(rotation, 0.5)
    return Pose(
        c.add(translation, c.cross(rotation, pose.position)),
        c.multiply((jnp.zeros_like(half[0]), *half), pose.quaternion),
    )


def _running_sum(twists: Any, start: Any, every: bool) -> tuple[Any, Any]:
    """Sum twists along a chain, from what its parent moves by; every partial sum only where it is needed."""
    if not every:
        total = jax.tree.map(lambda x: x.sum(0), twists)
        return None, total if start is None else jax.tree.map(jnp.add, start, total)
    if start is None:
        start = jax.tree.map(lambda x: jnp.zeros((), x.dtype), twists)

    def add(total: Any, now: Any) -> tuple[Any, Any]:
        total = jax.tree.map(jnp.add, total, now)
        return total, total

    end, sums = jax.lax.scan(add, start, twists)
    return sums, end


def _chain_twists(
    planned: Plan, index: int, whole: tuple[Pose, ...], constants: Links, q: Array, constants_dot: Any, q_dot: Any
) -> tuple[c.Vector, c.Vector]:
    """Return each joint's own twist in the world about the origin, (rotation, translation), (n,) each."""
    chain, pose = planned.chains[index], whole[index]
    zero = jnp.zeros((len(chain.joints),), q.dtype)
    rotation, translation = (zero, zero, zero), (zero, zero, zero)
    if not isinstance(q_dot, SymbolicZero):
        twist = _scalar_twists if chain.scalar else _quaternion_twists
        rotation, translation = twist(planned, chain, pose, constants, q, q_dot)
    if any(not isinstance(dot, SymbolicZero) for dot in constants_dot):
        parent = _before(whole, chain, pose, q.dtype)
        turned, shifted = _constant_twists(planned, chain, pose, parent, constants, q, constants_dot)
        rotation, translation = c.add(rotation, turned), c.add(translation, shifted)
    return rotation, c.add(translation, c.cross(pose.position, rotation))


def _scalar_twists(
    planned: Plan, chain: Chain, pose: Pose, constants: Links, q: Array, q_dot: Array
) -> tuple[c.Vector, c.Vector]:
    """Return rotation and translation at the joint's own frame, in the world."""
    axis = c.rotate(pose.quaternion, c.split(constants.axis[np.array(chain.joints)]))
    rate = _columns(q_dot, [planned.joint_q[j] for j in chain.joints])
    zero = jnp.zeros_like(rate)
    if not chain.slides:
        return c.scale(axis, rate), (zero, zero, zero)
    sliding = np.array([planned.joint_kind[j] == SLIDE for j in chain.joints])
    return c.scale(axis, jnp.where(sliding, 0, rate)), c.scale(axis, jnp.where(sliding, rate, 0))


def _quaternion_twists(
    planned: Plan, chain: Chain, pose: Pose, constants: Links, q: Array, q_dot: Array
) -> tuple[c.Vector, c.Vector]:
    _, unit, norm = quaternion_coordinates(planned, chain, q)
    free = np.array([planned.joint_kind[j] == FREE for j in chain.joints])
    at = np.array([planned.joint_q[j] for j in chain.joints])
    turn = at + np.where(free, 3, 0)
    rate = c.scale(c.local_rate(unit, tuple(q_dot[turn + i] for i in range(4))), 1 / norm)
    shift = tuple(jnp.where(free, q_dot[at + i], 0) for i in range(3))
    return c.rotate(pose.quaternion, rate), shift


def _before(whole: tuple[Pose, ...], chain: Chain, pose: Pose, dtype: Any) -> Pose:
    """Return the poses that the chain's joints start from, (n,) each."""
    ends = [jax.tree.map(lambda x: x[-1], pose) for pose in whole]
    start = _start(ends, chain, dtype)
    return jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest[:-1]]), start, pose)


def _constant_twists(
    planned: Plan, chain: Chain, pose: Pose, parent: Pose, constants: Links, q: Array, constants_dot: Any
) -> tuple[c.Vector, c.Vector]:
    """Return what a change of the robot's own numbers adds, at the joint's frame, in the world."""
    dots = Links(*(jnp.zeros_like(x) if isinstance(d, SymbolicZero) else d for x, d in zip(constants, constants_dot, strict=True)))

    def local(numbers: Links) -> tuple[c.Vector, c.Quaternion]:
        rows = np.array(chain.joints)
        if not chain.scalar:
            position, unit, _ = quaternion_coordinates(planned, chain, q)
            translation = c.add(c.split(numbers.translation[rows]), position)
            return translation, c.multiply(c.split(numbers.quaternion[rows]), unit)
        translation, fixed, turn, slide = _scalar_constants(planned, chain, numbers)
        x, sine, cosine = _scalar_coordinates(planned, chain, numbers, q)
        if chain.slides:
            translation = c.add(translation, c.scale(slide, x))
        return translation, tuple(f * cosine + t * sine for f, t in zip(fixed, turn, strict=True))

    (_, rotation), (shift, turned) = jax.jvp(local, (constants,), (dots,))
    return c.rotate(pose.quaternion, c.local_rate(rotation, turned)), c.rotate(parent.quaternion, shift)
