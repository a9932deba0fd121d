"""Which IMUs of `posture` can be turned any way against the ones before them, whatever the joints are at one moment."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.kinematics import Robot
from jaxest.kinematics.fold import carriers
from jaxest.kinematics.movement import scattered
from jaxest.kinematics.orientations import UNKNOWN, rotations
from jaxest.kinematics.robot import BALL, FREE, HINGE
from jaxest.types import Array

TRIED = 8
"""Configurations in which axes are looked at."""
SPANNED = 0.1
"""Smallest singular value of three axes that count as spanning all rotations."""


class Loose(NamedTuple):
    """Groups of hinges that turn any way, m of them."""

    carried: NDArray[np.float64]
    """(n, m) 1 where a group carries an IMU."""
    between: NDArray[np.float64]
    """(n, m) 1 for the IMU behind a group, -1 for the one before it, if there is one."""
    hinges: NDArray[np.float64]
    """(nv, m) 1 for the group's coordinates."""
    root: NDArray[np.float64]
    """(nv,) 1 for the rotation of a ball or free joint that carries all IMUs."""


def loose(robot: Robot, names: tuple[str, ...]) -> Loose:
    """Find the IMUs behind hinges that together turn any way, as a shoulder written as three hinges.

    No heading contradicts such hinges, for some other posture of them fits each. Where their axes fall into a plane it
    seems otherwise, to the first order; a filter that believed it would become sure of a wrong heading.

    Args:
        robot: the robot.
        names: frames of the n IMUs.

    Returns:
        The groups.
    """
    carried = carriers(robot.topology)
    above: list[list[int]] = []
    for name in names:
        joint, chain = carried.frame[robot.topology.frame_names.index(name)], []
        while joint >= 0:
            chain.append(joint)
            joint = carried.joint[joint]
        above.append(chain)
    followers = {joint for joint, _ in robot.topology.couplings}
    found: dict[tuple[int, ...], tuple[list[float], list[float], list[float]]] = {}
    for k, chain in enumerate(above):
        before = max((i for i, other in enumerate(above) if len(other) < len(chain) and _ends(chain, other)),
                     key=lambda i: len(above[i]), default=None)  # fmt: skip
        inner = [] if before is None else above[before]
        group = tuple(j for j in chain[: len(chain) - len(inner)] if j not in followers)
        hinges = all(robot.topology.joint_kind[j] == HINGE for j in group)
        if group in found or not hinges or len(group) < 3 or not _span(robot, names[k], group):
            continue
        turned = {robot.topology.joint_v[j] for j in group}
        found[group] = (
            [float(_ends(other, chain)) for other in above],
            [float(i == k) - float(i == before) for i in range(len(names))],
            [float(v in turned) for v in range(robot.nv)],
        )
    columns = ([each[i] for each in found.values()] for i in range(3))
    sizes = len(names), len(names), robot.nv
    groups = [np.array(c).reshape(-1, size).T for c, size in zip(columns, sizes, strict=True)]
    return Loose._make([*groups, _root(robot, above)])


def _root(robot: Robot, above: list[list[int]]) -> NDArray[np.float64]:
    topology, root = robot.topology, np.zeros(robot.nv)
    carriers_of_all = set(above[0]).intersection(*above)
    for joint in carriers_of_all:
        if topology.joint_kind[joint] in (BALL, FREE):
            start = topology.joint_v[joint] + (3 if topology.joint_kind[joint] == FREE else 0)
            root[start : start + 3] = 1
    return root


def turned_any_way(free: Loose, doubt: Array) -> Array:
    """Compute by how much the joints of loose groups are less known than the linear covariance of headings says.

    Args:
        free: the groups.
        doubt: (n, n) rad^2, covariance of the IMUs' headings.

    Returns:
        (nv,) rad^2, growing with the fourth power of the uncertain turn across a group, half a turn at most.
    """
    between, hinges = (jnp.asarray(x, doubt.dtype) for x in (free.between, free.hinges))
    variance = jnp.sum(between * (doubt @ between), axis=0)
    return hinges @ (UNKNOWN * -jnp.expm1(-(variance**2)))


def common(free: Loose, up: Array, deviation: Array) -> Array:
    """Compute what the root's yaw lacks: n headings, all unknown alike, know their mean no better than each.

    Args:
        free: the root.
        up: (n, nv) how each velocity turns the IMUs about the vertical.
        deviation: () or (n,) rad, of each heading at the start.

    Returns:
        (nv, nv) rad^2 that the covariance of independent headings leaves out.
    """
    n = up.shape[0]
    turned = jnp.asarray(free.root, up.dtype) * up[0]
    return (1 - 1 / n) * jnp.mean(deviation**2) * turned[:, None] * turned[None, :]


def _ends(chain: list[int], tail: list[int]) -> bool:
    """Whether a chain of joints, from the outermost inwards, ends with another."""
    return not tail or chain[-len(tail) :] == tail


def _span(robot: Robot, name: str, group: tuple[int, ...]) -> bool:
    """Whether the axes of hinges span all rotations in some configuration."""
    at = np.array([robot.topology.joint_v[j] for j in group])
    home = jnp.asarray(robot.home, jnp.float32)
    for k in range(TRIED):
        slope = np.asarray(rotations(robot, scattered(robot, home, jnp.float32(k)), (name,))[1])[0][:, at]
        if np.linalg.svd(slope)[1][2] > SPANNED:
            return True
    return False


__all__ = ["Loose", "common", "loose", "turned_any_way"]
