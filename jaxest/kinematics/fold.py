"""Folding a robot's fixed parts: one constant transform before each joint, one after it for each frame.

Done in float64 on the host where the robot's numbers are known, and traced where they are being differentiated or
batched. Bodies are folded in rounds, all those at the same distance from a joint at once, so that a traced robot
stays a short program.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.robot import BALL, FREE, HINGE, Robot, Topology, is_concrete


class Folded(NamedTuple):
    """Constants of a robot relative to its joints' frames; a joint's frame sits at its anchor and moves with it."""

    translation: Any
    """(nj, 3) m, joint frame in the frame of the joint before it, at q = reference."""
    quaternion: Any
    """(nj, 4) wxyz, likewise."""
    axis: Any
    """(nj, 3) unit, in the joint's frame."""
    frame_translation: Any
    """(nf, 3) m, frame in its joint's frame."""
    frame_quaternion: Any
    """(nf, 4) wxyz, frame to joint frame."""


class Carriers(NamedTuple):
    """Static companion of `Folded`: which joint carries what, -1 for the world."""

    joint: tuple[int, ...]
    """The joint before each joint."""
    frame: tuple[int, ...]
    """The joint that carries each frame."""


def carriers(topology: Topology) -> Carriers:
    """Find the joint that carries each joint and each frame."""
    body: list[int] = []
    joint = [-1] * len(topology.joint_names)
    for index, parent in enumerate(topology.body_parent):
        last = -1 if parent < 0 else body[parent]
        for j in _joints(topology, index):
            joint[j] = -1 if topology.joint_kind[j] == FREE else last
            last = j
        body.append(last)
    sites = [-1 if b < 0 else body[b] for b in topology.site_body]
    return Carriers(tuple(joint), tuple(body + sites))


def _joints(topology: Topology, body: int) -> list[int]:
    return [j for j, owner in enumerate(topology.joint_body) if owner == body]


def fold(robot: Robot) -> Folded:
    """Fold a robot's offsets; in NumPy float64 where all of them are known, else in JAX.

    Args:
        robot: the robot.

    Returns:
        The constants that `chains` and `forward` work with.
    """
    leaves = (
        *(robot.body_position, robot.body_quaternion, robot.joint_anchor, robot.joint_axis),
        *(robot.site_position, robot.site_quaternion),
    )
    if is_concrete(*leaves):
        return _fold(np, robot.topology, *(np.asarray(leaf) for leaf in leaves))
    return _traced_fold(jnp, robot.topology, *(jnp.asarray(leaf) for leaf in leaves))


def _fold(
    xp: Any,
    topology: Topology,
    position: Any,
    quaternion: Any,
    anchor: Any,
    axis: Any,
    site_position: Any,
    site_quaternion: Any,
) -> Folded:
    quaternion, site_quaternion, axis = (_normalised(xp, x) for x in (quaternion, site_quaternion, axis))
    turning = np.array([kind in (HINGE, BALL) for kind in topology.joint_kind], bool)
    anchor = xp.where(turning[:, None], anchor, 0.0)  # a slide's anchor moves nothing, a free joint has none
    body_translation, body_quaternion = _bodies_in_joints(xp, topology, position, quaternion, anchor)
    translation, rotation = _joints_in_joints(
        xp, topology, position, quaternion, anchor, body_translation, body_quaternion
    )
    owner = np.array(topology.site_body, int)
    sites = _compose(
        xp,
        (_gather(xp, body_translation, owner, (0, 0, 0)), _gather(xp, body_quaternion, owner, c.IDENTITY)),
        (site_position, site_quaternion),
    )
    return Folded(
        translation,
        rotation,
        axis,
        xp.concatenate([body_translation, sites[0]]),
        xp.concatenate([body_quaternion, sites[1]]),
    )


_traced_fold = jax.jit(_fold, static_argnums=(0, 1))


