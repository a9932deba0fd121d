"""The posture of a robot, hand or arm from inertial sensors on its links alone.

Each IMU's orientation comes from an attitude filter of its own; the joint coordinates are those that explain all of
them best, on the robot's manifold, anew at every sample. Without a magnetometer the heading of each IMU is its own.
These headings are estimated as slowly drifting states beside the joints: where the joints leave no room for a
difference of headings (hinges that are not vertical, see Laidig et al. 2019) it becomes known, and where they do, what
was learned before still holds for as long as the gyroscopes are good for; hinges that together turn any way (a
shoulder) say nothing of headings, whatever they seem to say at one moment. What cannot be known is reported so: `known`
near 0 and the variance of half a turn, as for the yaw of the root.

Source: Santaera 2015, sections III and IV, with links' orientations in place of pairs (pairs: `jaxest.filters.pair`).
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters import attitude
from jaxest.filters._state import apart
from jaxest.filters._time import elapsed
from jaxest.filters.imu import Imu
from jaxest.kinematics import Robot, frame
from jaxest.kinematics.movement import coupled, moved, movers, room, spread
from jaxest.kinematics.orientations import REACH, UNKNOWN, errors, rotations
from jaxest.manifolds import quaternion as quat
from jaxest.systems import orientation
from jaxest.systems._posture_fusion import Prior, fuse, joints
from jaxest.systems._posture_links import Loose, common, loose, turned_any_way
from jaxest.systems._posture_simulation import Truth, simulate
from jaxest.systems._posture_turns import about_up, turned, twist
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike, InputError, PyTree, System

SLACK = 0.3
"""How far an estimate may be beyond a joint's limits, rad: noise about a limit must not be cut off on one side."""
SMALL = 1e-5
"""Variance of an orientation about its own vertical, rad^2, where the heading is a state of its own."""


class Params(NamedTuple):
    """What may be tuned."""

    filter: PyTree
    """of the attitude filter, the same for all IMUs"""
    mounting: ArrayLike
    """(n, 4) wxyz, each IMU to its frame"""
    start: ArrayLike
    """(nq,) posture from which the joints, and the headings of IMUs without magnetometer, begin"""
    initial_heading: ArrayLike = 1.8
    """() or (n,) rad, standard deviation of those headings: half a turn either way where the start is unknown, some
    hundredths after a zero posture."""
    memory: ArrayLike = 0.5
    """() s, for how long the IMUs' tilts are wrong alike."""
    prior: ArrayLike = UNKNOWN
    """() rad^2, variance of a joint about the sample before it, where nothing tells."""


class State(NamedTuple):
    """What the next step needs, for n IMUs."""

    filters: PyTree
    """of the attitude filter, leaves (n, ...)"""
    q: Array
    """(nq,) joint coordinates."""
    heading: Array
    """(n,) rad, by how much each IMU's orientation is turned about the vertical."""
    heading_covariance: Array
    """(n, n) rad^2"""
    heading_doubt: Array
    """(n, n) rad^2, the same without what hinges that turn any way seem to say at one moment."""
    heading_variance: Array
    """(n,) rad^2, of the attitude filters' own headings at this sample; what they gain the covariance gains."""
    begun: Array
    """(n,) bool, whether each IMU's heading has been set."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate of one step and how it came about."""

    q: Array
    """(nq,) joint coordinates, rad (m for slides, which stay where they started)."""
    covariance: Array
    """(nv, nv) of their errors in velocity coordinates."""
    known: Array
    """(nv,) 1 less the share of the prior's variance that sensors and headings leave; far below 1: not observed."""
    quaternion: Array
    """(n, 4) wxyz, each IMU to earth, its heading corrected."""
    heading: Array
    """(n,) rad, the correction."""
    heading_deviation: Array
    """(n,) rad, its standard deviation."""
    residual: Array
    """(n, 3) rad in the earth frame: what the joints cannot explain of each orientation."""
    valid: Array
    """() bool, whether every IMU has an orientation."""
    status: Array
    """() int32, `OK`, `NON_FINITE` or `NOT_CONVERGED`; see `jaxest.types.status_message`."""


