"""Where some of a robot's joints live: hinges on circles, slides on lines, balls on the sphere of unit quaternions."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.kinematics.robot import BALL, HINGE, NQ, NV, SLIDE, Robot
from jaxest.manifolds import Euclidean, Power, circle, product, quaternion
from jaxest.manifolds.base import Manifold
from jaxest.types import Array, PyTree

KINDS = (HINGE, SLIDE, BALL)
"""The order in which joints are kept."""


class Joints(NamedTuple):
    """Joints of several kinds; None where there is none of a kind."""

    hinge: Any = None
    """(h,) rad."""
    slide: Any = None
    """(s,) m."""
    ball: Any = None
    """(b, 4) wxyz, child to parent."""


class Space(NamedTuple):
    """Joints that are estimated, all static. Their state is `Joints`, or angles (d,) rad where all are hinges."""

    joints: tuple[int, ...]
    """By number: hinges first, then slides, then balls."""
    manifold: Manifold
    """Its tangent vectors (d,) are velocities: rad, m and, for a ball, a rotation vector in rad."""
    kinds: tuple[str, ...]
    """(d,) the kind of the joint that each of these belongs to."""
    coordinates: tuple[int, ...]
    """(n,) where in q the state's numbers stand, in the order of `flat`."""
    velocities: tuple[int, ...]
    """(d,) where in v."""

    @property
    def dim(self) -> int:
        """Length d of a tangent vector."""
        return len(self.kinds)


def ordered(robot: Robot, joints: Sequence[int]) -> tuple[int, ...]:
    """Return joints by kind: hinges, slides, balls, each in the order given."""
    return tuple(sorted(joints, key=lambda j: KINDS.index(robot.topology.joint_kind[j])))


def space(robot: Robot, joints: Sequence[int]) -> Space:
    """Return where joints live.

    Args:
        robot: the robot.
        joints: hinges, slides and balls by number.

    Returns:
        The space; their order is that of `ordered`.
    """
    topology, joints = robot.topology, ordered(robot, joints)
    kinds = [topology.joint_kind[j] for j in joints]
    many = {kind: kinds.count(kind) for kind in KINDS}
    return Space(
        joints,
        _manifold(many[HINGE], many[SLIDE], many[BALL]),
        tuple(kind for kind in kinds for _ in range(NV[kind])),
        tuple(topology.joint_q[j] + i for j, kind in zip(joints, kinds, strict=True) for i in range(NQ[kind])),
        tuple(topology.joint_v[j] + i for j, kind in zip(joints, kinds, strict=True) for i in range(NV[kind])),
    )


def part(x: PyTree, kind: str) -> Array:
    """Return the state's hinges (h,) rad, slides (s,) m or balls (b, 4)."""
    found: Array = getattr(x, kind) if isinstance(x, Joints) else x
    return found


def flat(x: PyTree) -> Array:
    """Return the state's numbers (n,) in the order of `Space.coordinates`."""
    if not isinstance(x, Joints):
        return jnp.asarray(x)
    return jnp.concatenate([jnp.ravel(value) for value in x if value is not None])


def unflat(where: Space, values: Array) -> PyTree:
    """Return the state (h,) or `Joints` whose numbers (n,) these are; the inverse of `flat`."""
    count = [where.kinds.count(kind) // NV[kind] for kind in KINDS]
    if count[0] == len(where.joints):
        return values
    ends = np.cumsum([count[0], count[1]])
    parts = values[: ends[0]], values[ends[0] : ends[1]], values[ends[1] :].reshape(-1, 4)
    return Joints(*(value if many else None for many, value in zip(count, parts, strict=True)))


def numbers(x: PyTree) -> Array:
    """Return the state's angles and ways as a tangent vector (d,), rad or m; 0 for balls."""
    if not isinstance(x, Joints):
        return jnp.asarray(x)
    ball = None if x.ball is None else jnp.zeros_like(x.ball[..., :3])
    return flat(x._replace(ball=ball))


def put(where: Space, x: PyTree, values: Array, chosen: Array) -> PyTree:
    """Return the state with some angles and ways replaced: values (d,) where chosen (d,) bool; balls stay."""
    if not isinstance(x, Joints):
        return jnp.where(chosen, values, x)
    count = where.dim - where.kinds.count(BALL)
    new = jnp.where(chosen[:count], values[:count], numbers(x)[:count])
    return unflat(where, jnp.concatenate([new, flat(x)[count:]]))


def origin(where: Space, dtype: Any) -> PyTree:
    """Return the state of angles, ways and rotations 0."""
    turns = where.kinds.count(BALL) // 3
    zeros = [0.0] * (where.dim - 3 * turns)
    return unflat(where, jnp.asarray([*zeros, *([1.0, 0.0, 0.0, 0.0] * turns)], dtype))


def space_of(x: PyTree) -> Manifold:
    """Return the manifold that a state belongs to; leaves of many states (N, ...) have one of them first."""
    given = x if isinstance(x, Joints) else Joints(x)
    ends = given._replace(ball=None if given.ball is None else given.ball[..., 0])
    return _manifold(*(0 if value is None else value.shape[-1] for value in ends))


def _manifold(hinges: int, slides: int, balls: int) -> Manifold:
    if not slides + balls:
        return Power(circle, hinges)
    parts = Power(circle, hinges), Euclidean((slides,)), Power(quaternion, balls)
    kept = [part if many else None for part, many in zip(parts, (hinges, slides, balls), strict=True)]
    return product.of(Joints(*kept))


__all__ = [
    "KINDS",
    "Joints",
    "Space",
    "flat",
    "numbers",
    "ordered",
    "origin",
    "part",
    "put",
    "space",
    "space_of",
    "unflat",
]
