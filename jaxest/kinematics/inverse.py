"""Inverse kinematics: joint coordinates that bring frames to where they are wanted, within limits."""

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.kinematics.forward import configuration, forward
from jaxest.kinematics.jacobian import jacobian
from jaxest.kinematics.movement import coupled, followers, moved, movers, room, scalars, scattered, spot, spread
from jaxest.kinematics.robot import Robot, frame
from jaxest.manifolds import quaternion
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike

PATIENCE = 12
"""Steps that may gain next to nothing before a descent counts as stuck."""
CENTRING = 0.5
"""Pull to the middle of the limits, times the squared error, where half the range counts as 1."""
NEAR = 1e-3
"""Squared error below which that pull fades faster."""
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
    """(nq,) rad or m, within the limits but for coupled joints, which follow their leaders."""
    position_error: Array
    """() m, the largest of all targets."""
    rotation_error: Array
    """() rad, likewise; 0 where no orientation is wanted."""
    iterations: Array
    """() steps taken."""
    status: Array
    """() OK, NOT_CONVERGED (a target is not met, or a coupled joint is beyond its limits), or NON_FINITE: a target or
    q0 is not finite, and q is meaningless."""


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
    problem = _Problem(robot, aims, movers(robot.topology, tuple(aims)))
    first = problem.start(problem.inside(q))

    def going(state: _State) -> Array:
        ended = (state.idle >= PATIENCE) & (state.restart >= restarts)
        return (state.iteration < iterations) & ~ended & ~problem.reached(state.least, tolerance)

    state = jax.lax.while_loop(going, partial(_step, problem, restarts), first)
    position, rotation = problem.largest(state.least)
    solved = problem.reached(state.least, tolerance) & problem.followed(state.best, tolerance)
    status = jnp.where(solved, OK, NOT_CONVERGED)
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
    others = jax.vmap(partial(spot, robot, q))(shares)
    solve = partial(inverse_kinematics, robot, targets, iterations=iterations, restarts=0, tolerance=tolerance)
    found: Solution = jax.vmap(solve)(jnp.concatenate([q[None], others]))
    scalar = np.array([robot.topology.joint_q[j] for j in scalars(robot.topology)], int)
    change = jnp.sum((found.q - q[None])[:, scalar] ** 2, axis=1)
    error = jnp.maximum(found.position_error, found.rotation_error)
    solved = found.status == OK
    rank = jnp.where(solved, change / (1 + change), 1 + error)  # every solved one before every other
    return jax.tree.map(lambda x: x[jnp.argmin(rank)], found)


class _Aim(NamedTuple):
    """A target as arrays."""

    position: Array
    quaternion: Array | None
    position_weight: Array
    rotation_weight: Array


def _aims(robot: Robot, targets: Mapping[str, Target], dtype: Any) -> dict[str, _Aim]:
    if not targets:
        raise ValueError("targets: none given, expected at least one frame")
    aims: dict[str, _Aim] = {}
    for name, target in targets.items():
        frame(robot, name)
        shapes = ((3,), (4,), (), ())
        for field, value, shape in zip(Target._fields, target, shapes, strict=True):
            if value is not None and jnp.shape(value) != shape:
                raise ValueError(f"targets[{name!r}].{field}: shape {jnp.shape(value)}, expected {shape}")
        turn = None if target.quaternion is None else jnp.asarray(target.quaternion, dtype)
        position, *weights = (
            jnp.asarray(x, dtype) for x in (target.position, target.position_weight, target.rotation_weight)
        )
        aims[name] = _Aim(position, turn if turn is None else quaternion.normalize(turn), *weights)
    return aims


class _Problem(NamedTuple):
    """A robot and what is wanted of it."""

    robot: Robot
    aims: dict[str, _Aim]
    movers: tuple[int, ...]

    def inside(self, q: Array) -> Array:
        """Move a configuration into the limits, and coupled joints to where their leaders put them."""
        q = jnp.clip(q, *jnp.asarray(self.robot.limits, q.dtype).T)
        return coupled(self.robot, q)

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
        moves = spread(self.robot, self.movers, q)
        for k, (name, aim) in enumerate(self.aims.items()):
            slope = jacobian(self.robot, q, name) @ moves
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

    def followed(self, q: Array, tolerance: float) -> Array:
        """Tell whether the joints that follow the movers are within their limits, wherever those take them."""
        at = np.array([self.robot.topology.joint_q[j] for j in followers(self.robot.topology, self.movers)], int)
        low, high = jnp.asarray(self.robot.limits, q.dtype)[at].T
        return jnp.all((q[at] >= low - tolerance) & (q[at] <= high + tolerance))


def _step(problem: _Problem, restarts: int, state: _State) -> _State:
    """Take one damped step and keep it if the error falls; where nothing is gained any more, start anew."""
    cost = jnp.sum(state.error**2)
    stuck = state.idle >= PATIENCE
    q = problem.inside(moved(problem.robot, state.q, _least_squares(problem, state)))
    if restarts:
        q = jnp.where(stuck, problem.inside(scattered(problem.robot, state.best, state.restart + 1)), q)
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
    """Return the damped step, (nv,), without the joints at a limit that it would push beyond.

    Damping and the pull to the middle of the limits fade with the squared error, so that neither keeps the solution
    from being exact. Without the pull half as many descents fail again, stuck at a limit (measured).
    """
    low, high = room(problem.robot, problem.movers, state.q)
    cost = jnp.sum(state.error**2)
    half = (high - low) / 2
    limited = jnp.isfinite(half)
    fading = CENTRING * cost * cost / (cost + NEAR)
    centring = jnp.where(limited, fading / jnp.where(limited, half, 1) ** 2, 0)
    pull = state.slope.T @ state.error + centring * jnp.where(limited, (low + high) / 2, 0)
    held = ((low >= 0) & (pull < 0)) | ((high <= 0) & (pull > 0))
    slope = jnp.where(held[None, :], 0, state.slope)
    damping = centring + state.damping * cost + 100 * jnp.finfo(slope.dtype).eps
    factor = linalg.cholesky(slope.T @ slope + jnp.diag(damping))
    move = linalg.cho_solve(factor, jnp.where(held, 0, pull))
    return spread(problem.robot, problem.movers, state.q) @ jnp.clip(move, low, high)
