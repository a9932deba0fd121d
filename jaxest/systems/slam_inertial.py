"""Whole-body SLAM of a free root that an IMU drives: gyroscope and accelerometer carry it from scan to scan.

A filter of the IMU's pose, velocity and biases beside `jaxest.systems.slam`: between two scans it integrates the
samples, which tells SLAM how the root moved and how well that is known; where SLAM then finds the root corrects
velocity and biases. A root that is lost, or sees nothing, goes on by its IMU. The world's z is up, as the robot's
gravity says. Where points tell little, the way by the IMU counts in both filters: covariances are too small there.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters._state import apart, finite
from jaxest.filters.kalman import Factor, Gaussian, update
from jaxest.filters.kalman.gaussian import sandwich
from jaxest.filters.kalman.model import clean
from jaxest.kinematics import Robot, frame
from jaxest.manifolds import quaternion, se3
from jaxest.sensors.proximity import Proximity
from jaxest.systems import slam
from jaxest.systems._inertial_track import MANIFOLD, Track, advance, integrate
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, OUT_OF_RANGE, Array, ArrayLike, InputError, Reading, System


class Params(NamedTuple):
    """What may be tuned; the IMU's are those of a small MEMS part after a factory calibration."""

    inner: slam.Params = slam.Params()
    """The SLAM's; its `travel` and `turn` are added to what the IMU leaves."""
    gyroscope: ArrayLike = 9e-5
    """() rad/s per root Hz, white noise."""
    accelerometer: ArrayLike = 4e-3
    """() m/s2 per root Hz."""
    gyroscope_start: ArrayLike = 0.005
    """() rad/s, standard deviation of its bias before the first scan."""
    accelerometer_start: ArrayLike = 0.02
    """() m/s2."""
    gyroscope_walk: ArrayLike = 2e-5
    """() rad/s per root s, growth of it."""
    accelerometer_walk: ArrayLike = 1e-4
    """() m/s2 per root s."""
    speed_start: ArrayLike = 0.1
    """() m/s, standard deviation of the velocity before the first scan."""


class Driven(NamedTuple):
    """What a robot with an IMU on its root measures in a step; S samples since the step before."""

    ranges: Reading
    """As in `slam.Fixed`."""
    joints: Reading
    """As in `slam.Fixed`."""
    gyroscope: Reading
    """(S, 3) rad/s in the IMU's axes, and which there are (S,)."""
    accelerometer: Reading
    """(S, 3) m/s2, specific force, +1 g up at rest, and which there are (S,)."""
    spacing: Array
    """(S,) s, what each sample stands for; 0, or less, fills rows that are none."""
    dt: Array
    """() s."""


class State(NamedTuple):
    """What the next step needs."""

    inner: slam.State
    track: Gaussian
    """Of `MANIFOLD`."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate of one step."""

    inner: slam.Info
    velocity: Array
    """(3,) m/s, of the IMU in the world."""
    gyroscope: Array
    """(3,) rad/s, its bias."""
    accelerometer: Array
    """(3,) m/s2, its bias."""
    driven: Array
    """() bool, whether the IMU's samples told how the root moved."""
    status: Array
    """() int32, the SLAM's."""


class Setup(NamedTuple):
    """What is static."""

    inner: System
    least: int
    """Inliers with which a scan tells where the root is."""
    mount: se3.Pose
    """IMU to root."""
    gravity: np.ndarray
    """(3,) m/s2."""


def build(robot: Robot, sensors: Sequence[Proximity], imu: str, **options: Any) -> System:
    """Build the SLAM of a robot with an IMU on its root.

    Args:
        robot: as in `slam.build`, its root free.
        sensors: see there.
        imu: the root, or a site on it, that has the IMU's place and axes.
        **options: those of `slam.build`.

    Returns:
        The system; a measurement is `Driven`. `simulate` draws what `slam` measures, without an IMU.

    Raises:
        InputError: as there; the root is fixed, or the IMU is not on it.
    """
    topology, at = robot.topology, frame(robot, imu)
    if topology.joint_kind[:1] != ("free",):
        raise InputError(f"imu {imu!r}: the robot's root is fixed, expected a free one that the IMU drives")
    root, bodies = topology.joint_body[0], len(topology.body_names)
    owner = at if at < bodies else topology.site_body[at - bodies]
    if owner != root:
        raise InputError(f"imu {imu!r}: expected the root {topology.body_names[root]!r} or a site on it")
    turn: Any = np.array([1.0, 0, 0, 0])
    place: Any = np.zeros(3)
    if at >= bodies:
        turn, place = np.asarray(robot.site_quaternion[at - bodies]), np.asarray(robot.site_position[at - bodies])
    mount = se3.Pose(turn, place)
    inner = slam.build(robot, sensors, **options)
    setup = Setup(inner, options.get("least", slam.LEAST), mount, np.asarray(robot.gravity, float))

    def simulate(params: Params, **drawing: Any) -> Any:
        return inner.simulate(params.inner, **drawing)

    return System(Params(), partial(init, setup), partial(_step, setup), simulate)


