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
from jaxest.filters.kalman import Gaussian, independent, information_gain, predict
from jaxest.filters.kalman.gain import Gained
from jaxest.filters.kalman.gaussian import product
from jaxest.filters.kalman.model import clean
from jaxest.kinematics import Robot
from jaxest.manifolds import Euclidean, quaternion, se3
from jaxest.manifolds import product as products
from jaxest.mapping import Hashed, Layout, VoxelMap, empty, insert
from jaxest.sensors.proximity import Proximity
from jaxest.systems import _slam_body as bodies
from jaxest.systems import _slam_hang as hang
from jaxest.systems import slam
from jaxest.systems._slam_body import Body
from jaxest.systems._slam_hang import Chain
from jaxest.systems._slam_register import Config, subset
from jaxest.systems._slam_rows import Points, Pose, match, moved, sums, world
from jaxest.systems._slam_simulation import simulate
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike, System

TURNED = 1e-3  # m or rad: an update has converged when it moves less


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


class Links(NamedTuple):
    """Beliefs of L links; a link's element is (pose, bias), its tangent [rotation, translation, bias] in the link."""

    pose: se3.Pose
    """(L, ...) link to world."""
    bias: Array
    """(L, 1)."""
    covariance: Array
    """(L, 7, 7)."""


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


NODE = products.of((se3, Euclidean((1,))))
PAIR = products.of((se3, Euclidean((1,)), Euclidean((1,))))


