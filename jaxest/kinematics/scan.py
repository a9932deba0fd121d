"""Poses of a robot's joints: `lax.scan` over the tree with a scalar carry per component."""

from collections.abc import Callable
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
    """Pose of joints' frames, by component or stacked."""

    position: Any
    """m, components (n,), or (n, 3)."""
    quaternion: Any
    """wxyz, components (n,), or (n, 4)."""

    def stacked(self) -> "Pose":
        """Put the components together: (n, 3) and (n, 4)."""
        return Pose(jnp.stack(self.position, -1), jnp.stack(self.quaternion, -1))


def scan_poses(planned: Plan, constants: Links, q: Array) -> Pose:
    """Compute the poses of the joints' frames in the world.

    Args:
        planned: the plan.
        constants: what the poses depend on besides q.
        q: (nq,).

    Returns:
        The poses that the plan keeps: components (k,), or (k, 3) and (k, 4) where the plan wants them stacked. The
        loops then store two arrays a link instead of seven, in the order in which they leave: half of the time to
        assemble all frames.
    """
    order = planned.order
    if not order.joint:
        nothing = jnp.zeros((0,), q.dtype)
        none = Pose((nothing,) * 3, (nothing,) * 4)
        return none.stacked() if planned.stacked else none
    displacement = displacements(order, constants, q)
    turned = half_turns(order, constants, displacement)

    def steps(first: int, end: int) -> tuple[c.Vector, HalfTurns | c.Quaternion]:
        """Return how the joints of one run move: by sine and cosine alone where it has no ball or free joint."""
        part, run = order.part(first, end), slice(first, end)
        found = turns(part, q) if turning(part) else None
        shift = translations(part, constants, displacement[run], found)
        if found is None:
            return shift, jax.tree.map(lambda x: x[run], turned)
        return shift, rotations(part, constants, displacement[run], found)

    zero, one = jnp.zeros((), q.dtype), jnp.ones((), q.dtype)
    world = Pose((zero, zero, zero), (one, zero, zero, zero))
    store = Pose.stacked if planned.stacked else _itself
    if planned.runs != order.runs:
        return outward(order, partial(_link, store=store), world, steps(0, len(order.joint)))
    ends: dict[int, Pose] = {-1: world}
    parts: list[Pose] = []
    for first, end in planned.runs:
        keep = first in planned.kept and end - first > 1
        link = partial(_link, store=store if keep else None)
        ends[end - 1], every = jax.lax.scan(link, ends[order.parent[first]], steps(first, end))
        if keep:
            parts.append(every)
        elif end - 1 in planned.kept:
            parts.append(store(jax.tree.map(lambda x: x[None], ends[end - 1])))
    return jax.tree.map(lambda *runs: jnp.concatenate(runs) if len(runs) > 1 else runs[0], *parts)


def _itself(pose: Pose) -> Pose:
    return pose


def _link(pose: Pose, now: Any, store: Callable[[Pose], Pose] | None) -> tuple[Pose, Any]:
    """Go over one joint."""
    shift, turn = now
    position = c.add(pose.position, c.rotate(pose.quaternion, shift))
    pose = Pose(position, c.multiply(pose.quaternion, turn.rotation() if isinstance(turn, HalfTurns) else turn))
    return pose, store(pose) if store else None
