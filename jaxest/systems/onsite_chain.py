"""A robot put together from joint modules and unknown sticks, measured while it swings one joint after the other.

Each unknown link has an IMU at either end: on the horn of the module before it and on the housing of the one behind.
`step` finds the pose of one IMU in the other for all links at once (`jaxest.systems.onsite`) and, through the modules'
known mountings, that of joint in joint; it is done when two standard deviations of all of them are below 5 mm and 0.1
deg. `rebuild` puts the robot together again.

A link is determined once it has turned about two different axes: behind the first joint alone it never does, for which
reason a base that turns the first joint belongs to the assembly.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.filters._small import product, sandwich
from jaxest.filters._time import elapsed
from jaxest.kinematics.modular import Assembly, assemble, check, known
from jaxest.kinematics.robot import Robot
from jaxest.manifolds import quaternion as quat
from jaxest.manifolds._algebra import skew
from jaxest.manifolds.se3 import Pose
from jaxest.systems import onsite
from jaxest.systems.onsite_recording import Imu, brought, explain
from jaxest.systems.onsite_simulation import Pair
from jaxest.types import Array, ArrayLike, InputError, Reading, System


class Params(NamedTuple):
    """What may be tuned or differentiated; L unknown links."""

    pair: onsite.Params
    """Of every link, but for the gyros' biases."""
    bias: ArrayLike
    """(L, 2, 3) rad/s, what is known of the biases of the gyros before and behind each link."""
    front_rotation: ArrayLike
    """(L, 4) wxyz, the IMU before the link in its module."""
    front_translation: ArrayLike
    """(L, 3) m."""
    rear_rotation: ArrayLike
    """(L, 4) wxyz, the IMU behind the link in its module."""
    rear_translation: ArrayLike
    """(L, 3) m."""
    position_limit: ArrayLike = 0.005
    """() m, two standard deviations (root of the trace) of a joint's place below which it is known."""
    rotation_limit: ArrayLike = math.radians(0.1)
    """() rad, likewise of its orientation."""
    hold: ArrayLike = 1.0
    """() s, for which every link must have been known to the limits: the spread scatters at the beginning."""


class Sample(NamedTuple):
    """One sample of all IMUs, two for each unknown link: before it, behind it."""

    gyroscope: Reading
    """value (L, 2, 3) rad/s, valid (L, 2)."""
    accelerometer: Reading
    """value (L, 2, 3) m/s2, valid (L, 2)."""
    dt: ArrayLike
    """() s, time since the previous step."""


class State(NamedTuple):
    """What the next step needs."""

    links: onsite.State
    """leaves (L, ...)"""
    near: Array
    """() s, for how long every link has been known to the limits."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate after a step."""

    position: Array
    """(L, 3) m, of the next joint in the joint before the link."""
    quaternion: Array
    """(L, 4) wxyz."""
    covariance: Array
    """(L, 6, 6) of rotation vector (in the next joint, on the right) and position: rad, m."""
    spread: Array
    """(L, 2) two standard deviations, the root of the trace: rad, m."""
    imus: onsite.Info
    """leaves (L, ...): the pose of IMU in IMU, residuals, validity."""
    done: Array
    """() bool, whether every link has been known to the limits for long enough."""
    valid: Array
    """() bool, whether every link is determined."""
    status: Array
    """() int32, `OK` or `NON_FINITE`, as for a pair."""


def build(assembly: Assembly, sensors: None = None, *, half_width: int = 7, degree: int = 3, lag: int = 20) -> System:
    """Build the estimator of a robot's unknown links.

    Args:
        assembly: modules and mountings.
        sensors: not used, the assembly has them.
        half_width: N, degree, lag: as for `onsite.build`.
        degree: M.
        lag: N_lag.

    Returns:
        The system; its measurement is `Sample`.

    Raises:
        InputError: the assembly is wrong, or knows all its links.

    Source: Sato 2024, sections III and IV-B.
    """
    check(assembly)
    links = assembly.unknown
    if not links:
        raise InputError("links: all are known, expected at least one None")
    pair = onsite.build(half_width=half_width, degree=degree, lag=lag)
    ends = [(assembly.modules[k].after, assembly.modules[k + 1].before) for k in links]
    front, rear = (jax.tree.map(lambda *x: np.stack(x), *side) for side in zip(*ends, strict=True))
    params = Params(pair.default_params, np.zeros((len(links), 2, 3)), *front, *rear)
    return System(
        params,
        partial(init, half_width=half_width, lag=lag),
        partial(step, degree=degree),
        partial(simulate, count=len(links)),
    )