def _bodies_in_joints(xp: Any, topology: Topology, position: Any, quaternion: Any, anchor: Any) -> tuple[Any, Any]:
    """Return each body's pose in the frame of the joint that carries it, (nb, 3) and (nb, 4)."""
    last = np.full(len(topology.body_names), -1)
    for j, body in enumerate(topology.joint_body):
        last[body] = j  # joints of one body are in order
    jointed = np.flatnonzero(last >= 0)
    # A body's frame is its joints' frame, moved back from the anchor of the last one.
    done = [jointed]
    translations = [-anchor[last[jointed]]]
    quaternions = [xp.asarray(np.tile(c.IDENTITY, (len(jointed), 1)), dtype=position.dtype)]
    depth = _distance_from_joint(topology, last)
    for d in range(1, max(depth, default=0) + 1):
        now = np.flatnonzero(np.array(depth) == d)
        where = {body: row for row, body in enumerate(np.concatenate(done))}
        parents = np.array([where.get(topology.body_parent[b], -1) for b in now], int)
        parent = (
            _gather(xp, xp.concatenate(translations), parents, (0, 0, 0)),
            _gather(xp, xp.concatenate(quaternions), parents, c.IDENTITY),
        )
        pose = _compose(xp, parent, (position[now], quaternion[now]))
        done.append(now)
        translations.append(pose[0])
        quaternions.append(pose[1])
    order = np.argsort(np.concatenate(done), kind="stable")
    return xp.concatenate(translations)[order], xp.concatenate(quaternions)[order]


def _distance_from_joint(topology: Topology, last: np.ndarray) -> list[int]:
    """Count the fixed bodies from each body up to the joint (0 there) or the world (1 for its children)."""
    depth: list[int] = []
    for body, parent in enumerate(topology.body_parent):
        above = 0 if parent < 0 else depth[parent]
        depth.append(0 if last[body] >= 0 else above + 1)
    return depth


def _joints_in_joints(
    xp: Any,
    topology: Topology,
    position: Any,
    quaternion: Any,
    anchor: Any,
    body_translation: Any,
    body_quaternion: Any,
) -> tuple[Any, Any]:
    """Return each joint's frame in the frame of the joint before it, at the reference, (nj, 3) and (nj, 4)."""
    kinds, owner = topology.joint_kind, np.array(topology.joint_body, int)
    parents = np.array([topology.body_parent[body] for body in owner], int)
    first = np.array([j == 0 or owner[j - 1] != owner[j] for j in range(len(kinds))], bool)
    free = np.array([kind == FREE for kind in kinds], bool)
    parent = (
        _gather(xp, body_translation, parents, (0, 0, 0)),
        _gather(xp, body_quaternion, parents, c.IDENTITY),
    )
    anchored = _compose(xp, (position[owner], quaternion[owner]), (anchor, np.tile(c.IDENTITY, (len(kinds), 1))))
    outer = _compose(xp, parent, anchored)
    # A body's second joint follows its first one, both anchored in the same body.
    inner = anchor - xp.concatenate([xp.zeros_like(anchor[:1]), anchor[:-1]])
    translation = xp.where(first[:, None], outer[0], inner)
    rotation = xp.where((first & ~free)[:, None], outer[1], xp.asarray(c.IDENTITY, dtype=anchor.dtype))
    return xp.where(free[:, None], 0.0, translation), rotation


def _gather(xp: Any, rows: Any, index: np.ndarray, world: tuple[float, ...]) -> Any:
    """Take rows; -1 takes the world's."""
    padded = xp.concatenate([rows, xp.asarray([world], dtype=rows.dtype)])
    return padded[np.where(index < 0, len(rows), index)]


def _compose(xp: Any, a: tuple[Any, Any], b: tuple[Any, Any]) -> tuple[Any, Any]:
    p, q = c.split(a[0]), c.split(a[1])
    translation = c.add(p, c.rotate(q, c.split(b[0])))
    return xp.stack(translation, -1), xp.stack(c.multiply(q, c.split(b[1])), -1)


def _normalised(xp: Any, rows: Any) -> Any:
    return rows / xp.sqrt((rows * rows).sum(-1, keepdims=True))
