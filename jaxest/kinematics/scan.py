"""Poses of a robot's joints: one `lax.scan` over the tree with a scalar carry per component."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxest.kinematics import components as c
from jaxest.kinematics.coordinates import (
    HalfTurns,
    Links,
    displacements,
    half_turns,
    rotations,
    translations,
    turning,
    turns,
)
from jaxest.kinematics.plan import Plan
from jaxest.kinematics.sequence import walk
from jaxest.types import Array


class Pose(NamedTuple):
    """Pose of joints' frames by component, each () or (n,)."""

    position: c.Vector
    quaternion: c.Quaternion


def scan_poses(planned: Plan, constants: Links, q: Array) -> Pose:
    """Compute the poses of the joints' frames in the world.

    Args:
        planned: the plan.
        constants: what the poses depend on besides q.
        q: (nq,).

    Returns:
        The pose of the last joint, components (), or of every joint, components (n,).
    """
    order = planned.order
    displacement = displacements(order, constants, q)
    found = turns(order, q) if turning(order) else None
    translation = translations(order, constants, displacement, found)
    rotation: HalfTurns | c.Quaternion = half_turns(order, constants, displacement)
    if found is not None:
        rotation = rotations(order, constants, displacement, found)
    zero, one = jnp.zeros((), q.dtype), jnp.ones((), q.dtype)
    world = Pose((zero, zero, zero), (one, zero, zero, zero))

    def link(pose: Pose, now: Any) -> tuple[Pose, Pose | None]:
        shift, turn = now
        position = c.add(pose.position, c.rotate(pose.quaternion, shift))
        pose = Pose(position, c.multiply(pose.quaternion, turn.rotation() if isinstance(turn, HalfTurns) else turn))
        return pose, pose if planned.every else None

    last, every = walk(order, link, world, (translation, rotation))
    return every if planned.every else last
