"""A robot, the joints that are estimated and the sensors that look at it: likelihood and rows of one posture."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import Frames, Robot, expand, forward, frame
from jaxest.kinematics.movement import spread
from jaxest.kinematics.moving import moving_frames
from jaxest.kinematics.robot import HINGE
from jaxest.kinematics.space import Space, flat, part, space
from jaxest.kinematics.take import take
from jaxest.manifolds import circle
from jaxest.sensors import Sensor
from jaxest.sensors.joints import chosen, columns
from jaxest.sensors.spec import checked, module
from jaxest.types import Array, PyTree


class Look(NamedTuple):
    """A sensor, and what it looks at."""

    kind: Any
    """Its module."""
    name: str
    rows: tuple[int, ...]
    """Where in `Body.frames` its frames stand, or its joints among the estimated ones of their kind."""
    columns: tuple[int, ...] = ()
    """Where its joints stand in tangent vectors."""


class Body(NamedTuple):
    """What is static in a deflection filter."""

    robot: Robot
    space: Space
    """Where the joints live that are estimated."""
    others: tuple[int, ...]
    """Joints whose coordinates come with the measurement."""
    frames: tuple[int, ...]
    """The frames that any sensor looks at."""
    looks: tuple[Look, ...]

    @property
    def size(self) -> int:
        """The state's dimension d."""
        return self.space.dim


def body(robot: Robot, sensors: Sequence[Sensor], joints: Sequence[str] | None, others: Sequence[str]) -> Body:
    """Look up names.

    Args:
        robot: the robot.
        sensors: the sensors.
        joints: joints to estimate, by name; every hinge that no other joint leads if None.
        others: joints whose coordinates come with the measurement, by name.

    Returns:
        The body.

    Raises:
        InputError: a name does not exist, a joint is free, is coupled or is named twice, or there is none.
    """
    found, rest = chosen(robot, joints, others)
    where = space(robot, found)
    given = checked(sensors)
    frames = tuple(dict.fromkeys(frame(robot, f) for s in given if module(s).FRAMES for f in s.frames))
    looks = [_look(robot, where, frames, sensor) for sensor in given]
    return Body(robot, where, rest, frames, tuple(looks))


def _look(robot: Robot, where: Space, frames: tuple[int, ...], sensor: Sensor) -> Look:
    kind = module(sensor)
    if kind.FRAMES:
        return Look(kind, sensor.name, tuple(frames.index(frame(robot, f)) for f in sensor.frames))
    rows = columns(robot, where.joints, kind.JOINTS, sensor.name, sensor.frames)
    first = where.kinds.index(kind.JOINTS)  # hinges and slides have one number each
    return Look(kind, sensor.name, rows, tuple(first + row for row in rows))


def posture(body: Body, x: PyTree, measurement: PyTree) -> Array:
    """Return the robot's coordinates (nq,): estimated joints from the state x, measured ones, the rest at home."""
    robot, own = body.robot, flat(x)
    parts = [own, jnp.asarray(robot.home, own.dtype)]
    source = list(range(own.shape[0], own.shape[0] + robot.nq))
    if body.others:
        at = np.array([robot.topology.joint_q[j] for j in body.others])
        reading = measurement.others
        valid = jnp.broadcast_to(jnp.asarray(reading.valid, bool), reading.value.shape)
        home = jnp.asarray(robot.home[at], own.dtype)
        parts.append(jnp.where(valid, jnp.asarray(reading.value, own.dtype), home))
        for i, k in enumerate(at):
            source[k] = own.shape[0] + robot.nq + i
    for i, k in enumerate(body.space.coordinates):
        source[k] = i
    q = take(jnp.concatenate(parts), source)
    return expand(robot, q[np.array(robot.topology.free, int)]) if robot.topology.couplings else q


def views(body: Body, x: PyTree, measurement: PyTree) -> list[Any]:
    """Return what each sensor looks at: its joints' angles or ways, or `Frames`."""
    frames = forward(body.robot, posture(body, x, measurement), body.frames)
    return [_view(look, frames, x) for look in body.looks]


def _view(look: Look, frames: Frames, x: PyTree) -> Any:
    return _frames(frames, look.rows) if look.kind.FRAMES else take(part(x, look.kind.JOINTS), look.rows)


def _frames(frames: Frames, rows: Sequence[int]) -> Frames:
    # Component by component, as kinematics lays them out and sensors take them apart: XLA sees through the stacks then.
    def picked(values: Array) -> Array:
        components = [values[:, i] for i in range(values.shape[1])]
        return jnp.stack([jnp.stack([x[i] for x in components]) for i in rows])

    return Frames(*(picked(values) for values in frames))


def read(body: Body, params: PyTree, measurement: PyTree) -> tuple[Array, Array]:
    """Return what encoders say of the joints: angles and ways (d,) rad or m, and how precise, (d,), 0 where none reads.

    The first sensor that reads a joint counts.
    """
    dtype = jnp.result_type(measurement.dt)
    value, weight = jnp.zeros(body.size, dtype), jnp.zeros(body.size, dtype)
    for look in body.looks:
        if look.kind.FRAMES:
            continue
        given, reading, at = getattr(params.sensors, look.name), getattr(measurement, look.name), np.array(look.columns)
        seen = jnp.asarray(reading.value, dtype) - jnp.asarray(given.offset, dtype)
        valid = jnp.broadcast_to(jnp.asarray(reading.valid, bool), seen.shape) & (weight[at] == 0)
        seen = circle.wrap(seen) if look.kind.JOINTS == HINGE else seen
        value = value.at[at].set(jnp.where(valid, seen, value[at]))
        precision = jnp.asarray(look.kind.precision(given), dtype)
        weight = weight.at[at].set(jnp.where(valid, precision, weight[at]))
    return value, weight


def log_likelihood(body: Body, params: PyTree, x: PyTree, measurement: PyTree) -> Array:
    """Return the log-density () of all that is there in a measurement; Sato 2023, eq. 23."""
    total = jnp.zeros((), flat(x).dtype)
    for look, view in zip(body.looks, views(body, x, measurement), strict=True):
        given, reading = getattr(params.sensors, look.name), getattr(measurement, look.name)
        total = total + look.kind.log_prob(given, reading, view)
    return total


def rows(body: Body, params: PyTree, x: PyTree, measurement: PyTree) -> tuple[Array, Array]:
    """Return all residuals (m,) and their derivatives (m, d), by the frames' geometric Jacobians."""
    frames, jacobian = _moving(body, posture(body, x, measurement))
    identity = np.eye(body.size)
    parts: list[tuple[Array, Array]] = []
    for look in body.looks:
        given, reading = getattr(params.sensors, look.name), getattr(measurement, look.name)
        if look.kind.FRAMES:
            moved = jnp.stack([jacobian[i] for i in look.rows])
        else:
            moved = jnp.asarray(identity[list(look.columns)], flat(x).dtype)
        parts.append(look.kind.rows(given, reading, _view(look, frames, x), moved))
    value, slope = (jnp.concatenate(part) for part in zip(*parts, strict=True))
    return value, slope


def _moving(body: Body, q: Array) -> tuple[Frames, Array]:
    """Return the frames and their Jacobians (n, 6, d) with respect to the estimated joints."""
    robot = body.robot
    if robot.topology.couplings:
        frames, jacobian = moving_frames(robot, q, body.frames)
        return frames, jnp.matmul(jacobian, spread(robot, body.space.joints, q), precision=jax.lax.Precision.HIGHEST)
    return moving_frames(robot, q, body.frames, body.space.velocities)


__all__ = ["Body", "Look", "body", "log_likelihood", "posture", "read", "rows", "views"]