def build(
    robot: Robot,
    imus: Sequence[str],
    *,
    magnetic: bool = False,
    filter: Any = attitude.ekf,
    iterations: int = 2,
) -> System:
    """Build the posture estimator of one robot.

    Args:
        robot: the robot; its root may turn (a ball or free joint), and where it moves to does not matter.
        imus: the frames that carry an IMU each, `site:NAME` or a body; `Params.mounting` turns the IMUs in them.
        magnetic: whether the IMUs have magnetometers that can be trusted for a common heading.
        filter: module of the attitude filter: `jaxest.filters.attitude.ekf`, `decoupled`, or `complementary`.
        iterations: Gauss-Newton steps a sample.

    Returns:
        The system. Its measurement is `imu.Imu` with a leading axis of n IMUs on values and flags and one
        `dt`.

    Raises:
        InputError: a frame does not exist, is named twice, or no joint moves any of them.
        ValueError: the filter gives no covariance.
    """
    names = tuple(imus)
    for name in names:
        frame(robot, name)
    if len(set(names)) != len(names) or not names:
        raise InputError(f"imus: got {', '.join(names) or 'none'}, expected different frames, at least one")
    if not movers(robot.topology, names):
        raise InputError(f"imus: no joint moves any of {', '.join(names)}")
    if filter is attitude.madgwick:
        raise ValueError("filter: madgwick gives no covariance, expected ekf, decoupled or complementary")
    sensors = orientation.SENSORS if magnetic else orientation.SENSORS[:2]
    inner = orientation.build(sensors=sensors, filter=filter, covariance=hasattr(filter, "projection"))
    aligned = np.tile(np.array([1.0, 0, 0, 0]), (len(names), 1))
    params = Params(inner.default_params, aligned, np.asarray(robot.home, float))
    return System(
        params,
        partial(init, inner, len(names)),
        partial(step, robot, names, loose(robot, names), inner, magnetic, iterations),
        partial(simulate, robot, names, magnetic),
    )


