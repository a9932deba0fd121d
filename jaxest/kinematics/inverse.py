"""Inverse kinematics: joint coordinates that bring frames to where they are wanted, within limits."""

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics.fold import carriers
from jaxest.kinematics.forward import configuration, forward
from jaxest.kinematics.jacobian import jacobian
from jaxest.kinematics.robot import BALL, FREE, HINGE, NV, SLIDE, Robot, Topology, expand, frame
from jaxest.manifolds import quaternion
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike

PATIENCE = 6
"""Steps that may gain next to nothing before a descent counts as stuck."""
GAIN = 0.01
"""Part of the squared error that a step must take away to count as progress."""


class Target(NamedTuple):
    """Where a frame is wanted."""

    position: ArrayLike
    """(3,) m, in the world."""
    quaternion: ArrayLike | None = None
    """(4,) wxyz, frame to world; None where only the position matters."""
    position_weight: ArrayLike = 1.0
    """() 1/m, multiplies the position error."""
    rotation_weight: ArrayLike = 0.3
    """() 1/rad, multiplies the rotation error."""


class Solution(NamedTuple):
    """What was found."""

    q: Array
    """(nq,) rad or m, within the limits."""
    position_error: Array
    """() m, the largest of all targets."""
    rotation_error: Array
    """() rad, likewise; 0 where no orientation is wanted."""
    iterations: Array
    """() steps taken."""
    status: Array
    """() OK, NOT_CONVERGED, or NON_FINITE: a target or q0 is not finite, and q is meaningless."""


class _State(NamedTuple):
    q: Array
    error: Array
    slope: Array
    damping: Array
    idle: Array
    best: Array
    least: Array
    restart: Array
    iteration: Array


def inverse_kinematics(
    robot: Robot,
    targets: Mapping[str, Target],
    q0: ArrayLike,
    *,
    iterations: int = 200,
    restarts: int = 8,
    tolerance: float | None = None,
) -> Solution:
    """Find joint coordinates that bring frames to their targets, by damped least squares within the joint limits.

    One start; batch it over targets and starts with `jax.vmap`, and see `search_inverse_kinematics` for many starts.
    Ball and free joints move on their manifold, coupled joints follow their leaders. A step that does not help is
    undone and damped more; joints at a limit that the step would push beyond it are held there.

    Args:
        robot: the robot.
        targets: frame name -> `Target`; the names are static, all else may be traced. Several are met in the
            least-squares sense by their weights, and solved only if all of them are reached.
        q0: (nq,) start, rad or m; moved into the limits.
        iterations: static; most steps in all, restarts included.
        restarts: static; how often a descent that is stuck starts anew from another configuration, the next of a fixed
            sequence that fills the limits evenly; the solution is then not near q0. 0 for one descent, as when
            following a path.
        tolerance: static; m and rad that every target must be met to; None for 1e-8 in float64 and 1e-5 in float32.

    Returns:
        The solution, or the closest that was found.

    Raises:
        ValueError: a shape is wrong, or there is no target.
        InputError: a frame does not exist.

    Source: Sugihara 2011 (Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method), damping in
    proportion to the squared error; here scaled by success as in Marquardt's method, and bounded by projection.
    """
    q = configuration(robot, q0)
    tolerance = (1e-8 if q.dtype == jnp.float64 else 1e-5) if tolerance is None else tolerance
    aims = _aims(robot, targets, q.dtype)
    sound = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves((aims, q))]))
    aims, q = jax.tree.map(lambda x: jnp.where(sound, x, jnp.ones_like(x)), (aims, q))
    problem = _Problem(robot, aims, _movers(robot.topology, tuple(aims)))
    first = problem.start(problem.inside(q))

    def going(state: _State) -> Array:
        ended = (state.idle >= PATIENCE) & (state.restart >= restarts)
        return (state.iteration < iterations) & ~ended & ~problem.reached(state.least, tolerance)

    state = jax.lax.while_loop(going, partial(_step, problem, restarts), first)
    position, rotation = problem.largest(state.least)
    status = jnp.where(problem.reached(state.least, tolerance), OK, NOT_CONVERGED)
    return Solution(state.best, position, rotation, state.iteration, jnp.where(sound, status, NON_FINITE))


