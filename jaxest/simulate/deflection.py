"""A robot that bends under its own weight, and what its sensors make of it.

The simulation knows more than the filter assumes: joints give in proportion to the torque that holds them, encoders
read the angles that were commanded, attitude filters drift in yaw, and markers are out of sight for a while.
"""

from collections.abc import Callable, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import Frames, Robot, forward, frame, gravity_torque
from jaxest.kinematics.movement import moved
from jaxest.kinematics.space import part, space, unflat
from jaxest.manifolds import quaternion as quat
from jaxest.sensors import Sensor, default_params, measurement_type
from jaxest.sensors.joints import chosen, columns
from jaxest.sensors.spec import checked, module
from jaxest.simulate import trajectories
from jaxest.simulate.noise import coloured
from jaxest.types import Array, ArrayLike, PyTree, Reading

G = 9.80665  # m/s2


class Faults(NamedTuple):
    """How bad robot and sensors are."""

    compliance: ArrayLike = 0.033
    """() or (d,) rad/(N m), how far joints give, m/N for slides. Source: Sato 2023, section IV-B."""
    encoder: ArrayLike = 0.003
    """() rad, standard deviation of a hinge's reading."""
    way: ArrayLike = 0.001
    """() m, of a slide's."""
    drift: ArrayLike = 0.0017
    """() rad/s, of the yaw of every orientation in the world: left on the first such sensor, right on the next, and
    so on."""
    yaw_walk: ArrayLike = 0.002
    """() rad/sqrt(s), random walk of that yaw."""
    tilt: ArrayLike = 0.01
    """() rad, standard deviation of an orientation's error about each level axis, and of relative ones about each."""
    tilt_time: ArrayLike = 1.0
    """() s, its correlation time."""
    marker: ArrayLike = 0.005
    """() m, standard deviation of a position along each axis."""
    hidden: ArrayLike = 0.2
    """() share of the time that a position or pose is out of sight."""
    hidden_time: ArrayLike = 1.0
    """() s, how long that lasts on average."""
    shake: ArrayLike = 0.3
    """() m/s2, standard deviation of an accelerometer along each axis."""


class Truth(NamedTuple):
    """What the measurements come from."""

    reference: PyTree
    """(T, d) rad, the angles that were commanded; `jaxest.kinematics.space.Joints` where not all are hinges."""
    angles: PyTree
    """The same, effective: a rigid robot with these stands as the bent one does."""
    frames: Frames
    """(T, n, ...) poses of the frames asked for, of the bent robot."""


def simulate(
    robot: Robot,
    sensors: Sequence[Sensor],
    *,
    key: Array,
    duration: float = 30.0,
    rate_hz: float = 50.0,
    joints: Sequence[str] | None = None,
    others: Sequence[str] = (),
    motion: Callable[[Array], Array] | None = None,
    torque: Callable[[Array], Array] | None = None,
    faults: Faults | None = None,
    frames: Sequence[str] = (),
) -> tuple[Any, Truth]:
    """Move a robot that bends and record its sensors.

    Args:
        robot: the robot, with masses.
        sensors: the sensors; mountings and offsets are taken from their parameters, noise from `faults`.
        key: key of the whole recording.
        duration: s.
        rate_hz: measurements per second.
        joints: names of the joints that bend and are estimated; as in `systems.deflection.build`.
        others: names of joints that do not bend and whose coordinates come with the measurement.
        motion: time () s -> commanded q (nq,); a slow random one if None.
        torque: time () s -> (d,) N m of an outer force about the joints, such as a table under the hand; none if None.
        faults: how bad everything is.
        frames: names of the frames whose true poses are wanted.

    Returns:
        Measurements (`measurement_type`) with a leading time axis of T = `round(duration * rate_hz)`, and the truth.
        What joints are neither estimated nor among `others` do is not moved: they stay at home.

    Raises:
        InputError: a joint, frame or kind does not exist, or a moving body has no mass.
        ValueError: there is no sample.

    Source: Sato 2023, eq. 31, with the sign with which an arm sags.
    """
    count = round(duration * rate_hz)
    if count < 1:
        raise ValueError(f"duration: got {duration} s at {rate_hz} Hz, expected at least one sample")
    sensors, given = checked(sensors), faults or Faults()
    estimated, rest = chosen(robot, joints, others)
    bends = space(robot, estimated)
    at, velocity = np.array(bends.coordinates), np.array(bends.velocities)
    other = np.array([robot.topology.joint_q[j] for j in rest], int)
    moves, noise = jax.random.split(key)
    motion = motion or partial(trajectories.configuration, slow_motion(moves, robot))
    time = jnp.arange(count) / rate_hz
    home = jnp.asarray(robot.home, time.dtype)
    names = [f for sensor in sensors for f in sensor.frames if module(sensor).FRAMES]
    numbers = [frame(robot, f) for f in (*names, *frames)]

    def bent(t: Array) -> tuple[PyTree, PyTree, Array, Frames]:
        free = motion(t).astype(time.dtype)
        kept = np.concatenate([at, other])
        q = home.at[kept].set(free[kept])
        push = torque(t) if torque else jnp.zeros(bends.dim, time.dtype)
        give = jnp.asarray(given.compliance, time.dtype) * (push - gravity_torque(robot, q)[velocity])
        gone = moved(robot, q, jnp.zeros(robot.nv, time.dtype).at[velocity].set(give))
        return unflat(bends, q[at]), unflat(bends, gone[at]), q[other], forward(robot, gone, numbers)

    reference, angles, carried, poses = jax.vmap(bent)(time)
    record, params = measurement_type(sensors, others=bool(rest)), default_params(sensors)
    readings: dict[str, Reading] = {}
    first, turned = 0, 0
    for index, sensor in enumerate(sensors):
        view: Any
        if not module(sensor).FRAMES:
            kind = module(sensor).JOINTS
            view = part(reference, kind)[:, np.array(columns(robot, estimated, kind, sensor.name, sensor.frames))]
        else:
            last = first + len(sensor.frames)
            view, first = jax.tree.map(lambda x, run=slice(first, last): x[:, run], poses), last
        ideal = jax.vmap(partial(module(sensor).predict, getattr(params, sensor.name)))(view)
        sign = 1 - 2 * (turned % 2)
        turned += sensor.kind in ("link_orientation", "end_effector_pose")
        recorded = _CORRUPT[sensor.kind]
        readings[sensor.name] = recorded(jax.random.fold_in(noise, index), given, 1 / rate_hz, sign, ideal)
    if rest:
        readings["others"] = Reading(carried, jnp.ones(count, bool))
    chosen_frames = jax.tree.map(lambda x: x[:, len(names) :], poses)
    measurements = record(**readings, dt=jnp.full(count, 1 / rate_hz, time.dtype))
    return measurements, Truth(reference, angles, chosen_frames)


