"""Joint torques that act without a motor: damping, springs and friction loss."""

import jax.numpy as jnp
import numpy as np

from jaxest.kinematics.forward import configuration
from jaxest.kinematics.robot import BALL, FREE, NV, Robot
from jaxest.manifolds import quaternion
from jaxest.types import Array, ArrayLike


def passive_torque(robot: Robot, q: ArrayLike, v: ArrayLike) -> Array:
    """Compute the torques of joint damping, springs and friction loss.

    Damping and springs are MuJoCo's `qfrc_passive` of joints. Friction loss is Coulomb's sliding friction,
    -friction_loss sign(v), which is what MuJoCo's constraint solver gives while a joint slides; at v = 0 it is zero
    here, so a joint at rest does not stick, and its derivative in v is zero.

    Args:
        robot: the robot; differentiable in its damping, stiffness, spring reference and friction loss.
        q: (nq,) joint coordinates, rad or m; batch with `jax.vmap`.
        v: (nv,) velocities, rad/s or m/s.

    Returns:
        (nv,) N m (N for slides and a free joint's translation).

    Raises:
        ValueError: an argument has the wrong shape.
    """
    q, v = configuration(robot, q), jnp.asarray(v)
    if v.shape != (robot.nv,):
        raise ValueError(f"v: shape {v.shape}, expected ({robot.nv},); batch with jax.vmap")
    damping, loss, stiffness, rest = (
        jnp.asarray(x, q.dtype) for x in (robot.damping, robot.friction_loss, robot.stiffness, robot.spring_reference)
    )
    owner = np.repeat(np.arange(len(robot.joint_names)), [NV[kind] for kind in robot.topology.joint_kind])
    return -damping * v - loss * jnp.sign(v) - stiffness[owner] * _stretch(robot, q, rest)


def _stretch(robot: Robot, q: Array, rest: Array) -> Array:
    """Return how far each spring is from its rest, (nv,)."""
    if robot.nq == robot.nv:
        return q - rest
    parts = [jnp.zeros((0,), q.dtype)]
    for kind, at in zip(robot.topology.joint_kind, robot.topology.joint_q, strict=True):
        if kind in (BALL, FREE):
            turn = at + (3 if kind == FREE else 0)
            parts += [q[at:turn] - rest[at:turn], quaternion.local(rest[turn : turn + 4], q[turn : turn + 4])]
        else:
            parts.append(q[at : at + 1] - rest[at : at + 1])
    return jnp.concatenate(parts)
