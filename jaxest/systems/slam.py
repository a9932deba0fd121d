"""Whole-body SLAM: where a robot's links are, what its encoders are off by, and the room about it.

Ranging sensors on any link of a tree see the room; links are registered one after the other, from the root outwards,
each against what the links before it and the scans before have put into the map.

The belief is joint: the free root's pose and every joint's bias, with all their cross-covariances. A map point carries
how it moves with the biases it was placed by, so that a residual tells only what it can (a link compared with its own
points tells nothing new), and the whole map follows when biases change. `jaxest.systems.slam_chain` is the paper's own
filter, a pose and a bias for each link, handed from parent to child.

Source: Iwao 2025, whose eq. 20 drops those cross-covariances; eqs. 19-31.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters.kalman.gaussian import product, symmetric
from jaxest.filters.kalman.model import clean
from jaxest.kinematics import Robot
from jaxest.manifolds import quaternion
from jaxest.mapping import Hashed, Layout, VoxelMap, empty
from jaxest.sensors.proximity import Proximity
from jaxest.systems import _slam_body as bodies
from jaxest.systems._slam_body import Body, Mean
from jaxest.systems._slam_link import Carry, Config, Seen, rebased, repeats, walk
from jaxest.systems._slam_rows import Points
from jaxest.systems._slam_simulation import simulate
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike, Reading, System

FOLLOWS, LOST, UNSEEN, FULL = 4, 5, 6, 7
"""Status of a link: kept its prediction; its points contradict the map; has no sensors; and of a map that is full."""
HALF = 0.5  # share of matched points that must fit
SURPRISE = 9.0  # squared deviations per dimension by which a link's points may correct the prediction


class Params(NamedTuple):
    """What may be tuned."""

    noise: ArrayLike = 0.01 / 2.7
    """() standard deviation of a range, by the range."""
    floor: ArrayLike = 0.02
    """() m, standard deviation of a distance to a plane however near: rows on one plane share its error, and are
    counted for less instead."""
    uneven: ArrayLike = 0.01
    """() m, standard deviation of a voxel's point however often it was read."""
    lasting: ArrayLike = 0.005
    """() m, of the distance to a plane that is the same in every scan, without noise."""
    share: ArrayLike = 0.3
    """() the same, by the standard deviation of a reading."""
    fresh: ArrayLike = 5.0
    """() by how much more a distance's variance is, for a plane of voxels that were read once each."""
    rough: ArrayLike = 30.0
    """() by how much a distance's variance is more than that, by the readings' where voxels were read once: such planes
    lie askew."""
    tilt: ArrayLike = 0.0
    """() rad, standard deviation of a sensor's direction about each axis."""
    gate: ArrayLike = 0.04
    """() m^0.5, a residual beyond this times the root of its range, and three times its noise, does not count."""
    thickness: ArrayLike = 0.005
    """() m, of a plane at most, beyond a range's standard deviation."""
    stray_position: ArrayLike = 0.001
    """() m, standard deviation along each axis of where the map's own errors place a link, without noise."""
    stray_rotation: ArrayLike = 0.0007
    """() rad, the same of its rotation."""
    stray: ArrayLike = 0.1
    """() what noise adds to both: by the standard deviation of a reading, and by that of its direction from afar."""
    renewal: ArrayLike = 0.2
    """() m, that a link must go to see the map with other errors; what it sees before that tells little new."""
    bias_start: ArrayLike = 0.1
    """() or (n,) rad or m, standard deviation of a bias before the first scan."""
    bias_walk: ArrayLike = 3e-4
    """() or (n,) rad or m per root s, growth of it."""
    encoder: ArrayLike = 1e-4
    """() or (n,) rad or m, white noise of a reading."""
    missing: ArrayLike = 0.1
    """() or (n,) rad or m, how far a joint may be from its last reading while none comes."""
    root_walk: ArrayLike = 0.0316
    """() or (6,) m and rad per root s, its random walk where no odometry comes."""
    travel: ArrayLike = 0.01
    """() m, standard deviation of a step's `travel`."""
    turn: ArrayLike = 0.005
    """() rad, standard deviation of a step's `turn`."""
    admit: ArrayLike = 0.15
    """() m, points of a link known worse than this stay out of the map."""


class Fixed(NamedTuple):
    """What a robot with a fixed root measures in a step."""

    ranges: Reading
    """(R,) m, and which there are (R,); zone after zone of sensor after sensor."""
    joints: Reading
    """(n,) rad or m, encoders, and which there are (n,)."""
    dt: Array
    """() s."""


class Free(NamedTuple):
    """What a robot with a free root measures in a step."""

    ranges: Reading
    """As in `Fixed`."""
    joints: Reading
    """As in `Fixed`."""
    travel: Reading
    """(3,) m, how the root moved since the step before, in its own axes then: wheel odometry; unused at the first."""
    turn: Reading
    """(3,) rad, how it turned, in its own axes: an integrated gyroscope; unused at the first step."""
    dt: Array
    """() s."""