def init(inner: System, count: int, params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen no data."""
    one = inner.init(params.filter)
    filters = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *jnp.shape(x))), one)
    dtype = next(x.dtype for x in jax.tree.leaves(one) if jnp.issubdtype(x.dtype, jnp.floating))
    zero = jnp.zeros(count, dtype)
    first = State(
        filters,
        jnp.asarray(params.start, dtype),
        zero,
        jnp.zeros((count, count), dtype),
        jnp.zeros((count, count), dtype),
        zero,
        jnp.zeros(count, bool),
        jnp.zeros((), jnp.int32),
    )
    return apart(first)


def step(
    robot: Robot,
    names: tuple[str, ...],
    free: Loose,
    inner: System,
    magnetic: bool,
    iterations: int,
    params: Params,
    state: State,
    measurement: Imu,
    *,
    key: Array | None = None,
) -> tuple[State, Info]:
    """Take in one sample of every IMU; the leading arguments are bound by `build`."""
    dtype = state.q.dtype
    axes: Any = Imu._make([0, 0, 0 if magnetic else None, None])
    one = measurement if magnetic else measurement._replace(magnetometer=None)
    filters, infos = jax.vmap(partial(inner.step, params.filter), (0, axes))(state.filters, one)
    mounting = jax.vmap(quat.normalize)(jnp.asarray(params.mounting, dtype))
    raw = jax.vmap(lambda q, m: quat.compose(q, quat.inverse(m)))(infos.quaternion, mounting)  # frame to earth
    earth = jax.vmap(lambda q, c: turned(quat.to_matrix(q), c))(infos.quaternion, infos.covariance)
    state, noise = _headings(robot, names, magnetic, params, state, raw, earth, infos.valid)
    bound = robot, names, free, magnetic, iterations
    state, fused, residual, up = _solved(*bound, params, state, raw, noise, _share(params, measurement.dt, dtype))
    across = spread(robot, movers(robot.topology, names), state.q)
    prior = jnp.asarray(params.prior, dtype)
    still = jnp.where(jnp.any(across != 0, axis=1), 0, prior)
    still = still + turned_any_way(free, state.heading_doubt)
    covariance = across @ fused.covariance @ across.T + jnp.diag(still)
    if not magnetic:
        covariance = covariance + common(free, up, jnp.asarray(params.initial_heading, dtype))
    before = jnp.sum(across * across, axis=1) * prior
    variance = jnp.diagonal(covariance)
    rest = before - variance  # an unknown heading and the prior are both in it: 1 / (1 / variance - 1 / before) is told
    known = jnp.where(rest > variance, 1 - variance / jnp.where(rest > variance, rest, 1), 0)
    corrected = jax.vmap(lambda h, q: quat.compose(about_up(-h), q))(state.heading, infos.quaternion)
    finite = jnp.isfinite(jnp.sum(covariance)) & jnp.isfinite(jnp.sum(state.q))
    status = jnp.maximum(jnp.max(infos.status), jnp.where(finite, OK, NOT_CONVERGED)).astype(jnp.int32)
    status = jnp.where(jnp.any(infos.status == NON_FINITE), NON_FINITE, status)
    deviation = jnp.sqrt(jnp.maximum(jnp.diagonal(state.heading_doubt), 0) + jnp.finfo(dtype).tiny)
    info = Info(state.q, covariance, known, corrected, state.heading, deviation, residual, jnp.all(infos.valid), status)
    return state._replace(filters=filters, index=state.index + 1), info


def _headings(
    robot: Robot, names: Any, magnetic: bool, params: Params, state: State, raw: Array, earth: Array, valid: Array
) -> tuple[State, Array]:
    """Let headings begin and drift; return also each orientation's noise (n, 3, 3) beside its heading's."""
    dtype = state.q.dtype
    count = len(names)
    variance = earth[:, 2, 2]
    if magnetic:
        return state._replace(heading_variance=variance, begun=valid), earth
    model, _ = rotations(robot, state.q, names)
    new = valid & ~state.begun
    turn = jax.vmap(lambda r, m: 2 * jnp.arctan2(*twist(quat.compose(r, quat.inverse(m)))))(raw, model)
    first = jnp.where(new, jnp.broadcast_to(jnp.asarray(params.initial_heading, dtype), (count,)), 0)
    grown = jnp.where(state.begun, jnp.maximum(variance - state.heading_variance, 0), 0)
    more = jnp.diag(grown + first * first)
    moved = state._replace(
        heading=jnp.where(new, turn, state.heading),
        heading_covariance=state.heading_covariance + more,
        heading_doubt=state.heading_doubt + more,
        heading_variance=variance,
        begun=state.begun | valid,
    )
    flat = np.zeros((1, 3, 3), bool)
    flat[:, :2, :2] = True
    own = jnp.where(flat, earth, 0) + jnp.asarray(np.diag([0, 0, SMALL])[None], dtype)
    unknown = UNKNOWN * jnp.eye(3, dtype=dtype)[None]
    return moved, jnp.where(moved.begun[:, None, None], own, unknown)


def _solved(
    robot: Robot,
    names: Any,
    free: Loose,
    magnetic: bool,
    iterations: int,
    params: Params,
    state: State,
    raw: Array,
    noise: Array,
    share: Array,
) -> tuple[State, Any, Array, Array]:
    """Move joints, and headings at last; return also residuals (n, 3) and turns about the vertical (n, nv)."""
    moving = movers(robot.topology, names)
    prior, groups = (jnp.asarray(x, state.q.dtype) for x in (params.prior, free.carried))

    def once(carry: Any, share: Array) -> Any:
        q, heading, before = carry
        seen = jax.vmap(lambda h, r: quat.compose(about_up(-h), r))(heading, raw)
        error, slope = errors(robot, q, names, None, seen)
        across = spread(robot, moving, q)
        given = slope @ across, noise, error, before
        fused = joints(*given) if magnetic else fuse(*given, share, groups)
        move = jnp.clip(fused.move, *_room(robot, moving, q))
        q = coupled(robot, moved(robot, q, across @ move))
        after = Prior(fused.heading_covariance, fused.heading_doubt, prior, before.gone + move)
        return (q, heading + fused.heading_move, after), fused

    shares = jnp.concatenate([jnp.zeros(iterations - 1, share.dtype), share[None]])
    size = spread(robot, moving, state.q).shape[1]
    before = Prior(state.heading_covariance, state.heading_doubt, prior, jnp.zeros(size, state.q.dtype))
    (q, heading, after), fused = jax.lax.scan(once, (state.q, state.heading, before), shares)
    seen = jax.vmap(lambda h, r: quat.compose(about_up(-h), r))(heading, raw)
    residual, slope = errors(robot, q, names, None, seen)
    state = state._replace(q=q, heading=heading, heading_covariance=after.heading, heading_doubt=after.doubt)
    return state, jax.tree.map(lambda x: x[-1], fused), residual, slope[:, 2]


def _room(robot: Robot, moving: tuple[int, ...], q: Array) -> tuple[Array, Array]:
    """How far the joints may move in one step: not by whole turns, nor far beyond their limits."""
    low, high = room(robot, moving, q)
    return jnp.clip(low - SLACK, -REACH, 0), jnp.clip(high + SLACK, 0, REACH)


def _share(params: Params, dt: ArrayLike, dtype: Any) -> Array:
    return jnp.clip(elapsed(dt, dtype)[0] / (2 * jnp.asarray(params.memory, dtype)), 0, 1)


__all__ = ["Info", "Params", "State", "Truth", "build", "simulate"]
