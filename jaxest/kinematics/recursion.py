"""The passes over a tree that dynamics are made of, in the axes of the world, each about its joint's own point.

Forces and inertias refer to the point of their joint rather than to one origin: a finger's inertia about the robot's
base would lose it in float32. `Sequence` makes every pass one scan, with a scalar per component.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.kinematics import components as c
from jaxest.kinematics.rows import SYMMETRIC, Mass, Place
from jaxest.kinematics.sequence import Sequence, inward, outward
from jaxest.types import Array

Symmetric = tuple[Any, ...]
Matrix = tuple[Any, ...]
Force = tuple[c.Vector, c.Vector]
"""Torque about a joint's point, and force."""


class Placed(NamedTuple):
    """Steps in the axes of the world: components (n,), None where no joint of the robot does so."""

    arm: c.Vector
    """m, from the point of the step before to this one's."""
    turn: c.Vector | None
    slide: c.Vector | None
    mass: Array
    moment: c.Vector
    inertia: Symmetric


class Factors(NamedTuple):
    """The mass matrix, factorised along the tree: what `solve` needs."""

    torque: c.Vector
    """Torque that the tree beyond a step answers its acceleration with, over `1 / inverse`."""
    force: c.Vector
    """Force, likewise."""
    inverse: Array
    """Inverse of the inertia that the step's joint feels."""


def place(order: Sequence, rows: Place, carried: Mass) -> Placed:
    """Turn axes, lever arms and masses into the axes of the world.

    Args:
        order: the steps' order.
        rows: how each step moves.
        carried: what it carries.

    Returns:
        The same in the axes of the world.
    """
    zero, one = units(rows.translation[0])

    def step(quaternion: Any, now: tuple[Place, Mass]) -> Any:
        rows, carried = now
        arm = c.rotate(quaternion, rows.translation)
        quaternion = c.multiply(quaternion, rows.rotation)
        turn, slide = (axis if axis is None else c.rotate(quaternion, axis) for axis in (rows.turn, rows.slide))
        moment = c.rotate(quaternion, carried.moment)
        return quaternion, Placed(arm, turn, slide, carried.mass, moment, _turned(quaternion, carried.inertia))

    return outward(order, step, (one, zero, zero, zero), (rows, carried))


def units(component: Array) -> tuple[Array, Array]:
    """Return 0 and 1 of a component's type."""
    return jnp.zeros((), component.dtype), jnp.ones((), component.dtype)


def _turned(quaternion: c.Quaternion, inertia: Symmetric) -> Symmetric:
    """Return R I R^T."""
    w, x, y, z = quaternion
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    half = [symmetric_times(inertia, row) for row in rows]
    return tuple(c.dot(half[i], rows[j]) for i, j in SYMMETRIC)


def symmetric_times(m: Symmetric, v: c.Vector) -> c.Vector:
    """Return the product of a symmetric matrix and a vector."""
    return (
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
    )


def link_forces(order: Sequence, placed: Placed, gravity: Array, v: Array, a: Array | None, extra: Any) -> Force:
    """Compute the force that each step's links need to move as they do.

    Args:
        order: the steps' order.
        placed: the steps in the world.
        gravity: (3,) m/s2.
        v: (n,) velocities of the steps.
        a: (n,) accelerations, or None for zero.
        extra: (n,) what `gyration` adds to them, or None.

    Returns:
        Torque about the step's point and force, components (n,).
    """
    if extra is not None:
        a = extra if a is None else a + extra
    zero, _ = units(v)

    def step(state: Any, now: Any) -> Any:
        rate, turning, moving = state
        at, v, a = now
        shift = c.cross(rate, at.arm)
        if at.slide is not None:
            shift = c.add(shift, c.scale(at.slide, 2 * v))
        moving = c.add(moving, c.add(c.cross(turning, at.arm), c.cross(rate, shift)))
        if at.slide is not None and a is not None:
            moving = c.add(moving, c.scale(at.slide, a))
        if at.turn is not None:
            spin = c.scale(at.turn, v)
            turning = c.add(turning, c.cross(rate, spin))
            rate = c.add(rate, spin)
            if a is not None:
                turning = c.add(turning, c.scale(at.turn, a))
        return (rate, turning, moving), _inertial_force(at, rate, turning, moving)

    still = (zero, zero, zero)
    return outward(order, step, (still, still, tuple(-g for g in c.split(gravity))), (placed, v, a))


