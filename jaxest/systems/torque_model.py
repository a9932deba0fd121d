"""The robot as a state-space model: explicit Euler steps of its dynamics, as Zakeri 2023 writes them.

q' = q + h v + u1, v' = v + h M^-1 (tau + feedforward - C v - G) + u2, y = q + u3. Everything is float64: variances of
2e-7 beside speeds of 100 rad/s leave float32 no digit.
"""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.kinematics import forward_dynamics
from jaxest.kinematics.inertia import check_inertia
from jaxest.kinematics.robot import Robot
from jaxest.mcmc.model import Model
from jaxest.types import Array, InputError


class Inputs(NamedTuple):
    """What is known of a step, leaves (T - 1, ...)."""

    dt: Array
    """() s, to the next measurement; a gap in a series is a long step, or better many steps without measurement."""
    feedforward: Array
    """(nv,) known torque, N m."""
    segment: Array
    """() int32, which of the piecewise constant torques acts; 0 where there is one."""


def require_float64() -> None:
    """Raise ValueError unless JAX computes in float64."""
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise ValueError(
            "torque: needs float64, JAX is set to float32; call jax.config.update('jax_enable_x64', True) first"
        )


def check_robot(robot: Robot) -> None:
    """Raise InputError for a robot whose coordinates are not all hinges and slides, or which has no inertia."""
    check_inertia(robot)
    if robot.nq != robot.nv:
        raise InputError(f"robot: {robot.nq} coordinates and {robot.nv} velocities, expected hinges and slides only")


@cache
def constant(joints: int, segments: int = 1, passive: bool = False) -> Model:
    """Make the model of unknown torques that are constant, or constant piece by piece.

    Args:
        joints: number of joints.
        segments: number of pieces; theta holds their torques one after the other.
        passive: whether the robot's damping, springs and friction act.

    Returns:
        The model, whose parameters are the robot; the state is (q, v).
    """

    def transition(robot: Robot, theta: Array, x: Array, given: Inputs) -> Array:
        q, v = x[:joints], x[joints:]
        tau = theta.reshape(segments, joints)[given.segment] if segments > 1 else theta
        a = forward_dynamics(robot, q, v, tau + given.feedforward, passive)
        return jnp.concatenate([q + given.dt * v, v + given.dt * a])

    return Model(transition, tuple(range(joints)), 2 * joints, segments * joints)


@cache
def walk(joints: int, passive: bool = False) -> Model:
    """Make the model of an unknown torque that walks at random; it is part of the state (q, v, tau).

    Args:
        joints: number of joints.
        passive: as in `constant`.

    Returns:
        The model, whose parameters are the robot; the noise of tau is per step.
    """

    def transition(robot: Robot, theta: Array, x: Array, given: Inputs) -> Array:
        q, v, tau = x[:joints], x[joints : 2 * joints], x[2 * joints :]
        a = forward_dynamics(robot, q, v, tau + given.feedforward, passive)
        return jnp.concatenate([q + given.dt * v, v + given.dt * a, tau])

    return Model(transition, tuple(range(joints)), 3 * joints, 0)


__all__ = ["Inputs", "check_robot", "constant", "require_float64", "walk"]
