"""The paper's whole-body SLAM: a pose and a joint bias for each link, handed from parent to child and through time.

Each link's 7 numbers have a belief of their own; what links share (eq. 20's dropped cross-covariance, the map's own
error) is not kept, so that covariances come out too small. `jaxest.systems.slam` keeps it and is the one to use; this
one is here to compare with.

Source: Iwao 2025, Algorithm 1, eqs. 1-31, with the errata's transposes, and biases about the joint's axis.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.filters.kalman.model import clean
from jaxest.kinematics import Robot
from jaxest.manifolds import quaternion, se3
from jaxest.mapping import Hashed, Layout, VoxelMap, empty, insert
from jaxest.sensors.proximity import Proximity
from jaxest.systems import _slam_body as bodies
from jaxest.systems import _slam_hang as hang
from jaxest.systems import slam
from jaxest.systems._slam_body import Body
from jaxest.systems._slam_handed import Links, log_density, predict, update
from jaxest.systems._slam_hang import Chain
from jaxest.systems._slam_register import Config, subset
from jaxest.systems._slam_rows import Points, Pose, world
from jaxest.systems._slam_simulation import simulate
from jaxest.types import FULL, NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike, System


class Params(NamedTuple):
    """What may be tuned; defaults are the paper's where it gives them."""

    variance: ArrayLike = 0.002
    """() m2, of every distance to a plane."""
    gate: ArrayLike = 0.111
    """() m^0.5."""
    thickness: ArrayLike = 0.05
    """() m."""
    bias_start: ArrayLike = 0.1
    """() rad or m, standard deviation before the first scan."""
    bias_walk: ArrayLike = 1e-4
    """() rad or m per step."""
    encoder: ArrayLike = 1e-3
    """() rad or m, white noise of a reading."""
    root_walk: ArrayLike = 0.01
    """() m and rad per step, of a free root."""


class State(NamedTuple):
    """What the next step needs."""

    links: Links
    chart: VoxelMap
    reading: Array
    """(n,) last reading of each encoder."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate of one step, of the L links with sensors."""

    position: Array
    """(L, 3) m."""
    quaternion: Array
    """(L, 4) wxyz."""
    bias: Array
    """(L,) rad or m; 0 for the root."""
    covariance: Array
    """(L, 7, 7) of [rotation, translation, bias] in the link."""
    inliers: Array
    """(L,) int32."""
    iterations: Array
    """(L,) int32."""
    weakest: Array
    """(L,) smallest eigenvalue of H' R^-1 H of the link's pose."""
    log_likelihood: Array
    """(L,) of the link's distances to planes, given all before: what noise is tuned by."""
    overflow: Array
    """() int32."""
    status: Array
    """() int32."""


def build(
    robot: Robot,
    sensors: Sequence[Proximity],
    *,
    layout: Layout | None = None,
    capacity: int = 16384,
    points: int = 128,
    iterations: int = 10,
    least: int = slam.LEAST,
) -> System:
    """Build the paper's SLAM of one robot.

    Args:
        robot: a tree whose bodies with sensors have one joint between them; its root fixed or free, with sensors.
        sensors: as in `systems.slam.build`.
        layout: the map's.
        capacity: voxels at most.
        points: zones of a link that take part in an update.
        iterations: of an update at most.
        least: inliers without which a link keeps its prediction.

    Returns:
        The system; measurements are those of `systems.slam`.

    Raises:
        InputError: as there, or two links with sensors have not exactly one joint between them.
    """
    bodies.check_sizes(capacity=capacity, points=points, iterations=iterations, least=least)
    body = bodies.body(robot, sensors)
    chain = hang.chain(body)
    config = Config(layout or Hashed(0.2), points, iterations, least, True)
    measurement = slam.Fixed if body.root is None else slam.Free
    return System(
        Params(),
        partial(init, body, chain, config.layout, capacity),
        partial(_step, body, chain, config),
        lambda params, **options: simulate(body, measurement, slam.Params(), **options),
    )


