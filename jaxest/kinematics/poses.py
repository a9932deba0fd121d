"""Poses of a robot's joints with the geometric Jacobian as their derivative."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from jaxest.kinematics import components as c
from jaxest.kinematics.chains import Chain, Plan
from jaxest.kinematics.robot import FREE, HINGE, NQ, SLIDE
from jaxest.kinematics.scan import (
    Links,
    Pose,
    quaternion_coordinates,
    scan_poses,
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
    dots = Links(
        *(
            jnp.zeros_like(x) if isinstance(d, SymbolicZero) else d
            for x, d in zip(constants, constants_dot, strict=True)
        )
    )
    tuned = any(not isinstance(dot, SymbolicZero) for dot in constants_dot)
    added = _constant_twists(planned, whole, constants, q, dots) if tuned and whole else [None] * len(whole)
    pieces = None if isinstance(q_dot, SymbolicZero) else _pieces(planned, q_dot)
    moves: list[tuple[c.Vector, c.Vector]] = []
    poses: list[Pose] = []
    poses_dot: list[Pose] = []
    for chain, pose, extra in zip(planned.chains, whole, added, strict=True):
        rates = None if pieces is None else [pieces[planned.joint_q[joint]] for joint in chain.joints]
        twists = _chain_twists(planned, chain, pose, constants, q, rates, extra)
        start = moves[chain.parent] if chain.parent >= 0 else None
        every, end = _running_sum(twists, start, chain.every)
        moves.append(end)
        last = jax.tree.map(lambda x: x[-1], pose)
        poses.append(pose if chain.every else last)
        poses_dot.append(_moved(poses[-1], *(every if chain.every else end)))
    return tuple(poses), tuple(poses_dot)


def _pieces(planned: Plan, q_dot: Array) -> dict[int, Array]:
    """Split a vector over q into joints by the address in q.

    The transpose of one split is one concatenation. That of slices is a sum of padded vectors, for each entry of which
    XLA on CPU computes all of them: 100 times slower for a robot of short chains.
    """
    sizes = [NQ[kind] for kind in planned.joint_kind]
    return dict(zip(planned.joint_q, jax.lax.split(q_dot, sizes), strict=True))


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
    planned: Plan, chain: Chain, pose: Pose, constants: Links, q: Array, rates: list[Array] | None, extra: Any
) -> tuple[c.Vector, c.Vector]:
    """Return each joint's own twist in the world about the origin, (rotation, translation), (n,) each."""
    zero = jnp.zeros((len(chain.joints),), q.dtype)
    rotation, translation = (zero, zero, zero), (zero, zero, zero)
    if rates is not None:
        twist = _scalar_twists if chain.scalar else _quaternion_twists
        rotation, translation = twist(planned, chain, pose, constants, q, rates)
    if extra is not None:
        rotation, translation = c.add(rotation, extra[0]), c.add(translation, extra[1])
    return rotation, c.add(translation, c.cross(pose.position, rotation))


def _scalar_twists(
    planned: Plan, chain: Chain, pose: Pose, constants: Links, q: Array, rates: list[Array]
) -> tuple[c.Vector, c.Vector]:
    """Return rotation and translation at the joint's own frame, in the world."""
    axis = c.rotate(pose.quaternion, c.split(constants.axis[np.array(chain.joints)]))
    rate = jnp.concatenate(rates)
    zero = jnp.zeros_like(rate)
    if not chain.slides:
        return c.scale(axis, rate), (zero, zero, zero)
    sliding = np.array([planned.joint_kind[j] == SLIDE for j in chain.joints])
    return c.scale(axis, jnp.where(sliding, 0, rate)), c.scale(axis, jnp.where(sliding, rate, 0))


def _quaternion_twists(
    planned: Plan, chain: Chain, pose: Pose, constants: Links, q: Array, rates: list[Array]
) -> tuple[c.Vector, c.Vector]:
    _, unit, norm = quaternion_coordinates(planned, chain, q)
    free = np.array([planned.joint_kind[j] == FREE for j in chain.joints])
    split = [jax.lax.split(rate, [1] * rate.shape[0]) for rate in rates]
    turning = tuple(jnp.concatenate(parts) for parts in zip(*(parts[-4:] for parts in split), strict=True))
    moving = tuple(jnp.concatenate(parts) for parts in zip(*(parts[:3] for parts in split), strict=True))
    rate = c.scale(c.local_rate(unit, turning), 1 / norm)
    shift = tuple(jnp.where(free, m, 0) for m in moving)
    return c.rotate(pose.quaternion, rate), shift


def _constant_twists(
    planned: Plan, whole: tuple[Pose, ...], constants: Links, q: Array, dots: Links
) -> list[tuple[c.Vector, c.Vector]]:
    """Return what a change of the robot's own numbers adds at the joints' frames, in the world, a pair per chain.

    All chains at once: this is rarely batched, and a robot with many short chains would make a long program.
    """
    joints = [joint for chain in planned.chains for joint in chain.joints]
    kinds = [planned.joint_kind[joint] for joint in joints]
    hinge, slide = (np.array([kind == which for kind in kinds]) for which in (HINGE, SLIDE))
    at = np.array([planned.joint_q[joint] for joint in joints])
    rows = np.array(joints)
    now, dot = (
        Links(n.translation[rows], n.quaternion[rows], n.axis[rows], n.reference[at]) for n in (constants, dots)
    )
    own = jax.tree.map(lambda *parts: jnp.concatenate(parts), *whole).quaternion
    before = tuple(
        jnp.append(x, jnp.asarray(i, x.dtype))[_parents(planned)] for x, i in zip(own, c.IDENTITY, strict=True)
    )
    x = jnp.where(hinge | slide, q[at] - now.reference, 0)
    sine, cosine = c.half_sincos(jnp.where(hinge, x, 0))
    axis, axis_dot, fixed = c.split(now.axis), c.split(dot.axis), c.split(now.quaternion)
    # The fixed rotation moves on the parent's side, the axis and the reference on the joint's own.
    turn = c.scale(c.multiply(c.split(dot.quaternion), c.conjugate(fixed))[1:], 2)
    direction_dot = c.add(c.cross(turn, c.rotate(fixed, axis)), c.rotate(fixed, axis_dot))
    shift = c.add(c.split(dot.translation), c.scale(direction_dot, jnp.where(slide, x, 0)))
    tilt = c.sub(c.scale(axis_dot, 2 * sine * cosine), c.scale(c.cross(axis, axis_dot), 2 * sine * sine))
    tilt = c.sub(tilt, c.scale(axis, jnp.where(hinge, dot.reference, 0)))
    slip = c.scale(axis, jnp.where(slide, -dot.reference, 0))
    rotation = c.add(c.rotate(before, turn), c.rotate(own, tilt))
    translation = c.add(c.rotate(before, shift), c.rotate(own, slip))
    cuts = np.cumsum([len(chain.joints) for chain in planned.chains])[:-1]
    parts = [jnp.split(component, cuts) for component in (*rotation, *translation)]
    return [(tuple(part[:3]), tuple(part[3:])) for part in zip(*parts, strict=True)]


def _parents(planned: Plan) -> np.ndarray:
    """Return the place of each joint's parent in the order of the chains, one past the end for the world."""
    sizes = [len(chain.joints) for chain in planned.chains]
    starts = np.cumsum([0, *sizes])
    parents = np.arange(-1, starts[-1] - 1)
    for index, chain in enumerate(planned.chains):
        parents[starts[index]] = starts[chain.parent + 1] - 1 if chain.parent >= 0 else starts[-1]
    return parents
