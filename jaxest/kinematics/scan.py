"""Poses of a robot's joints: `lax.scan` over the tree with a scalar carry per component."""

from functools import partial
from typing import Any, NamedTuple

import jax
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
from jaxest.kinematics.sequence import outward
from jaxest.types import Array


class Pose(NamedTuple):
    """Pose of joints' frames by component, (n,) each."""

    position: c.Vector
    quaternion: c.Quaternion


def scan_poses(planned: Plan, constants: Links, q: Array) -> Pose:
    """Compute the poses of the joints' frames in the world.

    Args:
        planned: the plan.
        constants: what the poses depend on besides q.
        q: (nq,).

    Returns:
        The poses that the plan keeps, components (k,).
    """
    order = planned.order
    if not order.joint:
        nothing = jnp.zeros((0,), q.dtype)
        return Pose((nothing,) * 3, (nothing,) * 4)
    displacement = displacements(order, constants, q)
    found = turns(order, q) if turning(order) else None
    translation = translations(order, constants, displacement, found)
    rotation: HalfTurns | c.Quaternion = half_turns(order, constants, displacement)
    if found is not None:
        rotation = rotations(order, constants, displacement, found)
    zero, one = jnp.zeros((), q.dtype), jnp.ones((), q.dtype)
    world = Pose((zero, zero, zero), (one, zero, zero, zero))
    if planned.runs != order.runs:
        return outward(order, partial(_link, keep=True), world, (translation, rotation))
    ends: dict[int, Pose] = {-1: world}
    parts: list[Pose] = []
    for first, end in planned.runs:
        keep = first in planned.kept and end - first > 1
        steps = jax.tree.map(lambda x, run=slice(first, end): x[run], (translation, rotation))
        ends[end - 1], every = jax.lax.scan(partial(_link, keep=keep), ends[order.parent[first]], steps)
        if keep:
            parts.append(every)
        elif end - 1 in planned.kept:
            parts.append(jax.tree.map(lambda x: x[None], ends[end - 1]))
    return jax.tree.map(lambda *runs: jnp.concatenate(runs) if len(runs) > 1 else runs[0], *parts)


def _link(pose: Pose, now: Any, keep: bool) -> tuple[Pose, Any]:
    """Go over one joint."""
    shift, turn = now
    position = c.add(pose.position, c.rotate(pose.quaternion, shift))
    pose = Pose(position, c.multiply(pose.quaternion, turn.rotation() if isinstance(turn, HalfTurns) else turn))
    return pose, pose if keep else None