def init(body: Body, chain: Chain, layout: Layout, capacity: int, params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen nothing, the first link where it stands at home."""
    del key
    dtype = jnp.result_type(*jax.tree.leaves(params))
    count = len(body.scanned)
    first = jax.tree.map(lambda x: jnp.asarray(x[0], dtype), chain.offset)
    turn = jnp.zeros((count, 4), dtype).at[:, 0].set(1).at[0].set(quaternion.normalize(first.rotation))
    place = jnp.zeros((count, 3), dtype).at[0].set(first.translation)
    covariance = jnp.zeros((count, 7, 7), dtype).at[:, 6, 6].set(jnp.asarray(params.bias_start, dtype) ** 2)
    links = Links(se3.Pose(turn, place), jnp.zeros((count, 1), dtype), covariance.at[0].set(0))
    at = np.array([body.robot.topology.joint_q[j] for j in body.joints], int)
    reading = jnp.asarray(body.robot.home[at], dtype)
    return State(links, empty(layout, capacity, 0, dtype), reading, jnp.zeros((), jnp.int32))


def _step(
    body: Body,
    chain: Chain,
    config: Config,
    params: Params,
    state: State,
    measurement: Any,
    *,
    key: Array | None = None,
) -> tuple[State, Info]:
    del key
    measurement, broken = clean(measurement)
    dtype = state.links.covariance.dtype
    params = jax.tree.map(lambda x: jnp.asarray(x, dtype), params)
    reading = jnp.where(measurement.joints.valid, measurement.joints.value, state.reading)
    rows = slam.Params(noise=0.0, floor=0.0, gate=params.gate, thickness=params.thickness)
    hinges = Chain(*(jax.tree.map(jnp.asarray, x) for x in chain))
    parts = max(1, body.rays.index.shape[1] // config.points)
    turn = jnp.mod(state.index, parts)
    free = 1.0 if body.root is not None else 0.0

    def link(carry: tuple[Links, VoxelMap], row: tuple[Array, Points]) -> Any:
        links, chart = carry
        at, points = row
        own, hinged = jax.tree.map(lambda x: jax.lax.dynamic_index_in_dim(x, at, keepdims=False), (links, hinges))
        prior = predict(params, own, hinged, links, reading, free, at == 0)
        some = jax.tree.map(lambda x: subset(x, parts, turn), points)
        after, outcome = update(config, params, rows, prior, chart, some)
        pose = after.mean[0]
        there = Pose(pose.translation, quaternion.to_matrix(pose.rotation), jnp.zeros((3, 7)), jnp.zeros((3, 7)))
        chart = insert(config.layout, chart, world(there, points.local), points.valid, central=config.central)
        new = Links(after.mean[0], after.mean[1], after.covariance)
        links = jax.tree.map(lambda all_, one: jax.lax.dynamic_update_index_in_dim(all_, one, at, 0), links, new)
        return (links, chart), outcome

    points = slam.points_of(body, measurement.ranges)
    (links, chart), (inliers, iterations, settled, information, density) = jax.lax.scan(
        link, (state.links, state.chart), (jnp.arange(len(body.scanned)), points)
    )
    status = jnp.where(jnp.all(settled), OK, NOT_CONVERGED)
    status = jnp.where(broken, NON_FINITE, status)
    status = jnp.where(chart.overflow > state.chart.overflow, FULL, status).astype(jnp.int32)
    info = Info(
        links.pose.translation,
        links.pose.rotation,
        links.bias[:, 0],
        links.covariance,
        inliers,
        iterations,
        jax.vmap(linalg.eigh)(information)[0][:, 0],
        density,
        chart.overflow,
        status,
    )
    return State(links, chart, reading, state.index + 1), info


__all__ = ["Info", "Links", "Params", "State", "build", "init", "log_density"]