def search_inverse_kinematics(
    robot: Robot,
    targets: Mapping[str, Target],
    q0: ArrayLike,
    *,
    key: Array,
    starts: int = 16,
    iterations: int = 100,
    tolerance: float | None = None,
) -> Solution:
    """Solve inverse kinematics from several starts at once and return the best solution.

    Args:
        robot: the robot.
        targets: as in `inverse_kinematics`.
        q0: (nq,) the first start, rad or m; the others are drawn within the limits (half a turn or half a metre either
            way where there are none; free joints stay).
        key: for the starts.
        starts: static; number of starts, one descent each.
        iterations: static; most steps from each.
        tolerance: static; as in `inverse_kinematics`.

    Returns:
        Of the solved ones that whose hinges and slides moved least from q0; else the one with the smallest error.

    Raises:
        ValueError: a shape is wrong, there is no target, or fewer than one start.
        InputError: a frame does not exist.
    """
    if starts < 1:
        raise ValueError(f"starts: {starts}, expected at least 1")
    q = configuration(robot, q0)
    shares = jax.random.uniform(key, (starts - 1, robot.nq), q.dtype)
    others = jax.vmap(partial(_spot, robot, q))(shares)
    solve = partial(inverse_kinematics, robot, targets, iterations=iterations, restarts=0, tolerance=tolerance)
    found: Solution = jax.vmap(solve)(jnp.concatenate([q[None], others]))
    scalar = np.array([robot.topology.joint_q[j] for j in _scalars(robot.topology)], int)
    moved = jnp.sum((found.q - q[None])[:, scalar] ** 2, axis=1)
    error = jnp.maximum(found.position_error, found.rotation_error)
    solved = found.status == OK
    rank = jnp.where(solved, moved / (1 + moved), 1 + error)  # every solved one before every other
    return jax.tree.map(lambda x: x[jnp.argmin(rank)], found)


def _scalars(topology: Topology) -> list[int]:
    return [j for j, kind in enumerate(topology.joint_kind) if kind in (HINGE, SLIDE)]


def _aims(robot: Robot, targets: Mapping[str, Target], dtype: Any) -> dict[str, Target]:
    if not targets:
        raise ValueError("targets: none given, expected at least one frame")
    aims: dict[str, Target] = {}
    for name, target in targets.items():
        frame(robot, name)
        shapes = ((3,), (4,), (), ())
        for field, value, shape in zip(Target._fields, target, shapes, strict=True):
            if value is not None and jnp.shape(value) != shape:
                raise ValueError(f"targets[{name!r}].{field}: shape {jnp.shape(value)}, expected {shape}")
        aims[name] = Target(*(None if x is None else jnp.asarray(x, dtype) for x in target))
    return aims


