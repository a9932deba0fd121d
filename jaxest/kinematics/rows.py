"""A robot's numbers and coordinates, one row for each step of a `Sequence`."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import components as c
from jaxest.kinematics.coordinates import displacements, kinds, only, rotations, scalar, turning, turns
from jaxest.kinematics.robot import BALL, FREE, SLIDE
from jaxest.kinematics.sequence import WORLD, Sequence
from jaxest.types import Array

SYMMETRIC = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Entries of a symmetric 3 x 3 matrix in the order in which its six components are held."""


class Numbers(NamedTuple):
    """What the dynamics depend on besides q, v and the torques."""

    translation: Array
    """(nj, 3) m, as in `Links`; so the next three."""
    quaternion: Array
    """(nj, 4)."""
    axis: Array
    """(nj, 3)."""
    reference: Array
    """(nq,)."""
    mass: Array
    """(nj,) kg, as in `Lump`; so the next two."""
    moment: Array
    """(nj, 3) kg m."""
    inertia: Array
    """(nj, 3, 3) kg m2."""
    armature: Array
    """(nv,)."""
    gravity: Array
    """(3,) m/s2."""


class Place(NamedTuple):
    """How each step moves: components (n,), None where no joint of the robot does so."""

    translation: c.Vector
    """m, in the frame before; slides' displacement included."""
    rotation: c.Quaternion
    turn: c.Vector | None
    """Axis of rotation in the frame after, zero for slides."""
    slide: c.Vector | None
    """Direction of sliding in the frame after, zero for hinges."""


class Mass(NamedTuple):
    """What each step's joint carries, on the joint's last step: components (n,)."""

    mass: Array
    moment: c.Vector
    inertia: tuple[Any, ...]


def masses(order: Sequence, numbers: Numbers) -> Mass:
    """Put each joint's mass on the last of its steps.

    Args:
        order: the steps' order.
        numbers: the robot's numbers.

    Returns:
        The masses by component, (n,).
    """
    joint, here = np.array(order.joint), order.closing

    def last(component: Array) -> Array:
        return component[joint] if here.all() else jnp.where(here, component[joint], 0)

    return Mass(
        last(numbers.mass),
        tuple(last(m) for m in c.split(numbers.moment)),
        tuple(last(numbers.inertia[:, i, j]) for i, j in SYMMETRIC),
    )


def places(order: Sequence, numbers: Numbers, q: Array) -> Place:
    """Compute how each step moves its frame.

    The place of a tree's root in the world does not matter to its dynamics and is left at the origin, so that a robot
    far away loses no digits.

    Args:
        order: the steps' order.
        numbers: the robot's numbers.
        q: (nq,).

    Returns:
        Translations, rotations and axes by component, (n,).
    """
    joint = np.array(order.joint)
    displacement = displacements(order, numbers, q)
    found = turns(order, q) if turning(order) else None
    rotation = rotations(order, numbers, displacement, found)
    moved = order.opening & (np.array(order.source) != WORLD)
    translation = tuple(only(moved, t) for t in c.split(numbers.translation[joint]))
    fixed, axis = c.split(numbers.quaternion[joint]), c.split(numbers.axis[joint])
    sliding, single = kinds(order, SLIDE), scalar(order)
    if sliding.any():
        translation = c.add(translation, c.scale(c.rotate(fixed, axis), only(sliding, displacement)))
    if not single.all():
        unit = np.eye(3, dtype=q.dtype)[np.array(order.place) % 3]
        axis = tuple(jnp.where(single, a, u) for a, u in zip(axis, unit.T, strict=True))
    sliding = sliding | (kinds(order, FREE) & (np.array(order.place) < 3))
    turn, slide = (tuple(only(mask, a) for a in axis) if mask.any() else None for mask in (~sliding, sliding))
    return Place(translation, rotation, turn, slide)


def gyration(order: Sequence, v: Array) -> Array | None:
    """Return what MuJoCo's velocities of ball and free joints add to their steps' accelerations.

    Their three axes all move with the parent, while a row of hinges would move each with those before it; in the
    body's axes the difference is a product of two rates.

    Args:
        order: the steps' order.
        v: (n,) velocities of the steps.

    Returns:
        (n,) rad/s2, or None where the robot has no such joint.
    """
    turning = [k == BALL or (k == FREE and p >= 3) for k, p in zip(order.kind, order.place, strict=True)]
    if not any(turning):
        return None
    first, second = np.zeros((2, len(turning)), int)
    sign = np.zeros(len(turning))
    for step in np.flatnonzero(turning):
        place = order.place[step] % 3
        start = step - place
        others = [start + i for i in range(3) if i != place]
        first[step], second[step] = others
        sign[step] = (-1, 1, -1)[place]
    return v[first] * v[second] * jnp.asarray(sign, v.dtype)