def _inertial_force(at: Placed, rate: c.Vector, turning: c.Vector, moving: c.Vector) -> Force:
    """Return the force on a body from its angular rate and acceleration and its point's acceleration."""
    force = c.add(c.cross(turning, at.moment), c.cross(rate, c.cross(rate, at.moment)))
    spin = c.add(symmetric_times(at.inertia, turning), c.cross(rate, symmetric_times(at.inertia, rate)))
    return c.add(c.cross(at.moment, moving), spin), c.add(c.scale(moving, at.mass), force)


def project(at: Any, load: Force) -> Any:
    """Return the part of a force along a step's own coordinate."""
    if at.turn is None:
        return c.dot(at.slide, load[1])
    along = c.dot(at.turn, load[0])
    return along if at.slide is None else along + c.dot(at.slide, load[1])


def to_parent(at: Any, load: Force) -> Force:
    """Refer a force to the point of the step before."""
    return c.add(load[0], c.cross(at.arm, load[1])), load[1]


def joint_torques(order: Sequence, placed: Placed, loads: Force) -> Array:
    """Sum forces inwards and project them on the steps' coordinates, (n,).

    Args:
        order: the steps' order.
        placed: the steps in the world.
        loads: what each step's links need.

    Returns:
        (n,) N m or N.
    """

    def step(received: Force, now: Any) -> Any:
        at, own = now
        load = jax.tree.map(jnp.add, own, received)
        return to_parent(at, load), project(at, load)

    zero, _ = units(placed.mass)
    return inward(order, step, ((zero,) * 3, (zero,) * 3), (placed, loads))


def composite_forces(order: Sequence, placed: Placed) -> Force:
    """Compute the force that a unit acceleration of each step alone needs, by the composite bodies beyond it.

    Args:
        order: the steps' order.
        placed: the steps in the world.

    Returns:
        Torque about the step's point and force, components (n,).
    """

    def step(received: Any, at: Placed) -> Any:
        mass, moment, inertia = jax.tree.map(jnp.add, received, (at.mass, at.moment, at.inertia))
        torque, force = (zero,) * 3, (zero,) * 3
        if at.turn is not None:
            torque, force = symmetric_times(inertia, at.turn), c.cross(at.turn, moment)
        if at.slide is not None:
            torque = c.add(torque, c.cross(moment, at.slide))
            force = c.add(force, c.scale(at.slide, mass))
        double = c.add(c.scale(moment, 2), c.scale(at.arm, mass))  # (2 h + m r): both parts of the shift at once
        trace = c.dot(double, at.arm)
        half = c.add(moment, c.scale(at.arm, mass / 2))
        shifted = tuple(
            x + (trace if i == j else 0) - half[i] * at.arm[j] - at.arm[i] * half[j]
            for x, (i, j) in zip(inertia, SYMMETRIC, strict=True)
        )
        return (mass, c.add(moment, c.scale(at.arm, mass)), shifted), (torque, force)

    zero, _ = units(placed.mass)
    return inward(order, step, (zero, (zero,) * 3, (zero,) * 6), placed)


def points(order: Sequence, placed: Placed) -> c.Vector:
    """Add up the lever arms: the steps' points from the root of their tree, components (n,)."""

    def step(point: c.Vector, arm: c.Vector) -> Any:
        point = c.add(point, arm)
        return point, point

    zero, _ = units(placed.mass)
    return outward(order, step, (zero,) * 3, placed.arm)