class _Problem(NamedTuple):
    """A robot and what is wanted of it."""

    robot: Robot
    aims: dict[str, Target]
    movers: tuple[int, ...]

    def inside(self, q: Array) -> Array:
        """Move a configuration into the limits, and coupled joints to where their leaders put them."""
        q = jnp.clip(q, *jnp.asarray(self.robot.limits, q.dtype).T)
        free = self.robot.topology.free
        return expand(self.robot, q[np.array(free)]) if len(free) < self.robot.nq else q

    def start(self, q: Array) -> _State:
        """Return the state of a solver that stands at q."""
        error, slope = self.errors(q)
        zero = jnp.zeros((), int)
        return _State(q, error, slope, jnp.ones((), q.dtype), zero, q, error, zero, zero)

    def errors(self, q: Array) -> tuple[Array, Array]:
        """Return the weighted errors (m,) and how they shrink with the movers' velocities, (m, n)."""
        now = forward(self.robot, q, tuple(self.aims))
        errors: list[Array] = []
        slopes: list[Array] = []
        spread = _spread(self.robot, self.movers, q)
        for k, (name, aim) in enumerate(self.aims.items()):
            slope = jacobian(self.robot, q, name) @ spread
            errors.append(aim.position_weight * (aim.position - now.position[k]))
            slopes.append(aim.position_weight * slope[3:])
            if aim.quaternion is not None:
                turn = quaternion.log(quaternion.compose(aim.quaternion, quaternion.inverse(now.quaternion[k])))
                errors.append(aim.rotation_weight * turn)
                slopes.append(aim.rotation_weight * quaternion.right_jacobian_inverse(turn) @ slope[:3])
        return jnp.concatenate(errors), jnp.concatenate(slopes)

    def largest(self, error: Array) -> tuple[Array, Array]:
        """Return the largest position error, m, and rotation error, rad."""
        largest = [jnp.zeros((), error.dtype), jnp.zeros((), error.dtype)]
        at = 0
        for aim in self.aims.values():
            weights = (aim.position_weight, aim.rotation_weight)[: 1 if aim.quaternion is None else 2]
            for kind, weight in enumerate(weights):
                part = jnp.linalg.norm(error[at : at + 3])
                largest[kind] = jnp.maximum(largest[kind], part / jnp.where(weight > 0, weight, jnp.inf))
                at += 3
        return largest[0], largest[1]

    def reached(self, error: Array, tolerance: float) -> Array:
        """Tell whether every target is met."""
        position, rotation = self.largest(error)
        return (position <= tolerance) & (rotation <= tolerance)


def _step(problem: _Problem, restarts: int, state: _State) -> _State:
    """Take one damped step and keep it if the error falls; where nothing is gained any more, start anew."""
    cost = jnp.sum(state.error**2)
    stuck = state.idle >= PATIENCE
    q = problem.inside(_moved(problem.robot, state.q, _least_squares(problem, state)))
    if restarts:
        q = jnp.where(stuck, problem.inside(_scattered(problem.robot, state.best, state.restart + 1)), q)
    error, slope = problem.errors(q)
    found = jnp.sum(error**2)
    better = (found < cost) | stuck
    q, error, slope = (
        jnp.where(better, new, old) for new, old in ((q, state.q), (error, state.error), (slope, state.slope))
    )
    closer = found < jnp.sum(state.least**2)
    damping = jnp.clip(state.damping * jnp.where(better, 0.3, 5.0), 1e-3, 1e6)
    return _State(
        q,
        error,
        slope,
        jnp.where(stuck, 1.0, damping),
        jnp.where(stuck | (found < (1 - GAIN) * cost), 0, state.idle + 1),
        jnp.where(closer, q, state.best),
        jnp.where(closer, error, state.least),
        state.restart + stuck,
        state.iteration + 1,
    )


def _least_squares(problem: _Problem, state: _State) -> Array:
    """Return the damped step, (nv,), without the joints at a limit that it would push beyond."""
    low, high = _room(problem.robot, problem.movers, state.q)
    pull = state.slope.T @ state.error
    held = ((low >= 0) & (pull < 0)) | ((high <= 0) & (pull > 0))
    slope = jnp.where(held[None, :], 0, state.slope)
    damping = state.damping * jnp.sum(state.error**2) + 100 * jnp.finfo(slope.dtype).eps
    matrix = slope.T @ slope + damping * jnp.eye(slope.shape[1], dtype=slope.dtype)
    move = jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(matrix), True), jnp.where(held, 0, pull))
    return _spread(problem.robot, problem.movers, state.q) @ jnp.clip(move, low, high)


def _scattered(robot: Robot, q: Array, index: Array) -> Array:
    """Return a configuration of a sequence that fills the limits evenly; free joints stay.

    Source: the additive recurrence of Roberts 2018 (The unreasonable effectiveness of quasirandom sequences).
    """
    root = 2.0
    for _ in range(40):
        root = (1 + root) ** (1 / (robot.nq + 1))
    pace = jnp.asarray(root ** -np.arange(1.0, robot.nq + 1), q.dtype)
    return _spot(robot, q, (0.5 + index * pace) % 1)


