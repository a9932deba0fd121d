"""How each link with sensors hangs on another, for the filter that hands poses from parent to child."""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxest.kinematics import forward
from jaxest.kinematics.robot import HINGE
from jaxest.manifolds import se3
from jaxest.systems._slam_body import Body
from jaxest.types import InputError


class Chain(NamedTuple):
    """How each scanned link hangs on another, static; rows of the root are not used."""

    parent: np.ndarray
    """(L,) row of the parent, -1 for the root."""
    joint: np.ndarray
    """(L,) which of the encoders lies between, 0 for the root."""
    hinge: np.ndarray
    """(L,) bool."""
    offset: se3.Pose
    """(L, ...) of the link in its parent at coordinate 0."""
    axis: np.ndarray
    """(L, 3) in the link."""
    anchor: np.ndarray
    """(L, 3) m, in the link."""


def chain(body: Body) -> Chain:
    """Find the parent and the joint of each scanned link; raises InputError where not one joint lies between."""
    topology, robot = body.robot.topology, body.robot
    rows: dict[int, int] = {}
    columns: list[list[Any]] = [[] for _ in range(6)]
    q = np.array(robot.home, float)
    for j in body.joints:
        q[topology.joint_q[j]] = 0
    frames = forward(robot, q)
    for row, link in enumerate(body.scanned):
        between, up = [], link
        while up >= 0 and (up == link or up not in rows):
            between += [j for j in body.joints if topology.joint_body[j] == up]
            up = topology.body_parent[up]
        rows[link] = row
        if up < 0 and row == 0 and not between:
            place = se3.Pose(frames.quaternion[link], frames.position[link])
            found: Any = (-1, 0, True, np.array([0.0, 0, 1]), np.zeros(3), place)
        elif up >= 0 and len(between) == 1 and topology.joint_body[between[0]] == link:
            j = between[0]
            one, other = (se3.Pose(frames.quaternion[b], frames.position[b]) for b in (up, link))
            unit = np.asarray(robot.joint_axis[j]) / np.linalg.norm(robot.joint_axis[j])
            found = (rows[up], body.joints.index(j), topology.joint_kind[j] == HINGE, unit,
                     np.asarray(robot.joint_anchor[j]), se3.compose(se3.inverse(one), other))  # fmt: skip
        else:
            name = topology.body_names[link]
            raise InputError(f"link {name!r}: expected one joint between it and the link with sensors before it")
        for column, value in zip(columns, found, strict=True):
            column.append(value)
    stacked = jax.tree.map(lambda *x: np.stack([np.asarray(v) for v in x]), *columns.pop())
    parent, joint, hinge, axis, anchor = (np.array(column) for column in columns)
    return Chain(parent, joint, hinge, stacked, axis, anchor)


__all__ = ["Chain", "chain"]
