"""How a robot's joints move on their manifold: steps, room within limits, configurations spread over them."""

import jax.numpy as jnp
import numpy as np

from jaxest.kinematics.fold import carriers
from jaxest.kinematics.robot import BALL, FREE, HINGE, NV, SLIDE, Robot, Topology, expand
from jaxest.manifolds import quaternion
from jaxest.types import Array


def scalars(topology: Topology) -> list[int]:
    """Return the joints with a single coordinate: hinges and slides."""
    return [j for j, kind in enumerate(topology.joint_kind) if kind in (HINGE, SLIDE)]


def scattered(robot: Robot, q: Array, index: Array) -> Array:
    """Return a configuration of a sequence that fills the limits evenly; free joints stay.

    Source: the additive recurrence of Roberts 2018 (The unreasonable effectiveness of quasirandom sequences).
    """
    root = 2.0
    for _ in range(40):
        root = (1 + root) ** (1 / (robot.nq + 1))
    pace = jnp.asarray(root ** -np.arange(1.0, robot.nq + 1), q.dtype)
    return spot(robot, q, (0.5 + index * pace) % 1)


def spot(robot: Robot, q: Array, share: Array) -> Array:
    """Place each coordinate at a share of its range; half a turn either way, or half a metre, where it is endless."""
    topology = robot.topology
    scalar = np.zeros(robot.nq, bool)
    turns = np.zeros(robot.nq, bool)
    for kind, at in zip(topology.joint_kind, topology.joint_q, strict=True):
        scalar[at] = kind in (HINGE, SLIDE)
        turns[at] = kind == HINGE
        turns[at : at + 4] |= kind == BALL
    limits = jnp.asarray(robot.limits, q.dtype)
    reach = jnp.where(turns, jnp.pi, 0.5).astype(q.dtype)
    middle = jnp.where(turns, 0, q)
    low, high = (
        jnp.where(jnp.isfinite(limit), limit, middle + side * reach)
        for limit, side in ((limits[:, 0], -1), (limits[:, 1], 1))
    )
    return moved(robot, jnp.where(scalar | turns, low + share * (high - low), q), jnp.zeros((robot.nv,), q.dtype))


def movers(topology: Topology, frames: tuple[str, ...]) -> tuple[int, ...]:
    """Return the joints without a leader that move some of the frames, on the way to them or by coupling."""
    carried = carriers(topology)
    found: set[int] = set()
    for name in frames:
        joint = carried.frame[topology.frame_names.index(name)]
        while joint >= 0:
            found.add(joint)
            joint = carried.joint[joint]
    for joint, leader in reversed(topology.couplings):
        if joint in found:
            found |= {leader} if leader >= 0 else set()
    return tuple(sorted(found - {joint for joint, _ in topology.couplings}))


def followers(topology: Topology, movers: tuple[int, ...]) -> list[int]:
    """Return the joints that the movers lead, also by way of others."""
    led = list(movers)
    for joint, leader in topology.couplings:
        led += [joint] if leader in led else []
    return led[len(movers) :]


def spread(robot: Robot, movers: tuple[int, ...], q: Array) -> Array:
    """Return how v follows from the velocities of the movers, (nv, n)."""
    topology = robot.topology
    rows = [np.arange(topology.joint_v[j], topology.joint_v[j] + NV[topology.joint_kind[j]]) for j in movers]
    own = np.eye(robot.nv, dtype=q.dtype)[:, np.concatenate([*rows, np.zeros(0, int)])]
    spread = jnp.asarray(own)
    for (joint, leader), coefficients in zip(topology.couplings, robot.coupling, strict=True):
        if leader < 0:
            continue
        at = topology.joint_q[leader]
        x = q[at] - jnp.asarray(robot.joint_reference, q.dtype)[at]
        slope = jnp.polyval(jnp.polyder(jnp.asarray(coefficients, q.dtype)[::-1]), x)
        spread = spread.at[topology.joint_v[joint]].set(slope * spread[topology.joint_v[leader]])
    return spread


def room(robot: Robot, movers: tuple[int, ...], q: Array) -> tuple[Array, Array]:
    """Return how far each mover can go down and up, (n,) each, infinite for balls and free joints."""
    low: list[Array] = []
    high: list[Array] = []
    limits = jnp.asarray(robot.limits, q.dtype)
    for joint in movers:
        kind, at = robot.topology.joint_kind[joint], robot.topology.joint_q[joint]
        if kind in (BALL, FREE):
            endless = jnp.full((NV[kind],), jnp.inf, q.dtype)
            low, high = [*low, -endless], [*high, endless]
        else:
            low, high = [*low, limits[at : at + 1, 0] - q[at]], [*high, limits[at : at + 1, 1] - q[at]]
    return jnp.concatenate(low), jnp.concatenate(high)


def coupled(robot: Robot, q: Array) -> Array:
    """Return a configuration with the coupled joints where their leaders put them."""
    free = robot.topology.free
    return expand(robot, q[np.array(free)]) if len(free) < robot.nq else q


def moved(robot: Robot, q: Array, v: Array) -> Array:
    """Return where a robot stands after moving at velocity v (nv,) for 1 s, each rotation about a fixed axis."""
    if robot.nq == robot.nv:
        return q + v
    parts: list[Array] = []
    topology = robot.topology
    for kind, at, rate in zip(topology.joint_kind, topology.joint_q, topology.joint_v, strict=True):
        if kind in (BALL, FREE):
            shift = 3 if kind == FREE else 0
            parts.append(q[at : at + shift] + v[rate : rate + shift])
            turn, spin = q[at + shift : at + shift + 4], v[rate + shift : rate + shift + 3]
            parts.append(quaternion.retract(quaternion.normalize(turn), spin))
        else:
            parts.append(q[at : at + 1] + v[rate : rate + 1])
    return jnp.concatenate(parts)