class State(NamedTuple):
    """What the next step needs."""

    mean: Mean
    covariance: Array
    """(D, D), [root's position, rotation in the root, biases]."""
    chart: VoxelMap
    reading: Array
    """(n,) last reading of each encoder."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate of one step; B bodies, L of them with sensors."""

    position: Array
    """(B, 3) m, of every body."""
    quaternion: Array
    """(B, 4) wxyz, body to world."""
    pose_covariance: Array
    """(B, 6, 6), rotation and translation along the world's axes, at the body's origin, relative to where the root was
    at the first scan."""
    joints: Array
    """(n,) rad or m, reading less bias."""
    bias: Array
    """(n,) rad or m."""
    bias_deviation: Array
    """(n,) rad or m."""
    inliers: Array
    """(L,) int32, points that counted."""
    matched: Array
    """(L,) int32, points with a plane beside them."""
    seen: Array
    """(L,) int32, points there were among those whose turn it was."""
    weakest: Array
    """(L,) smallest eigenvalue of H' R^-1 H of the link's own pose: what its scan does not see is small."""
    nis: Array
    """(L,) mean square of the residuals that counted, in the variance that readings and planes give them: about 1."""
    link_status: Array
    """(B,) int32, `OK`, `FOLLOWS`, `LOST` or `UNSEEN`."""
    voxels: Array
    """() int32, points of the map."""
    overflow: Array
    """() int32, points so far that found no room in it."""
    status: Array
    """() int32, `OK`, `NON_FINITE`, `NOT_CONVERGED`, `LOST` or `FULL`."""


def build(
    robot: Robot,
    sensors: Sequence[Proximity],
    *,
    layout: Layout | None = None,
    capacity: int = 16384,
    points: int = 128,
    rounds: int = 6,
    least: int = 12,
    central: bool = False,
) -> System:
    """Build the SLAM of one robot.

    Args:
        robot: a tree of hinges and slides in any order and about any axes, its root fixed or free.
        sensors: on any of its frames; links without follow their joints.
        layout: the map's; `Hashed(0.2)` if None.
        capacity: voxels of the map at most.
        points: zones of a link that take part in an update, others at the next steps; all of them go into the map.
        rounds: searches for planes in an update at most; the first scans take some, later ones one.
        least: inliers without which a link keeps its prediction.
        central: whether a voxel keeps the point nearest to its centre, as the paper does, instead of the mean.

    Returns:
        The system. A measurement is `Fixed` or, where the root is free, `Free`.

    Raises:
        InputError: there is no sensor, a frame does not exist, or a joint is none that is understood.
        ValueError: a size below 1.
    """
    for name, value in (("capacity", capacity), ("points", points), ("rounds", rounds), ("least", least)):
        if value < 1:
            raise ValueError(f"{name}: got {value}, expected at least 1")
    body = bodies.body(robot, sensors)
    config = Config(layout or Hashed(0.2), points, rounds, least, central)
    measurement = Fixed if body.root is None else Free
    return System(
        Params(),
        partial(init, body, config.layout, capacity),
        partial(_step, body, config),
        partial(simulate, body, measurement),
    )