def init(setup: Setup, params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen nothing, the root at rest but for `speed_start`."""
    inner = setup.inner.init(params.inner, key=key)
    dtype = inner.covariance.dtype
    start = se3.compose(se3.Pose(inner.mean.quaternion, inner.mean.position), _typed(setup.mount, dtype))
    deviations = (0.0, 0.0, params.speed_start, params.gyroscope_start, params.accelerometer_start)
    variance = jnp.concatenate([jnp.full(3, d, dtype) ** 2 for d in deviations])
    none = jnp.zeros(3, dtype)
    track = Gaussian(Track(start, none, none, none), jnp.diag(variance))
    return apart(State(inner, track, jnp.zeros((), jnp.int32)))


def _typed(pose: se3.Pose, dtype: Any) -> se3.Pose:
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), pose)


def _step(
    setup: Setup, params: Params, state: State, measurement: Driven, *, key: Array | None = None
) -> tuple[State, Info]:
    measurement, broken = clean(measurement)
    before = state.track
    dtype = before.covariance.dtype
    params = jax.tree.map(lambda x: jnp.asarray(x, dtype), params)
    mount = _typed(setup.mount, dtype)
    back = se3.inverse(mount)
    after, spread = integrate(params, before, measurement, jnp.asarray(setup.gravity, dtype))
    there = measurement.gyroscope.valid & measurement.accelerometer.valid
    seen, held = measurement.spacing > 0, finite((after, spread))
    # Samples that stand for more or less than the step, as beside a gap, do not tell the way.
    covered = jnp.abs(jnp.sum(jnp.where(seen, measurement.spacing, 0)) - measurement.dt) <= measurement.dt / 2
    whole = jnp.all(there | ~seen) & jnp.any(seen) & covered & held & (state.index > 0)
    none = (before, jnp.zeros_like(spread))
    after, spread = jax.tree.map(lambda x, old: jnp.where(held, x, old), (after, spread), none)
    roots = [se3.compose(t.mean.pose, back) for t in (before, after)]
    travel = quaternion.rotate(quaternion.inverse(roots[0].rotation), roots[1].translation - roots[0].translation)
    turn = quaternion.local(roots[0].rotation, roots[1].rotation)
    wide, far = jnp.trace(spread[:3, :3]) / 3, jnp.trace(spread[3:, 3:]) / 3
    known = params.inner._replace(
        turn=jnp.sqrt(params.inner.turn**2 + wide), travel=jnp.sqrt(params.inner.travel**2 + far)
    )
    given = slam.Free(
        measurement.ranges, measurement.joints, Reading(travel, whole), Reading(turn, whole), measurement.dt
    )
    inner, info = setup.inner.step(known, state.inner, given, key=key)
    # Where samples are missing the IMU says nothing of the way: SLAM goes on alone, and the velocity is what it was.
    lost = before._replace(covariance=before.covariance + jnp.diag(_anywhere(params, dtype)))
    carried = jax.tree.map(lambda a, b: jnp.where(whole | (state.index == 0), a, b), after, lost)
    carried = jax.tree.map(lambda a, b: jnp.where(state.index == 0, a, b), before, carried)
    track, inner = _corrected(carried, inner, back, jnp.any(info.inliers >= setup.least) | ~whole)
    mean = track.mean
    status = jnp.where(broken & jnp.isin(info.status, np.array([OK, NOT_CONVERGED])), NON_FINITE, info.status)
    status = jnp.where(~held & (status == OK), OUT_OF_RANGE, status).astype(jnp.int32)
    out = Info(info, mean.velocity, mean.gyroscope, mean.accelerometer, whole, status)
    return State(inner, track, state.index + 1), out


def _anywhere(params: Params, dtype: Any) -> Array:
    """Return the variances (15,) that a step without the IMU adds."""
    some = (1.0, 1.0, params.speed_start, params.gyroscope_walk, params.accelerometer_walk)
    return jnp.concatenate([jnp.broadcast_to(jnp.asarray(d, dtype) ** 2, 3) for d in some])


def _corrected(track: Gaussian, inner: slam.State, back: se3.Pose, told: Array) -> tuple[Gaussian, slam.State]:
    """Bring in where SLAM finds the root, with the covariance that it has there.

    Args:
        track: the IMU's, at this scan.
        inner: SLAM's state after it.
        back: root to IMU.
        told: () bool, whether SLAM's root is not just where the IMU has brought it: that would come back as news. Where
            it is, the root is as uncertain as the track, whose errors of velocity and biases last.

    Returns:
        The track, and SLAM's state.
    """
    place, turned = inner.mean.position, inner.mean.quaternion

    def residual(x: Track) -> Array:
        root = se3.compose(x.pose, back)
        return jnp.concatenate([place - root.translation, quaternion.local(root.rotation, turned)])

    least = jnp.asarray(np.repeat([1e-4, 1e-4], 3) ** 2, place.dtype)
    noise = inner.covariance[:6, :6] + jnp.diag(least)
    found, _ = update(MANIFOLD, track, Factor(residual, noise))
    slope = jax.jacfwd(lambda v: residual(MANIFOLD.retract(track.mean, v)))(jnp.zeros(15, place.dtype))
    spread = jnp.diagonal(sandwich(slope, track.covariance))
    lacks = jnp.maximum(spread - jnp.diagonal(inner.covariance)[:6], 0)
    grown = inner.covariance.at[np.arange(6), np.arange(6)].add(jnp.where(told, 0, lacks))
    told = told & finite(found)
    return jax.tree.map(lambda a, b: jnp.where(told, a, b), found, track), inner._replace(covariance=grown)


__all__ = ["MANIFOLD", "Driven", "Info", "Params", "State", "Track", "advance", "build", "init", "integrate"]