def _spot(robot: Robot, q: Array, share: Array) -> Array:
    """Place each coordinate at a share of its range; half a turn either way, or half a metre, where it is endless."""
    topology = robot.topology
    scalar = np.zeros(robot.nq, bool)
    turns = np.zeros(robot.nq, bool)
    for kind, at in zip(topology.joint_kind, topology.joint_q, strict=True):
        scalar[at] = kind in (HINGE, SLIDE)
        turns[at] = kind == HINGE
        turns[at : at + 4] |= kind == BALL
    limits = jnp.asarray(robot.limits, q.dtype)
    reach = jnp.where(turns, jnp.pi, 0.5).astype(q.dtype)
    middle = jnp.where(turns, 0, q)
    low, high = (
        jnp.where(jnp.isfinite(limit), limit, middle + side * reach)
        for limit, side in ((limits[:, 0], -1), (limits[:, 1], 1))
    )
    return _moved(robot, jnp.where(scalar | turns, low + share * (high - low), q), jnp.zeros((robot.nv,), q.dtype))


def _movers(topology: Topology, frames: tuple[str, ...]) -> tuple[int, ...]:
    """Return the joints without a leader that move some of the frames, on the way to them or by coupling."""
    carried = carriers(topology)
    found: set[int] = set()
    for name in frames:
        joint = carried.frame[topology.frame_names.index(name)]
        while joint >= 0:
            found.add(joint)
            joint = carried.joint[joint]
    for joint, leader in reversed(topology.couplings):
        if joint in found:
            found |= {leader} if leader >= 0 else set()
    return tuple(sorted(found - {joint for joint, _ in topology.couplings}))


def _spread(robot: Robot, movers: tuple[int, ...], q: Array) -> Array:
    """Return how v follows from the velocities of the movers, (nv, n)."""
    topology = robot.topology
    rows = [np.arange(topology.joint_v[j], topology.joint_v[j] + NV[topology.joint_kind[j]]) for j in movers]
    own = np.eye(robot.nv, dtype=q.dtype)[:, np.concatenate([*rows, np.zeros(0, int)])]
    spread = jnp.asarray(own)
    for (joint, leader), coefficients in zip(topology.couplings, robot.coupling, strict=True):
        if leader < 0:
            continue
        at = topology.joint_q[leader]
        x = q[at] - jnp.asarray(robot.joint_reference, q.dtype)[at]
        slope = jnp.polyval(jnp.polyder(jnp.asarray(coefficients, q.dtype)[::-1]), x)
        spread = spread.at[topology.joint_v[joint]].set(slope * spread[topology.joint_v[leader]])
    return spread


def _room(robot: Robot, movers: tuple[int, ...], q: Array) -> tuple[Array, Array]:
    """Return how far each mover can go down and up, (n,) each, infinite for balls and free joints."""
    low: list[Array] = []
    high: list[Array] = []
    limits = jnp.asarray(robot.limits, q.dtype)
    for joint in movers:
        kind, at = robot.topology.joint_kind[joint], robot.topology.joint_q[joint]
        if kind in (BALL, FREE):
            endless = jnp.full((NV[kind],), jnp.inf, q.dtype)
            low, high = [*low, -endless], [*high, endless]
        else:
            low, high = [*low, limits[at : at + 1, 0] - q[at]], [*high, limits[at : at + 1, 1] - q[at]]
    return jnp.concatenate(low), jnp.concatenate(high)


def _moved(robot: Robot, q: Array, v: Array) -> Array:
    """Return where a robot stands after moving at velocity v (nv,) for 1 s, each rotation about a fixed axis."""
    if robot.nq == robot.nv:
        return q + v
    parts: list[Array] = []
    topology = robot.topology
    for kind, at, rate in zip(topology.joint_kind, topology.joint_q, topology.joint_v, strict=True):
        if kind in (BALL, FREE):
            shift = 3 if kind == FREE else 0
            parts.append(q[at : at + shift] + v[rate : rate + shift])
            turn, spin = q[at + shift : at + shift + 4], v[rate + shift : rate + shift + 3]
            parts.append(quaternion.retract(quaternion.normalize(turn), spin))
        else:
            parts.append(q[at : at + 1] + v[rate : rate + 1])
    return jnp.concatenate(parts)