def init(params: Params, *, key: Array | None = None, half_width: int = 7, lag: int = 20) -> State:
    """Return the state that has seen no data; arguments as for `build`."""
    one = onsite.init(params.pair, half_width=half_width, lag=lag)
    count = np.shape(params.front_rotation)[0]
    links = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)), one)
    return State(links, jnp.zeros((), one.numbers.dtype), jnp.zeros((), jnp.int32))


def step(
    params: Params, state: State, measurement: Sample, *, key: Array | None = None, degree: int = 3
) -> tuple[State, Info]:
    """Take in one sample of all IMUs.

    Args:
        params: noise, mountings and limits.
        state: as `init` or the previous step returned it.
        measurement: one sample; any sensor of any IMU may be missing.
        key: not used.
        degree: M, static.

    Returns:
        The next state and the estimate.

    Raises:
        ValueError: a shape is wrong.
    """
    count = np.shape(params.front_rotation)[0]
    shapes = [jnp.shape(x) for x in jax.tree.leaves(measurement)]
    if shapes != [(count, 2, 3), (count, 2), (count, 2, 3), (count, 2), ()]:
        raise ValueError(f"measurement: got shapes {shapes}, expected those of {count} links with two IMUs each")
    dtype = state.links.numbers.dtype
    bias = jnp.asarray(params.bias, dtype)

    def one(state: onsite.State, gyro: Reading, acc: Reading, bias: Array) -> tuple[onsite.State, onsite.Info]:
        readings: Any = [Reading(x.value[side], x.valid[side]) for side in (0, 1) for x in (gyro, acc)]
        settings = params.pair._replace(bias_a=bias[0], bias_p=bias[1])
        a, b, c, d = readings
        return onsite.step(settings, state, Pair(a, b, c, d, measurement.dt), degree=degree)

    gyro, acc = (jax.tree.map(jnp.asarray, x) for x in measurement[:2])
    links, imus = jax.vmap(one)(state.links, gyro, acc, bias)
    mountings = [jnp.asarray(x, dtype) for x in params[2:6]]
    position, quaternion, covariance = jax.vmap(_joint_in_joint)(imus, *mountings)
    variance = jnp.stack([jnp.trace(covariance[:, s, s], axis1=1, axis2=2) for s in _HALVES], axis=1)
    spread = 2 * onsite.root(variance)
    near = (spread[:, 0] < params.rotation_limit) & (spread[:, 1] < params.position_limit)
    valid = jnp.all(imus.valid)
    dt, _ = elapsed(measurement.dt, dtype)
    lasting = jnp.where(jnp.all(near) & valid, state.near + dt, 0)
    done = (lasting > 0) & (lasting >= params.hold)
    info = Info(position, quaternion, covariance, spread, imus, done, valid, jnp.max(imus.status))
    return State(links, lasting, state.index + 1), info


_HALVES = (slice(0, 3), slice(3, 6))


def _joint_in_joint(
    imus: onsite.Info, front_rotation: Array, front: Array, rear_rotation: Array, rear: Array
) -> tuple[Array, Array, Array]:
    """Pose of the next joint in the joint before, T_front T_A_P T_rear^-1, and its covariance."""
    mounting = front_rotation, front, rear_rotation, rear
    position, quaternion = _placed(imus.position, imus.quaternion, *mounting)
    a, r, b = (quat.to_matrix(q) for q in (front_rotation, imus.quaternion, rear_rotation))
    arm = -quat.rotate(quat.inverse(rear_rotation), rear)
    moved = -product(product(a, r), skew(arm))  # of the position by a turn of P
    slope = jnp.concatenate(
        [jnp.concatenate([b, jnp.zeros_like(b)], axis=1), jnp.concatenate([moved, a], axis=1)]
    )  # fmt: skip
    return position, quaternion, sandwich(slope, imus.covariance)


