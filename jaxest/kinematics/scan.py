"""Poses of a robot's joints: each chain one `lax.scan` with a scalar carry per component."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.chains import Chain, Plan
from jaxest.kinematics.robot import FREE, SLIDE
from jaxest.types import Array


class Pose(NamedTuple):
    """Pose of joints' frames by component; each component () or (n,) along a chain."""

    position: c.Vector
    quaternion: c.Quaternion


class Links(NamedTuple):
    """What the joints' poses depend on besides q."""

    translation: Array
    """(nj, 3) m."""
    quaternion: Array
    """(nj, 4)."""
    axis: Array
    """(nj, 3)."""
    reference: Array
    """(nq,)."""


def scan_poses(planned: Plan, constants: Links, q: Array) -> tuple[Pose, ...]:
    """Compute the poses of the joints' frames in the world, a `Pose` per chain.

    Args:
        planned: the plan.
        constants: what the poses depend on besides q.
        q: (nq,).

    Returns:
        For each chain the pose of its last joint, components (), or of every joint, components (n,).
    """
    poses: list[Pose] = []
    ends: list[Pose] = []
    for chain in planned.chains:
        start = _start(ends, chain, q.dtype)
        scan = _scalar_chain if chain.scalar else _quaternion_chain
        end, every = scan(planned, chain, constants, q, start)
        ends.append(end)
        poses.append(every if chain.every else end)
    return tuple(poses)


def _start(ends: list[Pose], chain: Chain, dtype: Any) -> Pose:
    """Return the pose that a chain starts from: the end of its parent chain, or the world."""
    if chain.parent >= 0:
        return ends[chain.parent]
    zero, one = jnp.zeros((), dtype), jnp.ones((), dtype)
    return Pose((zero, zero, zero), (one, zero, zero, zero))


def _compose(pose: Pose, translation: c.Vector, quaternion: c.Quaternion) -> Pose:
    return Pose(c.add(pose.position, c.rotate(pose.quaternion, translation)), c.multiply(pose.quaternion, quaternion))


def _scalar_chain(planned: Plan, chain: Chain, constants: Links, q: Array, start: Pose) -> tuple[Pose, Any]:
    translation, fixed, turn, slide = _scalar_constants(planned, chain, constants)
    x, sine, cosine = _scalar_coordinates(planned, chain, constants, q)

    def link(pose: Pose, now: Any) -> tuple[Pose, Pose | None]:
        translation, fixed, turn, slide, x, sine, cosine = now
        rotation = tuple(f * cosine + t * sine for f, t in zip(fixed, turn, strict=True))
        if chain.slides:
            translation = c.add(translation, c.scale(slide, x))
        pose = _compose(pose, translation, rotation)
        return pose, pose if chain.every else None

    return jax.lax.scan(link, start, (translation, fixed, turn, slide, x, sine, cosine))


def _scalar_coordinates(planned: Plan, chain: Chain, constants: Links, q: Array) -> tuple[Array, Array, Array]:
    """Return the displacement from the reference and the half angle's sine and cosine, (n,) each."""
    at = columns(q, [planned.joint_q[j] for j in chain.joints])
    x = at - columns(constants.reference, [planned.joint_q[j] for j in chain.joints])
    if not chain.slides:
        return (x, *c.half_sincos(x))
    hinge = np.array([planned.joint_kind[j] != SLIDE for j in chain.joints])
    return (x, *c.half_sincos(jnp.where(hinge, x, 0)))


def _scalar_constants(planned: Plan, chain: Chain, constants: Links) -> tuple[Any, Any, Any, Any]:
    """Return translation, rotation at the reference, its product with the axis, and the slide's direction."""
    rows = np.array(chain.joints)
    translation, quaternion = c.split(constants.translation[rows]), c.split(constants.quaternion[rows])
    axis = c.split(constants.axis[rows])
    turn = c.multiply(quaternion, (jnp.zeros_like(axis[0]), *axis))
    if not chain.slides:
        return translation, quaternion, turn, None
    sliding = np.array([planned.joint_kind[j] == SLIDE for j in chain.joints])
    turn = tuple(jnp.where(sliding, 0, t) for t in turn)
    slide = tuple(jnp.where(sliding, s, 0) for s in c.rotate(quaternion, axis))
    return translation, quaternion, turn, slide


def columns(vector: Array, at: list[int]) -> Array:
    """Take entries of a vector, as a slice where they are consecutive."""
    if at == list(range(at[0], at[-1] + 1)):
        return vector[at[0] : at[-1] + 1]
    return vector[np.array(at)]


def _quaternion_chain(planned: Plan, chain: Chain, constants: Links, q: Array, start: Pose) -> tuple[Pose, Any]:
    rows = np.array(chain.joints)
    position, unit, _ = quaternion_coordinates(planned, chain, q)
    rotation = c.multiply(c.split(constants.quaternion[rows]), unit)
    translation = c.add(c.split(constants.translation[rows]), position)

    def link(pose: Pose, now: Any) -> tuple[Pose, Pose | None]:
        pose = _compose(pose, *now)
        return pose, pose if chain.every else None

    return jax.lax.scan(link, start, (translation, rotation))


def quaternion_coordinates(planned: Plan, chain: Chain, q: Array) -> tuple[c.Vector, c.Quaternion, Array]:
    """Return free joints' positions (0 for balls), the unit quaternions, and the norms they had, (n,) each."""
    free = np.array([planned.joint_kind[j] == FREE for j in chain.joints])
    at = np.array([planned.joint_q[j] for j in chain.joints])
    turn = at + np.where(free, 3, 0)
    raw = tuple(q[turn + i] for i in range(4))
    square = raw[0] ** 2 + raw[1] ** 2 + raw[2] ** 2 + raw[3] ** 2
    good = square > jnp.finfo(q.dtype).tiny
    norm = jnp.sqrt(jnp.where(good, square, 1))
    unit = tuple(jnp.where(good, r, i) / norm for r, i in zip(raw, c.IDENTITY, strict=True))
    position = tuple(jnp.where(free, q[at + i], 0) for i in range(3))
    return position, unit, norm
