"""Forward dynamics as a solve with the mass matrix, factorised along the tree (articulated bodies).

Source: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, table 7.1; here in the axes of the world, and the
velocity terms apart, so that the same factors solve for the accelerations and for their derivative.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxest.kinematics import components as c
from jaxest.kinematics.recursion import (
    Factors,
    Force,
    Matrix,
    Placed,
    Symmetric,
    project,
    symmetric_times,
    to_parent,
    units,
)
from jaxest.kinematics.rows import SYMMETRIC
from jaxest.kinematics.sequence import Sequence, inward, outward
from jaxest.types import Array

Inertia = tuple[Symmetric, Matrix, Symmetric]
"""Blocks A, B, M of torque = A alpha + B a, force = B^T alpha + M a; B by rows."""


def factorise(order: Sequence, placed: Placed, armature: Array) -> Factors:
    """Factorise the mass matrix along the tree.

    Args:
        order: the steps' order.
        placed: the steps in the world.
        armature: (n,) rotor inertia of each step.

    Returns:
        The factors.
    """
    zero, _ = units(armature)

    def step(received: Inertia, now: Any) -> Any:
        at, armature = now
        body = _with_body(received, at)
        factors, torque, force = _factor(body, at, armature)
        return _shifted(_without(body, factors, torque, force), at.arm), factors

    return inward(order, step, ((zero,) * 6, (zero,) * 9, (zero,) * 6), (placed, armature))


def _with_body(inertia: Inertia, at: Placed) -> Inertia:
    a, b, m = inertia
    x, y, z = at.moment
    cross = (0, -z, y, z, 0, -x, -y, x, 0)
    return (
        tuple(p + q for p, q in zip(a, at.inertia, strict=True)),
        tuple(p + q for p, q in zip(b, cross, strict=True)),
        tuple(p + (at.mass if i == j else 0) for p, (i, j) in zip(m, SYMMETRIC, strict=True)),
    )


def _factor(inertia: Inertia, at: Placed, armature: Array) -> tuple[Factors, c.Vector, c.Vector]:
    """Return the factors of a step, and the force that its unit acceleration needs."""
    a, b, m = inertia
    torque, force = (0, 0, 0), (0, 0, 0)
    if at.turn is not None:
        torque, force = symmetric_times(a, at.turn), tuple(c.dot((b[i], b[3 + i], b[6 + i]), at.turn) for i in range(3))
    if at.slide is not None:
        torque = c.add(torque, tuple(c.dot(b[3 * i : 3 * i + 3], at.slide) for i in range(3)))
        force = c.add(force, symmetric_times(m, at.slide))
    inverse = 1 / (project(at, (torque, force)) + armature)
    return Factors(c.scale(torque, inverse), c.scale(force, inverse), inverse), torque, force


def _without(inertia: Inertia, factors: Factors, torque: c.Vector, force: c.Vector) -> Inertia:
    """Take away what the free joint gives way to."""
    a, b, m = inertia
    return (
        tuple(x - factors.torque[i] * torque[j] for x, (i, j) in zip(a, SYMMETRIC, strict=True)),
        tuple(x - factors.torque[k // 3] * force[k % 3] for k, x in enumerate(b)),
        tuple(x - factors.force[i] * force[j] for x, (i, j) in zip(m, SYMMETRIC, strict=True)),
    )


def _shifted(inertia: Inertia, arm: c.Vector) -> Inertia:
    """Refer an inertia to the point of the step before."""
    a, b, m = inertia
    columns = [c.cross(arm, column) for column in ((m[0], m[1], m[2]), (m[1], m[3], m[4]), (m[2], m[4], m[5]))]
    moved = tuple(x + columns[k % 3][k // 3] for k, x in enumerate(b))
    before = [c.cross(b[3 * i : 3 * i + 3], arm) for i in range(3)]
    after = [c.cross(moved[3 * i : 3 * i + 3], arm) for i in range(3)]
    return tuple(x - before[i][j] - after[j][i] for x, (i, j) in zip(a, SYMMETRIC, strict=True)), moved, m


def solve(order: Sequence, placed: Placed, factors: Factors, torque: Array, loads: Force | None = None) -> Array:
    """Solve for the accelerations that torques give the steps.

    Args:
        order: the steps' order.
        placed: the steps in the world.
        factors: the factors of their mass matrix.
        torque: (n,) along the steps' coordinates.
        loads: forces that the links need besides, as `link_forces` gives them, or None.

    Returns:
        (n,) accelerations x with M x = torque - (the joint torques of the loads).
    """
    zero, _ = units(torque)
    none = (zero,) * 3

    def give(received: Force, now: Any) -> Any:
        at, factors, torque, own = now
        load = received if own is None else jax.tree.map(jnp.add, own, received)
        left = torque - project(at, load)
        load = c.add(load[0], c.scale(factors.torque, left)), c.add(load[1], c.scale(factors.force, left))
        return to_parent(at, load), left * factors.inverse

    free = inward(order, give, (none, none), (placed, factors, torque, loads))

    def take(state: Any, now: Any) -> Any:
        turning, moving = state
        at, factors, x = now
        moving = c.add(moving, c.cross(turning, at.arm))
        x = x - c.dot(factors.torque, turning) - c.dot(factors.force, moving)
        if at.turn is not None:
            turning = c.add(turning, c.scale(at.turn, x))
        if at.slide is not None:
            moving = c.add(moving, c.scale(at.slide, x))
        return (turning, moving), x

    return outward(order, take, (none, none), (placed, factors, free))
