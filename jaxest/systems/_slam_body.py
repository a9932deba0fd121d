"""What is static in a whole-body SLAM: the robot, the joints with a bias, and the rays that each link casts."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.kinematics import Robot, expand, frame
from jaxest.kinematics.movement import spread
from jaxest.kinematics.moving import moving_frames
from jaxest.kinematics.robot import BALL, FREE, NV
from jaxest.manifolds import Euclidean, product, quaternion
from jaxest.sensors.proximity import Proximity
from jaxest.types import Array, InputError


class Mean(NamedTuple):
    """The state's mean: an element of `manifold(body)`."""

    position: Array
    """(3,) m, of a free root in the world; where the root stands if it is fixed."""
    quaternion: Array
    """(4,) wxyz, root to world."""
    bias: Array
    """(n,) rad or m, reading less coordinate of each joint with an encoder."""


class Rays(NamedTuple):
    """The zones of each link, padded to the most that any link has."""

    index: NDArray[np.int64]  # type: ignore[assignment]  # the word hides a method of tuple
    """(L, Z) where in a reading (R,) a zone stands; R where there is none."""
    origin: NDArray[np.float64]
    """(L, Z, 3) m, in the link."""
    direction: NDArray[np.float64]
    """(L, Z, 3), in the link."""
    minimum: NDArray[np.float64]
    """(L, Z) m."""
    maximum: NDArray[np.float64]
    """(L, Z) m."""
    sensors: NDArray[np.int64]
    """(L,) how many cast them."""
    sensor: NDArray[np.int64]
    """(L, Z) which of the link's."""


class Body(NamedTuple):
    """A robot with its sensors; hashed by identity."""

    robot: Robot
    root: int | None
    """The free joint, if there is one."""
    joints: tuple[int, ...]
    """Hinges and slides that no other joint leads: those with an encoder."""
    links: tuple[int, ...]
    """All bodies, in the order of the estimate."""
    scanned: tuple[int, ...]
    """Bodies with sensors, parents first."""
    rays: Rays
    readings: int
    """R, zones of all sensors."""

    @property
    def size(self) -> int:
        """The state's dimension D: six for a free root, one for each joint."""
        return (6 if self.root is not None else 0) + len(self.joints)


def body(robot: Robot, sensors: Sequence[Proximity]) -> Body:
    """Look up frames and lay out rays.

    Args:
        robot: the robot: a tree of hinges and slides, whose root is fixed or free.
        sensors: ranging sensors on any of its frames.

    Returns:
        The body.

    Raises:
        InputError: no sensor, an unknown frame (the closest are named), a ball joint, or a free joint that is not the
            root's.
    """
    topology = robot.topology
    kinds = topology.joint_kind
    if not sensors:
        raise InputError("sensors: there is none")
    if BALL in kinds:
        raise InputError(f"joint {robot.joint_names[kinds.index(BALL)]!r} is a ball, expected hinges and slides")
    if FREE in kinds[1:]:
        raise InputError("a free joint other than the first: expected one free root at most")
    led = {joint for joint, _ in topology.couplings}
    root = 0 if kinds and kinds[0] == FREE else None
    joints = tuple(j for j in range(len(kinds)) if kinds[j] != FREE and j not in led)
    scanned, rays, total = _rays(robot, sensors)
    return Body(robot, root, joints, tuple(range(len(topology.body_names))), scanned, rays, total)


def check_sizes(**sizes: int) -> None:
    """Raise ValueError for a size below 1."""
    for name, size in sizes.items():
        if size < 1:
            raise ValueError(f"{name}: got {size}, expected at least 1")


def _rays(robot: Robot, sensors: Sequence[Proximity]) -> tuple[tuple[int, ...], Rays, int]:
    bodies = len(robot.topology.body_names)
    owners: list[int] = []
    parts: list[tuple[Any, ...]] = []
    start = 0
    for one in sensors:
        at = frame(robot, one.frame)
        origin, away = np.asarray(one.position, float), np.asarray(one.directions, float)
        _check(one, origin, away)
        if at >= bodies:
            site = at - bodies
            turn = np.asarray(quaternion.to_matrix(np.asarray(robot.site_quaternion[site])), float)
            origin = np.asarray(robot.site_position[site]) + turn @ origin
            away, at = away @ turn.T, robot.topology.site_body[site]
            if at < 0:
                raise InputError(f"sensor on {one.frame!r}: that site is the world's, expected one of the robot's")
        owners.append(at)
        parts.append((np.arange(start, start + len(away)), np.tile(origin, (len(away), 1)), away,
                      np.full(len(away), one.minimum), np.full(len(away), one.maximum),
                      np.full(len(away), owners[:-1].count(at))))  # fmt: skip
        start += len(away)
    scanned = tuple(sorted(set(owners)))
    most = max(sum(len(p[0]) for p, o in zip(parts, owners, strict=True) if o == link) for link in scanned)
    fill = (start, np.zeros(3), np.array([1.0, 0, 0]), 0.0, 0.0, 0)
    rows = []
    for link in scanned:
        mine = [p for p, o in zip(parts, owners, strict=True) if o == link]
        joined = [np.concatenate(column) for column in zip(*mine, strict=True)]
        spare = most - len(joined[0])
        rows.append([np.concatenate([c, np.repeat(np.asarray(f)[None], spare, axis=0)])
                     for c, f in zip(joined, fill, strict=True)])  # fmt: skip
    counts = np.array([owners.count(link) for link in scanned])
    index, origin, direction, minimum, maximum, sensor = (np.stack(column) for column in zip(*rows, strict=True))
    return scanned, Rays(index, origin, direction, minimum, maximum, counts, sensor), start


