"""The posture of a robot as the paper has it: the pair filter on every edge, then the joint angles of its rotations.

Edges may form more than a tree: the redundant pair of IMU 1 and 3 in the paper gives q* = q1 + q2, which takes part in
the least squares like any other. `residual` shows how well the edges agree.

Source: Santaera 2015, Algorithm 2 and section IV; joint angles by least squares on the robot's manifold.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters import pair
from jaxest.filters.complementary import Params as Gains
from jaxest.filters.imu import Imu
from jaxest.kinematics import Robot, frame
from jaxest.kinematics.orientations import UNKNOWN, Observed, fit_orientations
from jaxest.manifolds import quaternion as quat
from jaxest.systems import posture
from jaxest.types import Array, ArrayLike, System


class Params(NamedTuple):
    """What may be tuned."""

    filter: Gains
    """of the pair filter"""
    mounting: ArrayLike
    """(n, 4) wxyz, each IMU to its frame"""
    start: ArrayLike
    """(nq,) posture from which the joints begin"""
    deviation: ArrayLike = 0.005
    """() rad, standard deviation of an edge's rotation about each axis that the vectors show: enters the covariance."""
    prior: ArrayLike = UNKNOWN
    """() rad^2, variance of a joint about the sample before it, where nothing tells."""


class State(NamedTuple):
    """What the next step needs."""

    filter: pair.State
    q: Array
    """(nq,)"""

    @property
    def index(self) -> Array:  # type: ignore[override]  # the contract's name hides a method of tuple
        """() int32, steps seen."""
        return self.filter.index


class Info(NamedTuple):
    """The estimate of one step."""

    q: Array
    """(nq,) joint coordinates; what no edge sees (the root) stays where it started."""
    covariance: Array
    """(nv, nv) of their errors in velocity coordinates."""
    known: Array
    """(nv,) share of the prior's variance that the edges took away."""
    quaternion: Array
    """(e, 4) wxyz, second IMU of each edge to the first."""
    bias: Array
    """(n, 3) rad/s"""
    residual: Array
    """(e, 3) rad along the first frame's axes: what the joints cannot explain of each edge."""
    valid: Array
    """() bool, whether every edge has a rotation."""
    status: Array
    """() int32; see `jaxest.types.status_message`."""


def build(
    robot: Robot,
    imus: Sequence[str],
    edges: Sequence[tuple[int, int]],
    *,
    magnetic: bool = False,
    iterations: int = 2,
) -> System:
    """Build the estimator.

    Args:
        robot: the robot.
        imus: the frames that carry an IMU each, `site:NAME` or a body.
        edges: pairs of them, by place in `imus`; `jaxest.filters.pair.tree` makes those of a tree.
        magnetic: whether the IMUs have magnetometers.
        iterations: Gauss-Newton steps a sample.

    Returns:
        The system. Its measurement is `imu.Imu` with a leading axis of n IMUs and one `dt`.

    Raises:
        InputError: a frame or an IMU does not exist, or an edge leads from an IMU to itself.
    """
    names = tuple(imus)
    for name in names:
        frame(robot, name)
    begin, advance = pair.over(edges, len(names))
    bound = pair.checked(edges, len(names))
    aligned = np.tile(np.array([1.0, 0, 0, 0]), (len(names), 1))
    params = Params(Gains(1.0, 0.01), aligned, np.asarray(robot.home, float))
    ends = tuple(names[j] for _, j in bound), tuple(names[i] for i, _ in bound)
    return System(
        params,
        partial(_init, begin),
        partial(_step, robot, bound, ends, advance, magnetic, iterations),
        partial(posture.simulate, robot, names, magnetic),
    )


def _init(begin: Any, params: Params, *, key: Array | None = None) -> State:
    inner = begin(params.filter)
    return State(inner, jnp.asarray(params.start, inner.quaternion.dtype))


def _step(
    robot: Robot,
    edges: pair.Edges,
    ends: Any,
    advance: Any,
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
    inner, found = advance(
        params.filter, state.filter, measurement if magnetic else measurement._replace(magnetometer=None)
    )
    mounting = jax.vmap(quat.normalize)(jnp.asarray(params.mounting, dtype))
    first, second = (mounting[np.array([edge[i] for edge in edges])] for i in (0, 1))
    seen = jax.vmap(lambda a, r, b: quat.compose(quat.compose(a, r), quat.inverse(b)))(first, found.quaternion, second)
    weight = jnp.where(inner.initialized, 1 / jnp.asarray(params.deviation, dtype) ** 2, 0)
    information = weight[:, None, None] * jnp.eye(3, dtype=dtype)[None]
    seconds, firsts = ends
    fit = fit_orientations(robot, seconds, Observed(seen, information), state.q, references=firsts,
                           prior=params.prior, iterations=iterations)  # fmt: skip
    info = Info(fit.q, fit.covariance, fit.known, found.quaternion, found.bias, fit.residual, jnp.all(found.valid),
                found.status)  # fmt: skip
    return State(inner, fit.q), info


__all__ = ["Info", "Params", "State", "build"]