def build(
    robot: Robot,
    sensors: Sequence[Proximity],
    *,
    layout: Layout | None = None,
    capacity: int = 16384,
    points: int = 128,
    iterations: int = 10,
    least: int = 12,
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
    body = bodies.body(robot, sensors)
    chain = hang.chain(body)
    config = Config(layout or Hashed(0.2), points, iterations, least, True)
    measurement = slam.Fixed if body.root is None else slam.Free
    return System(
        Params(),
        partial(init, body, config.layout, capacity),
        partial(_step, body, chain, config),
        lambda params, **options: simulate(body, measurement, slam.Params(), **options),
    )


def init(body: Body, layout: Layout, capacity: int, params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen nothing."""
    del key
    dtype = jnp.result_type(*jax.tree.leaves(params))
    count = len(body.scanned)
    turn = jnp.zeros((count, 4), dtype).at[:, 0].set(1)
    root = bodies.home(body, dtype)
    if body.root is not None:
        turn = turn.at[0].set(root.quaternion)
    place = jnp.zeros((count, 3), dtype).at[0].set(root.position)
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
    fixed = Chain(*(jax.tree.map(jnp.asarray, x) for x in chain))
    parts = max(1, body.rays.index.shape[1] // config.points)
    turn = jnp.mod(state.index, parts)
    free = 1.0 if body.root is not None else 0.0

    def link(carry: tuple[Links, VoxelMap], row: tuple[Array, Points]) -> Any:
        links, chart = carry
        at, points = row
        own = jax.tree.map(lambda x: jax.lax.dynamic_index_in_dim(x, at, keepdims=False), (links, fixed))
        prior = _predict(params, own[0], own[1], links, fixed, reading, free, at == 0)
        some = jax.tree.map(lambda x: subset(x, parts, turn), points)
        after, outcome = _update(config, params, rows, prior, chart, some)
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
    status = jnp.where(broken, NON_FINITE, status).astype(jnp.int32)
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


def _predict(
    params: Params, own: Links, fixed: Chain, links: Links, chain: Chain, reading: Array, free: float, root: Array
) -> Gaussian:
    """Carry the parent's belief and the link's past bias to the link; the root's own past to the root."""
    del chain
    up = jnp.maximum(fixed.parent, 0)
    parent, spread = jax.tree.map(
        lambda x: jax.lax.dynamic_index_in_dim(x, up, keepdims=False), (links.pose, links.covariance)
    )
    dtype = spread.dtype

    def hang(x: Any) -> Any:
        (pose, bias, noise) = x
        coordinate = reading[fixed.joint] - bias[0] + noise[0]
        turn = quaternion.exp(jnp.where(fixed.hinge, coordinate, 0) * fixed.axis.astype(dtype))
        anchor = fixed.anchor.astype(dtype)
        slid = jnp.where(fixed.hinge, 0, coordinate) * fixed.axis.astype(dtype)
        own = se3.Pose(turn, jnp.asarray(anchor - quaternion.rotate(turn, anchor) + slid))
        offset = jax.tree.map(lambda v: v.astype(dtype), fixed.offset)
        return se3.compose(se3.compose(pose, offset), own), bias

    past = Gaussian(own.bias, own.covariance[6:, 6:] + params.bias_walk**2)
    noise = Gaussian(jnp.zeros(1, dtype), jnp.full((1, 1), params.encoder**2))
    both = independent(Gaussian(parent, spread[:6, :6]), past, noise)
    hung = predict(PAIR, both, hang, target=NODE)
    walk = jnp.zeros(7, dtype).at[:6].set(free * params.root_walk**2)
    still = Gaussian((own.pose, own.bias), own.covariance + jnp.diag(walk))
    return jax.tree.map(lambda a, b: jnp.where(root, a, b), still, hung)


def _update(
    config: Config, params: Params, rows: slam.Params, prior: Gaussian, chart: VoxelMap, points: Points
) -> tuple[Gaussian, Any]:
    """Iterate over the link's own 7 numbers; planes are looked for at each iteration that moves the link."""
    dtype = prior.covariance.dtype
    pose = prior.mean[0]
    turn = quaternion.to_matrix(pose.rotation)
    wide = jnp.zeros((3, 7), dtype)
    start = Pose(pose.translation, turn, wide.at[:, :3].set(turn), wide.at[:, 3:6].set(turn))
    none = jnp.zeros((6, 6), dtype)

    def once(v: Array) -> Any:
        at = moved(start, v)
        found = match(config.layout, chart, rows, at, points, jnp.zeros(0, dtype), prior.covariance)
        found = found._replace(weight=jnp.where(found.weight > 0, 1 / params.variance, 0))
        s = sums(found, points, none)
        enough = s.inliers >= config.least
        information, pull = jnp.where(enough, s.information, 0), jnp.where(enough, s.pull, 0)
        gained = information_gain(prior.covariance, information, pull + product(information, v))
        innovation, weight = found.residual - product(found.design, v), jnp.where(enough, found.weight, 0)
        return gained.correction, gained.covariance, s.inliers, s.pose, log_density(gained, innovation, weight)

    def again(state: Any, _: None) -> Any:
        result, last, count = state
        far = (count == 0) | (jnp.max(jnp.abs(jax.lax.stop_gradient(result[0] - last))) > TURNED)
        new = jax.lax.cond(far, lambda: once(result[0]), lambda: result)
        return (new, jnp.where(far, result[0], last), count + far.astype(jnp.int32)), None

    zero = jnp.zeros(7, dtype)
    (result, last, count), _ = jax.lax.scan(again, (once(zero), zero, jnp.int32(1)), None, length=config.rounds - 1)
    v, covariance, inliers, information, density = result
    after = Gaussian(NODE.retract(prior.mean, v), covariance)
    settled = jnp.max(jnp.abs(v - last)) <= 10 * TURNED
    return after, (inliers, count, settled, information, density)


def log_density(gained: Gained, innovation: Array, weight: Array) -> Array:
    """Return the log-density () of rows that were summed up, given the belief before them.

    Args:
        gained: as `filters.kalman.information_gain` made it of their sums.
        innovation: (n,) residuals at the belief's mean, by the linearisation that was summed up.
        weight: (n,) one over each row's variance; 0 where a row does not count.
    """
    used = weight > 0
    safe = jnp.where(used, weight, 1)
    own = jnp.sum(weight * innovation**2) + jnp.sum(jnp.where(used, jnp.log(2 * jnp.pi / safe), 0))
    return -(own + gained.nis + gained.log_det) / 2


__all__ = ["Info", "Links", "Params", "State", "build", "init", "log_density"]