def init(body: Body, layout: Layout, capacity: int, params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen nothing: no map, and the root at its home, which places the map in the world."""
    del key
    dtype = jnp.result_type(*jax.tree.leaves(params))
    n = len(body.joints)
    spread = jnp.broadcast_to(jnp.asarray(params.bias_start, dtype) ** 2, (n,))
    if body.root is not None:
        spread = jnp.concatenate([jnp.zeros(6, dtype), spread])
    at = np.array([body.robot.topology.joint_q[j] for j in body.joints], int)
    reading = jnp.asarray(body.robot.home[at], dtype)
    chart = empty(layout, capacity, 3 * n, dtype)
    return State(bodies.home(body, dtype), jnp.diag(spread), chart, reading, jnp.zeros((), jnp.int32))


def points_of(body: Body, ranges: Reading) -> Points:
    """Return what every link sees (L, Z, ...) of cleaned readings (R,); zones beyond their limits do not count."""
    dtype = ranges.value.dtype
    rays = body.rays
    index = jnp.asarray(np.minimum(rays.index, body.readings - 1))
    reach = ranges.value[index]
    low, high = jnp.asarray(rays.minimum, dtype), jnp.asarray(rays.maximum, dtype)
    valid = jnp.asarray(rays.index < body.readings) & ranges.valid[index] & (reach >= low) & (reach <= high)
    reach = jnp.where(valid, reach, jnp.asarray(1.0, dtype))
    ray = jnp.asarray(rays.direction, dtype)
    return Points(jnp.asarray(rays.origin, dtype) + reach[..., None] * ray, ray, reach, valid)


def _step(
    body: Body, config: Config, params: Params, state: State, measurement: Any, *, key: Array | None = None
) -> tuple[State, Info]:
    del key
    measurement, broken = clean(measurement)
    dtype = state.covariance.dtype
    params = jax.tree.map(lambda x: jnp.asarray(x, dtype), params)
    n = len(body.joints)
    there = jnp.broadcast_to(measurement.joints.valid, (n,))
    reading = jnp.where(there, measurement.joints.value, state.reading)
    noise = jnp.where(there, params.encoder, params.missing) ** 2 * jnp.ones(n, dtype)
    mean, covariance = _predict(body, params, state.mean, state.covariance, measurement, state.index)
    links = bodies.links(body, mean, reading, body.scanned)
    start = Carry(mean, covariance, state.chart, state.mean.bias, links)
    points = points_of(body, measurement.ranges)
    before = bodies.links(body, state.mean, state.reading, body.scanned)
    scans = repeats(params, links, before, state.index)
    carry, seen = walk(body, config, params, start, reading, noise, points, scans, state.index)
    carry = rebased(carry, 0.0)
    info = _info(body, config, params, carry, seen, reading, noise, broken, state.chart)
    return State(carry.mean, carry.covariance, carry.chart, reading, state.index + 1), info


def _predict(
    body: Body, params: Params, mean: Mean, covariance: Array, measurement: Any, index: Array
) -> tuple[Mean, Array]:
    """Let biases walk, and the root go where odometry says or anywhere."""
    n, dt = len(body.joints), jnp.asarray(measurement.dt, covariance.dtype)
    grown = jnp.broadcast_to(params.bias_walk**2, (n,)) * dt
    if body.root is None:
        return mean, covariance + jnp.diag(grown)
    # Where the root is at the first scan is where the map's frame lies: nothing moved it before.
    walk = jnp.broadcast_to(params.root_walk**2, (6,)) * jnp.where(index == 0, 0, dt)
    started = index > 0
    moved = []
    for reading, deviation, blind in (
        (measurement.travel, params.travel, walk[:3]),
        (measurement.turn, params.turn, walk[3:]),
    ):
        valid = jnp.asarray(reading.valid) & started
        moved.append((jnp.where(valid, reading.value, 0), jnp.where(valid, deviation**2, blind)))
    (travel, far), (turn, wide) = moved
    rotation = quaternion.to_matrix(mean.quaternion)
    step = product(rotation, travel)
    # The travel is in the root's axes, so that an error of its rotation moves it sideways.
    x, y, z = travel
    zero = jnp.zeros_like(x)
    skew = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    slope = jnp.eye(body.size, dtype=covariance.dtype)
    slope = slope.at[:3, 3:6].set(-product(rotation, skew))
    slope = slope.at[3:6, 3:6].set(quaternion.to_matrix(quaternion.exp(turn)).T)
    covariance = symmetric(product(product(slope, covariance), slope.T))
    covariance = covariance + jnp.diag(jnp.concatenate([jnp.broadcast_to(far, 3), jnp.broadcast_to(wide, 3), grown]))
    return mean._replace(
        position=mean.position + step, quaternion=quaternion.retract(mean.quaternion, turn)
    ), covariance


def _info(
    body: Body, config: Config, params: Params, carry: Carry, seen: Seen, reading: Array, noise: Array, broken: Array,
    before: VoxelMap,
) -> Info:  # fmt: skip
    mean, covariance = carry.mean, carry.covariance
    links = carry.links if body.links == body.scanned else bodies.links(body, mean, reading, body.links)
    slope = jnp.concatenate([links.turn, links.travel], axis=1)
    roots = body.size - len(body.joints)
    shaken = covariance + jnp.diag(jnp.concatenate([jnp.zeros(roots, noise.dtype), noise]))
    pose = jnp.einsum("bij,jk,blk->bil", slope, shaken, slope, precision=jax.lax.Precision.HIGHEST)
    pose = (pose + pose.transpose(0, 2, 1)) / 2
    s = seen.sums
    follows = s.inliers < config.least
    lost = ~follows & ((s.inliers < HALF * s.matched) | (seen.surprise > SURPRISE))
    link = jnp.full(len(body.links), UNSEEN, jnp.int32)
    link = link.at[np.array(body.scanned)].set(jnp.where(lost, LOST, jnp.where(follows, FOLLOWS, OK)))
    full = carry.chart.overflow > before.overflow
    status = jnp.where(jnp.all(seen.settled), OK, NOT_CONVERGED)
    status = jnp.where(full, FULL, status)
    status = jnp.where(jnp.mean(lost.astype(reading.dtype)) > 0.25, LOST, status)
    status = jnp.where(broken, NON_FINITE, status).astype(jnp.int32)
    used = jnp.maximum(s.inliers, 1).astype(reading.dtype)
    return Info(
        links.position,
        jax.vmap(quaternion.from_matrix)(links.rotation),
        pose,
        reading - mean.bias,
        mean.bias,
        jnp.sqrt(jnp.maximum(jnp.diagonal(covariance)[roots:], 0)),
        s.inliers,
        s.matched,
        s.seen,
        jnp.maximum(jnp.linalg.eigvalsh(s.pose)[:, 0], 0),
        seen.odd / used,
        link,
        carry.chart.used,
        carry.chart.overflow,
        status,
    )


__all__ = ["FOLLOWS", "FULL", "LOST", "UNSEEN", "Fixed", "Free", "Info", "Params", "State", "build", "points_of"]
