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
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.filters._state import apart, within_range
from jaxest.filters.kalman.gaussian import product, symmetric
from jaxest.filters.kalman.model import clean
from jaxest.kinematics import Robot
from jaxest.manifolds import quaternion
from jaxest.manifolds._algebra import skew
from jaxest.mapping import Hashed, Layout, VoxelMap, empty
from jaxest.sensors.proximity import Proximity
from jaxest.systems import _slam_body as bodies
from jaxest.systems._slam_body import Body, Mean
from jaxest.systems._slam_link import repeats, walk
from jaxest.systems._slam_register import Carry, Config, Seen, amiss
from jaxest.systems._slam_rows import Points
from jaxest.systems._slam_simulation import simulate
from jaxest.systems._slam_tilt import begin, carries, unknowns
from jaxest.systems._slam_types import FOLLOWS, FULL, LOST, UNSEEN, Fixed, Free, Info, Params, State
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike, Reading, System

LEAST = 12  # inliers
SURE = 2.0  # deviations of a motion that make it one
MEMORY = 50  # steps
SURPRISE = 9.0  # squared deviations per dimension by which a link's points may correct the prediction


def build(
    robot: Robot,
    sensors: Sequence[Proximity],
    *,
    layout: Layout | None = None,
    capacity: int = 16384,
    points: int = 128,
    rounds: int = 6,
    least: int = LEAST,
    central: bool = False,
    align: bool = False,
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
        align: whether to find out how each sensor is turned from where it is believed to look, by about `Params.tilt`;
            a step then takes about three times as long.

    Returns:
        The system. A measurement is `Fixed` or, where the root is free, `Free`.

    Raises:
        InputError: there is no sensor, a frame does not exist, or a joint is none that is understood.
        ValueError: a size below 1.
    """
    bodies.check_sizes(capacity=capacity, points=points, rounds=rounds, least=least)
    body = bodies.body(robot, sensors)
    config = Config(layout or Hashed(0.2), points, rounds, least, central)
    measurement = Fixed if body.root is None else Free
    return System(
        Params(),
        partial(init, body, config.layout, capacity, align),
        partial(_step, body, config),
        partial(simulate, body, measurement),
    )


def init(body: Body, layout: Layout, capacity: int, align: bool, params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen nothing: no map, and the root at its home, which places the map in the world."""
    del key
    dtype = jnp.result_type(*jax.tree.leaves(params))
    n = len(body.joints)
    spread = jnp.broadcast_to(jnp.asarray(params.bias_start, dtype) ** 2, (n,))
    if body.root is not None:
        spread = jnp.concatenate([jnp.zeros(6, dtype), spread])
    at = np.array([body.robot.topology.joint_q[j] for j in body.joints], int)
    reading = jnp.asarray(body.robot.home[at], dtype)
    mounts, extra = None, 3 * n
    if align:
        mounts, common = begin(body, jnp.asarray(params.tilt, dtype))
        spread, extra = jnp.concatenate([spread, common]), extra + carries(body)
    chart = empty(layout, capacity, extra, dtype)
    still, unseen, none = jnp.zeros(6, dtype), jnp.zeros((), dtype), jnp.zeros((), jnp.int32)
    first = bodies.home(body, dtype)
    known = unknowns(first.bias, mounts)
    return apart(State(first, jnp.diag(spread), chart, known, reading, still, unseen, mounts, none))


def points_of(body: Body, ranges: Reading) -> Points:
    """Return what every link sees (L, Z, ...) of cleaned readings (R,); zones beyond their limits do not count."""
    if ranges.value.shape != (body.readings,):
        raise ValueError(f"measurement.ranges: got shape {ranges.value.shape}, expected ({body.readings},)")
    dtype = ranges.value.dtype
    rays = body.rays
    index = jnp.asarray(np.minimum(rays.index, body.readings - 1))
    reach, there = ranges.value[index], jnp.broadcast_to(ranges.valid, (body.readings,))[index]
    low, high = jnp.asarray(rays.minimum, dtype), jnp.asarray(rays.maximum, dtype)
    valid = jnp.asarray(rays.index < body.readings) & there & (reach >= low) & (reach <= high)
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
    mean, covariance, doubt = _predict(body, params, state, measurement)
    links = bodies.links(body, mean, reading, body.scanned)
    start = Carry(mean, covariance, state.chart, state.reference, links, state.mounts)
    points = points_of(body, measurement.ranges)
    if state.mounts is not None:
        points = points._replace(sensor=jnp.asarray(body.rays.sensor, jnp.int32))
    before = bodies.links(body, state.mean, state.reading, body.scanned)
    scans = repeats(params, links, before, state.index)
    carry, seen = walk(body, config, params, start, reading, noise, points, scans, state.index, doubt, state.usual)
    info = _info(body, config, params, carry, seen, reading, noise, broken, state.chart)
    pace = _pace(state, carry.mean, measurement.dt) if body.root is not None else state.pace
    usual, index = _usual(state, seen), state.index + 1
    after = State(carry.mean, carry.covariance, carry.chart, carry.reference, reading, pace, usual, carry.mounts, index)
    # The map keeps what it was given: it takes no point of a link that is not known well.
    belief, info = within_range(state._replace(chart=None), after._replace(chart=None), info)  # type: ignore[arg-type]
    return belief._replace(chart=carry.chart, reference=carry.reference), info


def _predict(body: Body, params: Params, state: State, measurement: Any) -> tuple[Mean, Array, Array]:
    """Let biases walk, and the root go where odometry says, or on as it went.

    Returns:
        Mean, covariance, and the variances (6,) by which a free root may have changed its pace.
    """
    mean, covariance = state.mean, state.covariance
    n, dt = len(body.joints), jnp.asarray(measurement.dt, covariance.dtype)
    grown = jnp.broadcast_to(params.bias_walk**2, (n,)) * dt
    grown = jnp.pad(grown, (0, len(covariance) - body.size))  # sensors stay as they were mounted
    if body.root is None:
        none = jnp.zeros(6, covariance.dtype)
        return mean, covariance + jnp.diag(grown), none
    # Where the root is at the first scan is where the map's frame lies: nothing moved it before.
    started = state.index > 0
    walk = jnp.broadcast_to(params.root_walk**2, (6,)) * jnp.where(started, dt, 0)
    moved = []
    for reading, deviation, blind, pace, known in (
        (measurement.travel, params.travel, walk[:3], state.pace[:3], covariance[:3, :3]),
        (measurement.turn, params.turn, walk[3:], state.pace[3:], covariance[3:6, 3:6]),
    ):
        valid = jnp.asarray(reading.valid) & started
        # A motion that may as well be none, as far as it is known, says nothing of where the root goes next.
        ahead = jnp.where(started, pace * dt, 0)
        far, wander = jnp.sum(ahead**2), jnp.sum(jnp.broadcast_to(blind, 3)) + SURE**2 * jnp.trace(known)
        ahead = ahead * far / jnp.where(far + wander > 0, far + wander, 1)
        change = jnp.where(valid, 0, params.swing**2 * jnp.sum(ahead**2))
        spread = jnp.where(valid, deviation**2, blind)
        moved.append((jnp.where(valid, reading.value, ahead), spread, jnp.broadcast_to(change, 3)))
    (travel, near, faster), (turn, wide, quicker) = moved
    doubt = jnp.concatenate([faster, quicker])
    added = jnp.concatenate([near, wide]) + doubt
    rotation = quaternion.to_matrix(mean.quaternion)
    step = product(rotation, travel)
    # The travel is in the root's axes, so that an error of its rotation moves it sideways.
    slope = jnp.eye(len(covariance), dtype=covariance.dtype)
    slope = slope.at[:3, 3:6].set(-product(rotation, skew(travel)))
    slope = slope.at[3:6, 3:6].set(quaternion.to_matrix(quaternion.exp(turn)).T)
    covariance = symmetric(product(product(slope, covariance), slope.T))
    covariance = covariance + jnp.diag(jnp.concatenate([added, grown]))
    gone = mean._replace(position=mean.position + step, quaternion=quaternion.retract(mean.quaternion, turn))
    return gone, covariance, doubt


def _pace(state: State, after: Mean, dt: ArrayLike) -> Array:
    """Return how fast (6,) m/s and rad/s the root went, in its own axes before; as it was where no time went by."""
    before = state.mean
    back = quaternion.inverse(before.quaternion)
    gone = quaternion.rotate(back, after.position - before.position)
    turned = quaternion.local(before.quaternion, after.quaternion)
    dt = jnp.asarray(dt, gone.dtype)
    return jnp.where(dt > 0, jnp.concatenate([gone, turned]) / jnp.where(dt > 0, dt, 1), state.pace)


def _usual(state: State, seen: Seen) -> Array:
    """Follow the share of the first link's points that fit, over some `MEMORY` steps in which it was not lost."""
    inliers, matched = (x[0].astype(state.usual.dtype) for x in (seen.sums.inliers, seen.sums.matched))
    share = inliers / jnp.maximum(matched, 1)
    steps = jnp.clip(state.index, 1, MEMORY)
    return jnp.where((matched > 0) & ~seen.lost[0], state.usual + (share - state.usual) / steps, state.usual)


def _info(
    body: Body, config: Config, params: Params, carry: Carry, seen: Seen, reading: Array, noise: Array, broken: Array,
    before: VoxelMap,
) -> Info:  # fmt: skip
    mean, covariance = carry.mean, carry.covariance[: body.size, : body.size]
    links = carry.links if body.links == body.scanned else bodies.links(body, mean, reading, body.links)
    slope = jnp.concatenate([links.turn, links.travel], axis=1)
    roots = body.size - len(body.joints)
    shaken = covariance + jnp.diag(jnp.concatenate([jnp.zeros(roots, noise.dtype), noise]))
    pose = jnp.einsum("bij,jk,blk->bil", slope, shaken, slope, precision=jax.lax.Precision.HIGHEST)
    pose = (pose + pose.transpose(0, 2, 1)) / 2
    s = seen.sums
    follows = s.inliers < config.least
    # Also where too few fit for an update: a link that finds itself in the midst of a map and on none of its planes.
    lost = seen.lost | amiss(config, s) | (~follows & (seen.surprise > SURPRISE))
    link = jnp.full(len(body.links), UNSEEN, jnp.int32)
    link = link.at[np.array(body.scanned)].set(jnp.where(lost, LOST, jnp.where(follows, FOLLOWS, OK)))
    full = carry.chart.overflow > before.overflow
    # What is worse hides what is less so.
    status = jnp.where(jnp.all(seen.settled), OK, NOT_CONVERGED)
    status = jnp.where(broken, NON_FINITE, status)
    status = jnp.where(full, FULL, status)
    status = jnp.where(jnp.mean(lost.astype(reading.dtype)) > 0.25, LOST, status).astype(jnp.int32)
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
        jnp.maximum(jax.vmap(linalg.eigh)(s.pose)[0][:, 0], 0),
        seen.odd / used,
        link,
        carry.chart.used,
        carry.chart.overflow,
        status,
    )


__all__ = ["FOLLOWS", "FULL", "LOST", "UNSEEN", "Fixed", "Free", "Info", "Params", "State", "build", "points_of"]
