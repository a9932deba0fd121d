"""A robot, the joints that are estimated and the sensors that look at it: likelihood and rows of one posture."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import Frames, Robot, expand, forward, frame
from jaxest.kinematics.movement import spread
from jaxest.kinematics.moving import moving_frames
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
    """Where in `Body.frames` its frames stand, or in `Body.joints` its joints."""


class Body(NamedTuple):
    """What is static in a deflection filter."""

    robot: Robot
    joints: tuple[int, ...]
    """The d joints that are estimated, by number."""
    others: tuple[int, ...]
    """Joints whose coordinates come with the measurement."""
    frames: tuple[int, ...]
    """The frames that any sensor looks at."""
    looks: tuple[Look, ...]

    @property
    def size(self) -> int:
        """The state's dimension d."""
        return len(self.joints)


def body(robot: Robot, sensors: Sequence[Sensor], joints: Sequence[str] | None, others: Sequence[str]) -> Body:
    """Look up names.

    Args:
        robot: the robot.
        sensors: the sensors.
        joints: hinges to estimate, by name; every hinge that no other joint leads if None.
        others: joints whose coordinates come with the measurement, by name.

    Returns:
        The body.

    Raises:
        InputError: a name does not exist, a joint is not a hinge, is coupled or is named twice, or there is none.
    """
    found, rest = chosen(robot, joints, others)
    given = checked(sensors)
    frames = tuple(dict.fromkeys(frame(robot, f) for s in given if module(s).FRAMES for f in s.frames))
    looks = [Look(module(s), s.name, _rows(robot, found, frames, s)) for s in given]
    return Body(robot, found, rest, frames, tuple(looks))


def _rows(robot: Robot, joints: tuple[int, ...], frames: tuple[int, ...], sensor: Sensor) -> tuple[int, ...]:
    if module(sensor).FRAMES:
        return tuple(frames.index(frame(robot, f)) for f in sensor.frames)
    return columns(robot, joints, sensor.name, sensor.frames)


def posture(body: Body, x: Array, measurement: PyTree) -> Array:
    """Return the whole robot's coordinates (nq,): estimated joints from x (d,), measured ones, the rest at home."""
    robot = body.robot
    parts = [x, jnp.asarray(robot.home, x.dtype)]
    source = list(range(body.size, body.size + robot.nq))
    if body.others:
        at = np.array([robot.topology.joint_q[j] for j in body.others])
        reading = measurement.others
        valid = jnp.broadcast_to(jnp.asarray(reading.valid, bool), reading.value.shape)
        parts.append(jnp.where(valid, jnp.asarray(reading.value, x.dtype), jnp.asarray(robot.home[at], x.dtype)))
        for i, k in enumerate(at):
            source[k] = body.size + robot.nq + i
    for i, joint in enumerate(body.joints):
        source[robot.topology.joint_q[joint]] = i
    q = take(jnp.concatenate(parts), source)
    return expand(robot, q[np.array(robot.topology.free, int)]) if robot.topology.couplings else q


def views(body: Body, x: Array, measurement: PyTree) -> list[Any]:
    """Return what each sensor looks at: its joints' angles, or `Frames`."""
    frames = forward(body.robot, posture(body, x, measurement), body.frames)
    return [_frames(frames, look.rows) if look.kind.FRAMES else take(x, look.rows) for look in body.looks]


def _frames(frames: Frames, rows: Sequence[int]) -> Frames:
    return Frames(*(jnp.stack([values[i] for i in rows]) for values in frames))


def read(body: Body, params: PyTree, measurement: PyTree) -> tuple[Array, Array]:
    """Return what encoders say of the joints: angles (d,) rad, and concentrations (d,), 0 where none reads.

    The first sensor that reads a joint counts.
    """
    dtype = jnp.result_type(measurement.dt)
    angle, weight = jnp.zeros(body.size, dtype), jnp.zeros(body.size, dtype)
    for look in body.looks:
        if look.kind.FRAMES:
            continue
        given, reading, at = getattr(params.sensors, look.name), getattr(measurement, look.name), np.array(look.rows)
        seen = jnp.asarray(reading.value, dtype) - jnp.asarray(given.offset, dtype)
        valid = jnp.broadcast_to(jnp.asarray(reading.valid, bool), seen.shape) & (weight[at] == 0)
        angle = angle.at[at].set(jnp.where(valid, circle.wrap(seen), angle[at]))
        weight = weight.at[at].set(jnp.where(valid, jnp.asarray(given.concentration, dtype), weight[at]))
    return angle, weight


def log_likelihood(body: Body, params: PyTree, x: Array, measurement: PyTree) -> Array:
    """Return the log-density () of all that is there in a measurement; Sato 2023, eq. 23."""
    total = jnp.zeros((), x.dtype)
    for look, view in zip(body.looks, views(body, x, measurement), strict=True):
        given, reading = getattr(params.sensors, look.name), getattr(measurement, look.name)
        total = total + look.kind.log_prob(given, reading, view)
    return total


def rows(body: Body, params: PyTree, x: Array, measurement: PyTree) -> tuple[Array, Array]:
    """Return all residuals (m,) and their derivatives (m, d), by the frames' geometric Jacobians."""
    frames, jacobian = _moving(body, posture(body, x, measurement))
    identity = np.eye(body.size)
    parts: list[tuple[Array, Array]] = []
    for look in body.looks:
        given, reading = getattr(params.sensors, look.name), getattr(measurement, look.name)
        if look.kind.FRAMES:
            moved = jnp.stack([jacobian[i] for i in look.rows])
            parts.append(look.kind.rows(given, reading, _frames(frames, look.rows), moved))
        else:
            own = jnp.asarray(identity[list(look.rows)], x.dtype)
            parts.append(look.kind.rows(given, reading, take(x, look.rows), own))
    value, slope = (jnp.concatenate(part) for part in zip(*parts, strict=True))
    return value, slope


def _moving(body: Body, q: Array) -> tuple[Frames, Array]:
    """Return the frames and their Jacobians (n, 6, d) with respect to the estimated joints."""
    robot = body.robot
    if robot.topology.couplings:
        frames, jacobian = moving_frames(robot, q, body.frames)
        return frames, jnp.matmul(jacobian, spread(robot, body.joints, q), precision=jax.lax.Precision.HIGHEST)
    return moving_frames(robot, q, body.frames, [robot.topology.joint_v[j] for j in body.joints])


__all__ = ["Body", "Look", "body", "log_likelihood", "posture", "read", "rows", "views"]