def slow_motion(key: Array, robot: Robot) -> trajectories.Motion:
    """Draw a motion slow enough for a robot to be at rest at each moment: periods of 10 to 40 s."""
    return trajectories.random_motion(key, robot, waves=2, slowest=0.025, fastest=0.1, reach=0.6)


def _encoder(key: Array, faults: Faults, dt: float, sign: int, ideal: Array) -> Reading:
    noise = faults.encoder * jax.random.normal(key, ideal.shape, ideal.dtype)
    return Reading(ideal + noise, jnp.ones(len(ideal), bool))


def _way(key: Array, faults: Faults, dt: float, sign: int, ideal: Array) -> Reading:
    return _encoder(key, faults._replace(encoder=faults.way), dt, sign, ideal)


def _orientation(key: Array, faults: Faults, dt: float, sign: int, ideal: Array) -> Reading:
    """Turn (T, 4) about the world's axes: a yaw that drifts, and tilts that come and go."""
    one, two = jax.random.split(key)
    walk = jnp.cumsum(faults.yaw_walk * np.sqrt(dt) * jax.random.normal(one, (len(ideal),), ideal.dtype))
    yaw = sign * faults.drift * dt * jnp.arange(len(ideal), dtype=ideal.dtype) + walk
    tilt = jnp.asarray(faults.tilt, ideal.dtype) * coloured(two, len(ideal), 2, dt, faults.tilt_time, ideal.dtype)
    return Reading(_turned(jnp.concatenate([tilt, yaw[:, None]], axis=1), ideal), jnp.ones(len(ideal), bool))


def _relative(key: Array, faults: Faults, dt: float, sign: int, ideal: Array) -> Reading:
    error = jnp.asarray(faults.tilt, ideal.dtype) * coloured(key, len(ideal), 3, dt, faults.tilt_time, ideal.dtype)
    return Reading(_turned(error, ideal), jnp.ones(len(ideal), bool))


def _position(key: Array, faults: Faults, dt: float, sign: int, ideal: Array) -> Reading:
    one, two = jax.random.split(key)
    noise = faults.marker * jax.random.normal(one, ideal.shape, ideal.dtype)
    return Reading(ideal + noise, _seen(two, faults, dt, len(ideal)))


def _pose(key: Array, faults: Faults, dt: float, sign: int, ideal: Array) -> Reading:
    one, two = jax.random.split(key)
    position = _position(one, faults, dt, sign, ideal[:, :3])
    turn = _relative(two, faults, dt, sign, ideal[:, 3:])
    return Reading(jnp.concatenate([position.value, turn.value], axis=1), position.valid)


def _gravity(key: Array, faults: Faults, dt: float, sign: int, ideal: Array) -> Reading:
    force = G * ideal + faults.shake * jax.random.normal(key, ideal.shape, ideal.dtype)
    return Reading(force, jnp.ones(len(ideal), bool))


_CORRUPT = MappingProxyType(
    {
        "joint_angle": _encoder,
        "link_orientation": _orientation,
        "link_position": _position,
        "end_effector_pose": _pose,
        "gravity_direction": _gravity,
        "relative_orientation": _relative,
        "slide_position": _way,
    }
)


def _turned(error: Array, ideal: Array) -> Array:
    """Turn (T, 4) by rotation vectors (T, 3) on the left."""
    return jax.vmap(lambda v, q: quat.compose(quat.exp(v), q))(error, ideal)


def _seen(key: Array, faults: Faults, dt: float, steps: int) -> Array:
    """Whether a marker is in sight, (T,): two states, left at random."""
    hidden = jnp.asarray(faults.hidden)
    back = dt / jnp.asarray(faults.hidden_time)
    away = back * hidden / jnp.maximum(1 - hidden, 1e-6)
    drawn = jax.random.uniform(key, (steps,))

    def body(seen: Array, u: Array) -> tuple[Array, Array]:
        seen = jnp.where(seen, u >= away, u < back)
        return seen, seen

    return jax.lax.scan(body, drawn[0] >= hidden, drawn)[1]


__all__ = ["Faults", "Truth", "simulate", "slow_motion"]
