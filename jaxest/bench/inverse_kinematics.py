"""Inverse kinematics: poses solved a second, beside the loop that Pinocchio gives as its example."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics
from jaxest.bench.harness import Candidate, Progress, candidate, compare, compile_row, find_peer, race
from jaxest.bench.robots import Subject, subjects, tips
from jaxest.io.report import Row

TOLERANCE = 1e-6
"""m and rad."""
SEED = 2004
"""Of the poses; none that constants were chosen on."""


def rows(*, peers: bool, progress: Progress, small: bool = False, robots: Sequence[str] = ()) -> Iterable[Row]:
    """Time inverse kinematics of a frame's full pose in float64, for the tip of each arm of each robot.

    A plain descent starts at the robot's home and stays where it is stuck; the default goes on from other places
    within the same call; 16 starts are descents side by side.

    Args:
        peers: whether to run Pinocchio: damped least squares without limits, as in its documentation, step 0.1.
        progress: hears what is being measured.
        small: 4 poses of one arm.
        robots: further robots, as files.

    Yields:
        Time per pose, and the share of reachable poses that was solved to 1e-6 m and rad.
    """
    with jax.enable_x64(True):
        for subject in subjects((3,) if small else (7,), False, robots, 1, peers):
            for tip in tips(subject.robot):
                progress(f"{subject.name}, {tip}")
                yield from _arm_rows(subject, tip, 4 if small else 1000, 1 if small else 5)


def _arm_rows(subject: Subject, tip: str, poses: int, repeats: int) -> Iterable[Row]:
    robot = subject.robot
    position, turn = _reachable(robot, tip, poses)
    keys = jax.random.split(jax.random.key(SEED), poses)

    def one(position: jax.Array, turn: jax.Array, key: jax.Array, **options: int) -> kinematics.Solution:
        return kinematics.inverse_kinematics(robot, {tip: kinematics.Target(position, turn)}, robot.home, **options)

    def several(position: jax.Array, turn: jax.Array, key: jax.Array) -> kinematics.Solution:
        targets = {tip: kinematics.Target(position, turn)}
        return kinematics.search_inverse_kinematics(robot, targets, robot.home, key=key)

    solvers: dict[str, Callable[..., kinematics.Solution]] = {
        "plain descent": partial(one, restarts=0),
        "one start": one,
        "16 starts": several,
    }
    functions = {what: jax.jit(jax.vmap(solve)) for what, solve in solvers.items()}
    arguments = (position, turn, keys)
    candidates = [candidate(what, f, *arguments, items=poses) for what, f in functions.items()]
    few = min(poses, 50)
    loop = partial(_pinocchio_loop, subject, tip, np.asarray(position[:few]), np.asarray(turn[:few]))
    if subject.pinocchio is not None:
        candidates.append(Candidate("Pinocchio's example in a loop", loop, few))
    found = race(candidates, repeats=repeats, min_time=0.0)
    for what, solve in functions.items():
        condition = f"{subject.name}, {tip}, {what}, {poses} poses, float64"
        yield compare("inverse kinematics", condition, found[what], found.get("Pinocchio's example in a loop"))
        solution = solve(*arguments)
        reached = (solution.position_error <= TOLERANCE) & (solution.rotation_error <= TOLERANCE)
        yield Row("poses solved within limits", condition, 100 * float(jnp.mean(reached)), "%", n=poses)
        yield compile_row(f"{subject.name}, inverse kinematics, {what}", found[what])
    if subject.pinocchio is not None:
        share = 100 * float(np.mean(loop()))
        yield Row("poses solved, limits ignored", f"{subject.name}, {tip}, Pinocchio, one start", share, "%", n=few)


def _reachable(robot: kinematics.Robot, tip: str, poses: int) -> tuple[jax.Array, jax.Array]:
    """Draw poses of a frame at configurations even within the limits, half a turn either way where there are none."""
    low, high = np.clip(robot.limits, -np.pi, np.pi).T
    q = np.random.default_rng(SEED).uniform(low, high, (poses, robot.nq))
    wanted = jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q, (tip,))))(q)
    return wanted.position[:, 0], wanted.quaternion[:, 0]


def _pinocchio_loop(subject: Subject, tip: str, position: np.ndarray, turn: np.ndarray) -> list[bool]:
    """Solve each pose by the loop of Pinocchio's documentation; tell which were reached."""
    pinocchio = find_peer("pinocchio")
    assert pinocchio is not None
    model = subject.pinocchio
    data, frame = model.createData(), model.getFrameId(tip)
    solved = []
    for where, quaternion in zip(position, turn, strict=True):
        goal = pinocchio.SE3(pinocchio.Quaternion(*quaternion).toRotationMatrix(), where)
        q = np.array(subject.robot.home)
        for _ in range(1000):
            pinocchio.framesForwardKinematics(model, data, q)
            offset = data.oMf[frame].actInv(goal)
            error = pinocchio.log(offset).vector
            if np.linalg.norm(error) < TOLERANCE:
                break
            slope = -pinocchio.Jlog6(offset.inverse()) @ pinocchio.computeFrameJacobian(model, data, q, frame)
            step = -slope.T @ np.linalg.solve(slope @ slope.T + 1e-12 * np.eye(6), error)
            q = pinocchio.integrate(model, q, 0.1 * step)
        solved.append(bool(np.linalg.norm(error) < TOLERANCE))
    return solved