def _placed(
    position: Array, quaternion: Array, front_rotation: Array, front: Array, rear_rotation: Array, rear: Array
) -> tuple[Array, Array]:
    """Joint in joint from IMU in IMU."""
    back = quat.inverse(rear_rotation)
    joint = -quat.rotate(back, rear)  # the next joint, in P
    place = front + quat.rotate(front_rotation, position + quat.rotate(quaternion, joint))
    return place, quat.compose(front_rotation, quat.compose(quaternion, back))


def simulate(params: Params, *, key: Array, count: int, **options: object) -> tuple[Sample, Pose]:
    """Shake every link by itself, as `onsite.simulate` does; the truth is the pose of joint in joint, leaves (L, ...).

    Whole robots are simulated by `jaxest.simulate.manipulator`.
    """
    draw = partial(onsite.simulate, params.pair, **options)  # type: ignore[arg-type]
    pairs, truth = jax.vmap(lambda key: draw(key=key))(jax.random.split(key, count))

    def both(kind: str) -> Reading:
        sides = [getattr(pairs, f"{kind}_{side}") for side in "ap"]
        value, valid = (jnp.stack([getattr(s, part) for s in sides], axis=2) for part in ("value", "valid"))
        return Reading(jnp.swapaxes(value, 0, 1), jnp.swapaxes(valid, 0, 1))

    dtype = truth.position.dtype
    mountings = [jnp.asarray(x, dtype) for x in params[2:6]]

    position, quaternion = jax.vmap(_placed)(truth.position, truth.quaternion, *mountings)
    return Sample(both("gyroscope"), both("accelerometer"), jnp.asarray(pairs.dt)[0]), Pose(quaternion, position)


def samples(imus: Sequence[tuple[Imu, Imu]]) -> tuple[NDArray[np.float64], Sample]:
    """Bring the recordings of all IMUs to the first one's stamps.

    Args:
        imus: recordings of the two IMUs of each unknown link: before it, behind it.

    Returns:
        Times (T,) s and measurements, NumPy arrays with a leading axis of T; what falls into a gap of an IMU or
        stands at a sensor's limit is not valid.

    Raises:
        InputError: recordings do not overlap, or stamps are wrong.
    """
    every = [imu for link in imus for imu in link]
    low, high = max(imu.time[0] for imu in every), min(imu.time[-1] for imu in every)
    clock = every[0].time
    time = clock[(clock >= low) & (clock <= high)]
    if len(time) < 2:
        raise InputError(
            f"the recordings of the IMUs do not overlap: the last begins at {low:.3f} s, one ends at {high:.3f} s"
        )
    found = [brought(imu, time) for imu in every]
    value = np.stack([v for v, _ in found], axis=1).reshape(len(time), len(imus), 2, 6)
    valid = np.stack([there for _, there in found], axis=1).reshape(len(time), len(imus), 2, 2)
    parts: list[Any] = [(value[..., part], valid[..., k]) for k, part in enumerate((slice(0, 3), slice(3, 6)))]
    readings: Any = [Reading(*part) for part in parts]
    rates, forces = readings
    return time, Sample(rates, forces, np.diff(time, prepend=time[0]))


def poses(info: Info) -> tuple[Pose, ...]:
    """Return the links' poses as known on the host, from the last info."""
    found = zip(np.asarray(info.quaternion, float), np.asarray(info.position, float), strict=True)
    return tuple(known(q, p) for q, p in found)


def rebuild(assembly: Assembly, info: Info, *, name: str = "assembly") -> Robot:
    """Put the robot together with the links that were found.

    Args:
        assembly: the modules.
        info: of the last step.
        name: of the robot.

    Returns:
        The robot; `jaxest.kinematics.write` makes MJCF and URDF of it.

    Raises:
        InputError: a link is not determined; the message says which component, and what to do.
    """
    for row, k in enumerate(assembly.unknown):
        names = f"{assembly.modules[k].name!r} to {assembly.modules[k + 1].name!r}"
        if not bool(info.imus.valid[row]):
            why = explain(np.asarray(info.imus.covariance[row], float)) or (
                "too few samples, or rates of its two IMUs that do not agree"
            )
            raise InputError(f"the link from {names} is not determined: {why}")
    return assemble(assembly, poses(info), name=name)


__all__ = ["Info", "Params", "Sample", "State", "build", "init", "poses", "rebuild", "samples", "simulate", "step"]
