"""Dynamics of a robot: joint torques from accelerations, accelerations from joint torques.

M(q) a + h(q, v) = tau, with MuJoCo's coordinates: a is the time derivative of MuJoCo's v. No contacts, no limits, no
equality constraints: coupled joints move on their own.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from jaxest.kinematics import components as c
from jaxest.kinematics.articulated import factorise, solve
from jaxest.kinematics.fold import fold
from jaxest.kinematics.forward import configuration
from jaxest.kinematics.gravity import gravity_torque
from jaxest.kinematics.inertia import check_inertia, lump
from jaxest.kinematics.passive import passive_torque
from jaxest.kinematics.recursion import Placed, composite_forces, joint_torques, link_forces, place, points
from jaxest.kinematics.robot import Robot
from jaxest.kinematics.rows import Numbers, gyration, masses, places
from jaxest.kinematics.sequence import Sequence, sequence
from jaxest.types import Array, ArrayLike

__all__ = [
    "bias_force",
    "forward_dynamics",
    "gravity_torque",
    "inverse_dynamics",
    "mass_matrix",
    "passive_torque",
]


def inverse_dynamics(robot: Robot, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
    """Compute the joint torques that a motion needs: M a + h, by recursive Newton-Euler.

    Args:
        robot: the robot; differentiable in its masses, inertias, offsets, axes, armature and gravity.
        q: (nq,) joint coordinates, rad or m; batch with `jax.vmap`.
        v: (nv,) velocities as MuJoCo has them, rad/s or m/s.
        a: (nv,) their time derivative, rad/s2 or m/s2.

    Returns:
        (nv,) N m (N for slides and a free joint's translation), without damping, springs or friction.

    Raises:
        ValueError: an argument has the wrong shape.
        InputError: a moving body has no inertia.

    Source: Featherstone, "Rigid Body Dynamics Algorithms", 2008, table 5.1.
    """
    q, v, a = _arguments(robot, q, v=v, a=a)
    return _inverse_dynamics(sequence(robot.topology), _numbers(robot, q.dtype), q, v, a)


def bias_force(robot: Robot, q: ArrayLike, v: ArrayLike) -> Array:
    """Compute the joint torques that a motion without acceleration needs: gravity, centrifugal and Coriolis forces.

    Args:
        robot: the robot, as in `inverse_dynamics`.
        q: (nq,) joint coordinates, rad or m; batch with `jax.vmap`.
        v: (nv,) velocities, rad/s or m/s.

    Returns:
        (nv,) h in N m (N for slides and a free joint's translation); MuJoCo's `qfrc_bias`.

    Raises:
        ValueError: an argument has the wrong shape.
        InputError: a moving body has no inertia.
    """
    q, v = _arguments(robot, q, v=v)
    return _inverse_dynamics(sequence(robot.topology), _numbers(robot, q.dtype), q, v, None)


def mass_matrix(robot: Robot, q: ArrayLike) -> Array:
    """Compute the joint-space inertia matrix, armature included, by composite rigid bodies.

    Args:
        robot: the robot, as in `inverse_dynamics`.
        q: (nq,) joint coordinates, rad or m; batch with `jax.vmap`.

    Returns:
        (nv, nv) M in kg m2 (kg where both coordinates slide, kg m where one does), symmetric.

    Raises:
        ValueError: q has the wrong shape.
        InputError: a moving body has no inertia.

    Source: Featherstone, "Rigid Body Dynamics Algorithms", 2008, table 6.2.
    """
    (q,) = _arguments(robot, q)
    return _mass_matrix(sequence(robot.topology), _numbers(robot, q.dtype), q)


def forward_dynamics(robot: Robot, q: ArrayLike, v: ArrayLike, tau: ArrayLike, passive: bool = False) -> Array:
    """Compute the accelerations that joint torques cause, without any constraint.

    Costs O(nv). The derivative solves with the same factors instead of differentiating the solve.

    Args:
        robot: the robot, as in `inverse_dynamics`; with `passive` also in its passive terms.
        q: (nq,) joint coordinates, rad or m; batch with `jax.vmap`.
        v: (nv,) velocities, rad/s or m/s.
        tau: (nv,) torques, N m (N for slides and a free joint's translation).
        passive: static; whether to add `passive_torque`: damping, springs and friction loss.

    Returns:
        (nv,) accelerations, rad/s2 or m/s2: MuJoCo's `qacc_smooth`, save friction loss (see `passive_torque`) and what
        `robot.notes` says was left out.

    Raises:
        ValueError: an argument has the wrong shape.
        InputError: a moving body has no inertia.

    Source: Featherstone, "Rigid Body Dynamics Algorithms", 2008, table 7.1.
    """
    q, v, tau = _arguments(robot, q, v=v, tau=tau)
    if passive:
        tau = tau + passive_torque(robot, q, v)
    return _accelerations(sequence(robot.topology), _numbers(robot, q.dtype), q, v, tau)


def _arguments(robot: Robot, q: ArrayLike, **vectors: ArrayLike) -> tuple[Array, ...]:
    """Check shapes and bring all to one floating type."""
    check_inertia(robot)
    q = configuration(robot, q)
    checked = {name: jnp.asarray(value) for name, value in vectors.items()}
    for name, value in checked.items():
        if value.shape != (robot.nv,):
            raise ValueError(f"{name}: shape {value.shape}, expected ({robot.nv},); batch with jax.vmap")
    dtype = jnp.result_type(q, *checked.values())
    return tuple(x.astype(dtype) for x in (q, *checked.values()))


def _numbers(robot: Robot, dtype: Any) -> Numbers:
    folded = fold(robot)
    lumps = lump(robot, folded)
    numbers = (
        *(folded.translation, folded.quaternion, folded.axis, robot.joint_reference),
        *(lumps.mass, lumps.moment, lumps.inertia, robot.armature, robot.gravity),
    )
    return Numbers(*(jnp.asarray(x, dtype) for x in numbers))


def _place(order: Sequence, numbers: Numbers, q: Array) -> Placed:
    return place(order, places(order, numbers, q), masses(order, numbers))


def _in_order(order: Sequence, vector: Array) -> Array:
    """Bring a vector over v into the order of the steps."""
    return vector if order.velocity == tuple(range(len(order.velocity))) else vector[np.array(order.velocity)]


def _out_of_order(order: Sequence, vector: Array) -> Array:
    """Bring a vector over the steps into the order of v."""
    return vector if order.velocity == tuple(range(len(order.velocity))) else vector[np.argsort(order.velocity)]


@partial(jax.jit, static_argnums=0)
def _inverse_dynamics(order: Sequence, numbers: Numbers, q: Array, v: Array, a: Array | None) -> Array:
    if not order.joint:
        return jnp.zeros((0,), q.dtype)
    placed = _place(order, numbers, q)
    rates = _in_order(order, v)
    wanted = None if a is None else _in_order(order, a)
    loads = link_forces(order, placed, numbers.gravity, rates, wanted, gyration(order, rates))
    torque = _out_of_order(order, joint_torques(order, placed, loads))
    return torque if a is None else torque + numbers.armature * a


@partial(jax.jit, static_argnums=0)
def _mass_matrix(order: Sequence, numbers: Numbers, q: Array) -> Array:
    count = len(order.joint)
    if not count:
        return jnp.zeros((0, 0), q.dtype)
    placed = _place(order, numbers, q)
    steps = (placed.turn, placed.slide, points(order, placed), *composite_forces(order, placed))
    turn, slide, point, torque, force = jax.tree.map(partial(_out_of_order, order), steps)
    back = np.argsort(order.velocity)
    above = _ancestors(order)[back][:, back]

    def row(
        _: None, outer: Any
    ) -> Any:  # a row at a time: all at once XLA would go through the batch with large strides
        point_there, torque_there, force_there, carries = outer
        entries: Any = 0
        if turn is not None:
            arm = c.sub(point_there, point)
            entries = c.dot(turn, c.add(torque_there, c.cross(arm, force_there)))
        if slide is not None:
            entries = entries + c.dot(slide, force_there)
        return None, jnp.where(carries, entries, 0)

    half = jax.lax.scan(row, None, (point, torque, force, above.T))[1]
    return half + half.T * (1 - np.eye(count, dtype=q.dtype)) + jnp.diag(numbers.armature)


def _ancestors(order: Sequence) -> np.ndarray:
    """Tell whether step i is step j or lies between it and the world, (n, n)."""
    found = np.eye(len(order.parent), dtype=bool)
    for step, parent in enumerate(order.parent):
        if parent >= 0:
            found[:, step] |= found[:, parent]
    return found


@partial(jax.jit, static_argnums=0)
def _accelerations(order: Sequence, numbers: Numbers, q: Array, v: Array, tau: Array) -> Array:
    return _forward_dynamics(order, numbers, q, v, tau) if order.joint else jnp.zeros((0,), q.dtype)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _forward_dynamics(order: Sequence, numbers: Numbers, q: Array, v: Array, tau: Array) -> Array:
    return _solved(order, numbers, q, v, tau)[0]


def _solved(order: Sequence, numbers: Numbers, q: Array, v: Array, tau: Array) -> Any:
    """Return the accelerations, and what solves again with the same mass matrix."""
    placed = _place(order, numbers, q)
    rates = _in_order(order, v)
    loads = link_forces(order, placed, numbers.gravity, rates, None, gyration(order, rates))
    factors = factorise(order, placed, _in_order(order, numbers.armature))
    found = solve(order, placed, factors, _in_order(order, tau), loads)
    return _out_of_order(order, found), (placed, factors)


@partial(_forward_dynamics.defjvp, symbolic_zeros=True)
def _forward_dynamics_jvp(order: Sequence, primals: Any, tangents: Any) -> tuple[Array, Array]:
    """Differentiate M a + h = tau: M da = dtau - d(M a + h) at constant a."""
    numbers, q, v, tau = primals
    a, (placed, factors) = _solved(order, numbers, q, v, tau)
    leaves, tree = jax.tree.flatten((numbers, q, v))
    dots = jax.tree.leaves(tuple(tangents[:-1]), is_leaf=lambda x: isinstance(x, SymbolicZero))
    moved = [k for k, dot in enumerate(dots) if not isinstance(dot, SymbolicZero)]
    rest = jnp.zeros_like(tau) if isinstance(tangents[-1], SymbolicZero) else tangents[-1]

    def torque(changed: list[Array]) -> Array:
        now = list(leaves)
        for k, leaf in zip(moved, changed, strict=True):
            now[k] = leaf
        return _inverse_dynamics(order, *jax.tree.unflatten(tree, now), a)

    if moved:
        rest = rest - jax.jvp(torque, ([leaves[k] for k in moved],), ([dots[k] for k in moved],))[1]
    return a, _out_of_order(order, solve(order, placed, factors, _in_order(order, rest)))
