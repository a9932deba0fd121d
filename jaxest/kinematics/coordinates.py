"""A robot's coordinates as the displacements and rotations of a `Sequence`'s steps."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.robot import BALL, FREE, HINGE, NQ, SLIDE
from jaxest.kinematics.sequence import Sequence
from jaxest.kinematics.take import take
from jaxest.types import Array


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


class Turns(NamedTuple):
    """The coordinates of ball and free joints, m of them, by component."""

    position: c.Vector
    """(m,) m of free joints, 0 for balls."""
    unit: c.Quaternion
    """(m,) normalised."""
    norm: Array
    """(m,) what the quaternions were divided by."""


def scalar(order: Sequence) -> np.ndarray:
    """Tell which steps belong to a joint with one coordinate, (n,) bool."""
    return np.array([kind in (HINGE, SLIDE) for kind in order.kind], bool)


def turning(order: Sequence) -> list[int]:
    """Return the ball and free joints, in the order of their (first) steps."""
    return list(dict.fromkeys(j for j in order.joint if order.joint_kind[j] in (BALL, FREE)))


def kinds(order: Sequence, *which: str) -> np.ndarray:
    """Tell which steps belong to joints of certain kinds, (n,) bool."""
    return np.array([kind in which for kind in order.kind], bool)


def only(mask: np.ndarray, component: Array) -> Array:
    """Keep rows, and set the others to zero."""
    return component if mask.all() else jnp.where(mask, component, 0)


def displacements(order: Sequence, constants: Any, q: Array) -> Array:
    """Return hinges' and slides' displacements from their reference, rad or m, (n,); 0 for other joints."""
    at = [order.joint_q[j] if s else -1 for j, s in zip(order.joint, scalar(order), strict=True)]
    return take(q, at) - take(constants.reference, at)


def turns(order: Sequence, q: Array) -> Turns:
    """Return the coordinates of ball and free joints, as `turning` orders them; zero quaternions count as the identity.

    Args:
        order: the steps' order.
        q: (nq,).

    Returns:
        Positions, unit quaternions and norms by component, (m,).
    """
    joints = turning(order)
    free = np.array([order.joint_kind[j] == FREE for j in joints])
    at = [order.joint_q[j] for j in joints]
    raw = tuple(take(q, [a + 3 * f + i for a, f in zip(at, free, strict=True)]) for i in range(4))
    square = raw[0] ** 2 + raw[1] ** 2 + raw[2] ** 2 + raw[3] ** 2
    good = square > jnp.finfo(q.dtype).tiny
    norm = jnp.sqrt(jnp.where(good, square, 1))
    unit = tuple(jnp.where(good, r, i) / norm for r, i in zip(raw, c.IDENTITY, strict=True))
    position = tuple(take(q, [a + i if f else -1 for a, f in zip(at, free, strict=True)]) for i in range(3))
    return Turns(position, unit, norm)


class HalfTurns(NamedTuple):
    """Rotations of hinges and slides by what they are made of: fixed * cosine + turned * sine; components (n,)."""

    fixed: c.Quaternion
    turned: c.Quaternion
    sine: Array
    cosine: Array

    def rotation(self) -> c.Quaternion:
        """Put the rotations together."""
        return tuple(f * self.cosine + t * self.sine for f, t in zip(self.fixed, self.turned, strict=True))


def half_turns(order: Sequence, constants: Any, displacement: Array) -> HalfTurns:
    """Return the rotation of each hinge's or slide's step to the one before it, not yet put together.

    A robot that has no other joints leaves that to the loop over its links: two arrays to read there instead of four.

    Args:
        order: the steps' order.
        constants: `Links`, or anything with its fields.
        displacement: (n,) from `displacements`.

    Returns:
        Components (n,); what stands there for ball and free joints means nothing.
    """
    rows = np.array(order.joint)
    fixed, axis = c.split(constants.quaternion[rows]), c.split(constants.axis[rows])
    hinge = kinds(order, HINGE)
    turned = c.multiply(fixed, (jnp.zeros_like(axis[0]), *axis))
    return HalfTurns(fixed, tuple(only(hinge, t) for t in turned), *_sincos_by_joint(only(hinge, displacement)))


def _sincos_by_joint(angle: Array) -> tuple[Array, Array]:
    """Return sine and cosine of half the angles, (n,), in a loop over the joints.

    XLA on CPU cuts a kernel with this much arithmetic in two for its thread pool once a batch has 1000 entries, and
    waits for both halves: 70 us, where the work is 10. What a loop stores is never cut.
    """
    return jax.lax.map(c.half_sincos, angle) if angle.shape[0] > 1 else c.half_sincos(angle)


def rotations(order: Sequence, constants: Any, displacement: Array, found: Turns | None) -> c.Quaternion:
    """Return the rotation from each step's frame to the one before it.

    Args:
        order: the steps' order.
        constants: `Links`, or anything with its fields.
        displacement: (n,) from `displacements`.
        found: from `turns`; None where no joint is a ball or free.

    Returns:
        Components (n,); the identity for steps that do not turn.
    """
    rotation = half_turns(order, constants, displacement).rotation()
    if found is None:
        return rotation
    joints = turning(order)
    own = c.multiply(c.split(constants.quaternion[np.array(joints)]), found.unit)
    steps = enumerate(zip(order.joint, scalar(order), order.opening, strict=True))
    count = len(order.joint)
    source = [i if s else count + joints.index(j) if opens else -1 for i, (j, s, opens) in steps]
    parts = zip(rotation, own, c.IDENTITY, strict=True)
    return tuple(take(jnp.concatenate([r, o]), source, identity) for r, o, identity in parts)


def translations(order: Sequence, constants: Any, displacement: Array, found: Turns | None) -> c.Vector:
    """Return the shift from each step's frame to the one before it, slides' displacement and free positions included.

    Args:
        order: the steps' order, a step per joint.
        constants: `Links`, or anything with its fields.
        displacement: (n,) from `displacements`.
        found: from `turns`; None where no joint is a ball or free.

    Returns:
        Components (n,), m.
    """
    rows = np.array(order.joint)
    translation = c.split(constants.translation[rows])
    slide = kinds(order, SLIDE)
    if slide.any():
        along = c.rotate(c.split(constants.quaternion[rows]), c.split(constants.axis[rows]))
        translation = c.add(translation, c.scale(along, only(slide, displacement)))
    if found is None or not kinds(order, FREE).any():
        return translation
    joints = turning(order)
    source = [joints.index(j) if kind == FREE else -1 for j, kind in zip(order.joint, order.kind, strict=True)]
    return c.add(translation, tuple(take(p, source) for p in found.position))


def coordinate_rates(order: Sequence, q_dot: Array) -> tuple[Array, list[tuple[Array, ...]]]:
    """Sort a vector over q by steps.

    Args:
        order: the steps' order, a step per joint.
        q_dot: (nq,).

    Returns:
        (n,) the entries of hinges and slides, 0 elsewhere; and for each coordinate of a free joint (7) an array (m,)
        over the `turning` joints, 0 where a ball lacks it.
    """
    joints = turning(order)
    at = [order.joint_q[j] if s else -1 for j, s in zip(order.joint, scalar(order), strict=True)]
    if not joints:
        return take(q_dot, at), []
    entries = jax.lax.split(q_dot, [1] * q_dot.shape[0])  # once: its transpose is one concatenation
    zero = jnp.zeros_like(entries[0])
    rates = jnp.concatenate([entries[a] if a >= 0 else zero for a in at])
    first = [order.joint_q[j] + NQ[order.joint_kind[j]] - 7 for j in joints]
    own = [[k - a >= 7 - NQ[order.joint_kind[j]] for k in range(a, a + 7)] for j, a in zip(joints, first, strict=True)]
    columns = [
        jnp.concatenate([entries[a + i] if has[i] else zero for a, has in zip(first, own, strict=True)])
        for i in range(7)
    ]
    return rates, [tuple(columns[:3]), tuple(columns[3:])]
