"""Poses of a robot's joints with the geometric Jacobian as their derivative."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from jaxest.kinematics import components as c
from jaxest.kinematics.chains import Chain, Plan
from jaxest.kinematics.robot import FREE, SLIDE
from jaxest.kinematics.scan import (
    Links,
    Pose,
    columns,
    quaternion_coordinates,
    scalar_constants,
    scalar_coordinates,
    scan_poses,
    start_of,
)
from jaxest.types import Array


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
    return scan_poses(planned, constants, q)


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
    rate = columns(q_dot, [planned.joint_q[j] for j in chain.joints])
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
    start = start_of(ends, chain, dtype)
    return jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest[:-1]]), start, pose)


def _constant_twists(
    planned: Plan, chain: Chain, pose: Pose, parent: Pose, constants: Links, q: Array, constants_dot: Any
) -> tuple[c.Vector, c.Vector]:
    """Return what a change of the robot's own numbers adds, at the joint's frame, in the world."""
    dots = Links(
        *(
            jnp.zeros_like(x) if isinstance(d, SymbolicZero) else d
            for x, d in zip(constants, constants_dot, strict=True)
        )
    )

    def local(numbers: Links) -> tuple[c.Vector, c.Quaternion]:
        rows = np.array(chain.joints)
        if not chain.scalar:
            position, unit, _ = quaternion_coordinates(planned, chain, q)
            translation = c.add(c.split(numbers.translation[rows]), position)
            return translation, c.multiply(c.split(numbers.quaternion[rows]), unit)
        translation, fixed, turn, slide = scalar_constants(planned, chain, numbers)
        x, sine, cosine = scalar_coordinates(planned, chain, numbers, q)
        if chain.slides:
            translation = c.add(translation, c.scale(slide, x))
        return translation, tuple(f * cosine + t * sine for f, t in zip(fixed, turn, strict=True))

    (_, rotation), (shift, turned) = jax.jvp(local, (constants,), (dots,))
    return c.rotate(pose.quaternion, c.local_rate(rotation, turned)), c.rotate(parent.quaternion, shift)
