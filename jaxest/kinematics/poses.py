"""Poses of a robot's joints with the geometric Jacobian as their derivative."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from jaxest.derivatives import settled
from jaxest.kinematics import components as c
from jaxest.kinematics.coordinates import (
    Links,
    coordinate_rates,
    displacements,
    kinds,
    only,
    scalar,
    turning,
    turns,
)
from jaxest.kinematics.plan import Plan
from jaxest.kinematics.robot import HINGE, SLIDE
from jaxest.kinematics.scan import Pose, scan_poses
from jaxest.kinematics.sequence import Sequence, outward
from jaxest.kinematics.take import take
from jaxest.types import Array

Twist = tuple[c.Vector, c.Vector]
"""Rotation and translation in the world."""


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def joint_poses(planned: Plan, constants: Links, q: Array) -> Pose:
    """Compute the poses of the joints' frames in the world.

    Args:
        planned: the plan.
        constants: what the poses depend on besides q.
        q: (nq,).

    Returns:
        The poses that the plan keeps: components (k,), or (k, 3) and (k, 4) where it wants them stacked.
    """
    return settled(scan_poses(planned, constants, q))


@partial(joint_poses.defjvp, symbolic_zeros=True)
def _joint_poses_jvp(planned: Plan, primals: tuple[Links, Array], tangents: Any) -> tuple[Pose, Pose]:
    """Move every joint's frame by the twists of the joints before it.

    The derivative of a chain of transforms is a running sum of world twists about the origin, which XLA handles in
    one pass in either direction; differentiating the scan itself costs twice as much.
    """
    constants, q = primals
    constants_dot, q_dot = tangents
    order = planned.order
    whole = joint_poses(planned.whole(), constants, q)
    if not order.joint:
        none = whole.stacked() if planned.stacked else whole
        return none, none
    zero = jnp.zeros((len(order.joint),), q.dtype)
    rotation, translation = (zero, zero, zero), (zero, zero, zero)
    if not isinstance(q_dot, SymbolicZero):
        rotation, translation = _coordinate_twists(order, whole, constants, q, q_dot)
    if any(not isinstance(dot, SymbolicZero) for dot in constants_dot):
        dots = [
            jnp.zeros_like(x) if isinstance(d, SymbolicZero) else d
            for x, d in zip(constants, constants_dot, strict=True)
        ]
        turned, shifted = _constant_twists(order, whole, constants, q, Links(*dots))
        rotation, translation = c.add(rotation, turned), c.add(translation, shifted)
    twists = rotation, c.add(translation, c.cross(whole.position, rotation))
    pose = jax.tree.map(lambda x: take(x, planned.kept), whole)
    rate = _moved(pose, *_running_sum(planned, twists))
    return settled((pose.stacked(), rate.stacked()) if planned.stacked else (pose, rate))


def _moved(pose: Pose, rotation: c.Vector, translation: c.Vector) -> Pose:
    """Return the rate of a pose under a world twist about the origin."""
    half = c.scale(rotation, 0.5)
    return Pose(
        c.add(translation, c.cross(rotation, pose.position)),
        c.multiply((jnp.zeros_like(half[0]), *half), pose.quaternion),
    )


def _running_sum(planned: Plan, twists: Twist) -> Twist:
    """Sum twists along the tree, (k,) for the poses that are kept."""
    order = planned.order
    if planned.kept == (len(order.joint) - 1,) and not order.branches:
        return jax.tree.map(lambda x: x.sum(0, keepdims=True), twists)

    def add(total: Twist, now: Twist) -> tuple[Twist, Twist]:
        total = jax.tree.map(jnp.add, total, now)
        return total, total

    sums = outward(order, add, jax.tree.map(lambda x: jnp.zeros((), x.dtype), twists), twists)
    return jax.tree.map(lambda x: take(x, planned.kept), sums)


def _coordinate_twists(order: Sequence, pose: Pose, constants: Links, q: Array, q_dot: Array) -> Twist:
    """Return what a change of q adds at the joints' own frames, in the world, components (n,)."""
    rate, own = coordinate_rates(order, q_dot)
    axis = c.split(constants.axis[np.array(order.joint)])
    turn = tuple(only(scalar(order), a) for a in axis)
    slides = kinds(order, SLIDE)
    hinged, slid = jnp.where(slides, 0, rate) if slides.any() else rate, only(slides, rate)
    rotation = c.scale(turn, hinged)
    shift: c.Vector | None = None
    if own:
        found = turns(order, q)
        joints = turning(order)
        source = [joints.index(j) if j in joints else -1 for j in order.joint]
        spin = c.scale(c.local_rate(found.unit, own[1]), 1 / found.norm)
        rotation = c.add(rotation, tuple(take(x, source) for x in spin))
        shift = tuple(take(x, source) for x in own[0])
    rotation = c.rotate(pose.quaternion, rotation)
    zero = jnp.zeros_like(rate)
    translation = c.rotate(pose.quaternion, c.scale(axis, slid)) if slides.any() else (zero, zero, zero)
    return rotation, translation if shift is None else c.add(translation, shift)


def _constant_twists(order: Sequence, pose: Pose, constants: Links, q: Array, dots: Links) -> Twist:
    """Return what a change of the robot's own numbers adds at the joints' frames, in the world, components (n,)."""
    rows = np.array(order.joint)
    hinge, slide = kinds(order, HINGE), kinds(order, SLIDE)
    own = pose.quaternion
    before = tuple(take(x, order.parent, i) for x, i in zip(own, c.IDENTITY, strict=True))
    x = displacements(order, constants, q)
    at = [order.joint_q[j] if s else -1 for j, s in zip(order.joint, hinge | slide, strict=True)]
    reference_dot = take(dots.reference, at)
    sine, cosine = c.half_sincos(only(hinge, x))
    axis, axis_dot = c.split(constants.axis[rows]), c.split(dots.axis[rows])
    fixed = c.split(constants.quaternion[rows])
    # The fixed rotation moves on the parent's side, the axis and the reference on the joint's own.
    turn = c.scale(c.multiply(c.split(dots.quaternion[rows]), c.conjugate(fixed))[1:], 2)
    direction_dot = c.add(c.cross(turn, c.rotate(fixed, axis)), c.rotate(fixed, axis_dot))
    shift = c.add(c.split(dots.translation[rows]), c.scale(direction_dot, only(slide, x)))
    tilt = c.sub(c.scale(axis_dot, 2 * sine * cosine), c.scale(c.cross(axis, axis_dot), 2 * sine * sine))
    tilt = c.sub(tilt, c.scale(axis, only(hinge, reference_dot)))
    slip = c.scale(axis, only(slide, -reference_dot))
    rotation = c.add(c.rotate(before, turn), c.rotate(own, tilt))
    return rotation, c.add(c.rotate(before, shift), c.rotate(own, slip))