def _check(one: Proximity, origin: NDArray[np.float64], away: NDArray[np.float64]) -> None:
    if origin.shape != (3,) or away.ndim != 2 or away.shape[1] != 3 or not len(away):
        raise InputError(
            f"sensor on {one.frame!r}: position {origin.shape} and directions {away.shape}, expected (3,) and (Z, 3)"
        )
    if np.abs(np.linalg.norm(away, axis=1) - 1).max() > 1e-3:
        raise InputError(f"sensor on {one.frame!r}: directions of length {np.linalg.norm(away, axis=1)}, expected 1")
    if not 0 <= one.minimum < one.maximum:
        raise InputError(
            f"sensor on {one.frame!r}: ranges from {one.minimum} to {one.maximum} m, expected 0 <= min < max"
        )


def manifold(body: Body) -> product.Product:
    """Return where `Mean` lives; its tangent is [position, rotation in the root, biases]."""
    parts: Any = (Euclidean((3,)), quaternion, Euclidean((len(body.joints),)))
    return product.of(Mean(*parts))


def retract(body: Body, mean: Mean, v: Array) -> Mean:
    """Move a mean along the state's tangent (D,)."""
    if body.root is None:
        return mean._replace(bias=mean.bias + v)
    return manifold(body).retract(mean, v)


def home(body: Body, dtype: Any) -> Mean:
    """Return the mean that has seen no data: the root at its home, no bias."""
    position, turn = jnp.zeros(3, dtype), jnp.zeros(4, dtype).at[0].set(1)
    if body.root is not None:
        at = jnp.asarray(body.robot.home[:7], dtype)
        position, turn = at[:3], quaternion.normalize(at[3:])
    return Mean(position, turn, jnp.zeros(len(body.joints), dtype))


def posture(body: Body, mean: Mean, reading: Array) -> Array:
    """Return q (nq,) of encoder readings (n,) less their biases, and of the root."""
    robot = body.robot
    q = jnp.asarray(robot.home, reading.dtype)
    at = np.array([robot.topology.joint_q[j] for j in body.joints], int)
    q = q.at[at].set(reading - mean.bias)
    if body.root is not None:
        q = q.at[:7].set(jnp.concatenate([mean.position, mean.quaternion]))
    return expand(robot, q[np.array(robot.topology.free, int)]) if robot.topology.couplings else q


class Links(NamedTuple):
    """Poses of bodies, and how the state moves them."""

    position: Array
    """(n, 3) m."""
    rotation: Array
    """(n, 3, 3), link to world."""
    turn: Array
    """(n, 3, D) rotation, along the world's axes, by the state's tangent."""
    travel: Array
    """(n, 3, D) translation of the origin."""


def links(body: Body, mean: Mean, reading: Array, which: Sequence[int]) -> Links:
    """Compute the poses of bodies at a mean, with their derivatives by the state's tangent."""
    robot, q = body.robot, posture(body, mean, reading)
    roots = [robot.topology.joint_v[body.root] + i for i in range(6)] if body.root is not None else []
    columns = [*roots, *(robot.topology.joint_v[j] for j in body.joints)]
    if robot.topology.couplings:
        frames, jacobian = moving_frames(robot, q, list(which))
        movers = (*((body.root,) if body.root is not None else ()), *body.joints)
        jacobian = jnp.matmul(jacobian, spread(robot, movers, q), precision=jax.lax.Precision.HIGHEST)
    else:
        frames, jacobian = moving_frames(robot, q, list(which), columns)
    sign = np.concatenate([np.ones(len(roots)), -np.ones(len(body.joints))])  # a bias takes away
    jacobian = jacobian * jnp.asarray(sign, q.dtype)[None, None]
    rotation = jax.vmap(quaternion.to_matrix)(frames.quaternion)
    return Links(frames.position, rotation, jacobian[:, :3], jacobian[:, 3:])


__all__ = [
    "NV", "Body", "Links", "Mean", "Rays", "body", "check_sizes", "home", "links", "manifold", "posture", "retract",
]  # fmt: skip
