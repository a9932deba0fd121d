"""Inverse kinematics: poses solved a second, beside the loop that Pinocchio gives as its example."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics, models
from jaxest.bench.harness import Candidate, Progress, candidate, compare, compile_row, find_peer, race
from jaxest.bench.robots import pinocchio_model
from jaxest.io.report import Row

TOLERANCE = 1e-6


def rows(*, peers: bool, progress: Progress, small: bool = False, robots: Sequence[str] = ()) -> Iterable[Row]:
    """Time inverse kinematics of a frame's full pose in float64, for the last body of each robot.

    Args:
        peers: whether to run Pinocchio: damped least squares without limits, as in its documentation, step 0.1.
        progress: hears what is being measured.
        small: 4 poses of one arm.
        robots: further robots, as files.

    Yields:
        Time per pose, and the share of reachable poses that was solved to 1e-6 m and rad.
    """
    sources: list[tuple[str, str | Path]] = [("chain of 7", models.chain(7))]
    sources += [(Path(file).name, file) for file in robots]
    with jax.enable_x64(True):
        for name, source in sources:
            progress(name)
            yield from _robot_rows(name, source, 4 if small else 1000, peers, 1 if small else 5)


def _robot_rows(name: str, source: str | Path, poses: int, peers: bool, repeats: int) -> Iterable[Row]:
    robot = kinematics.load(source)
    body = len(robot.topology.body_names) - 1
    tip = robot.frame_names[body]
    low, high = np.clip(robot.limits, -np.pi, np.pi).T
    q = np.random.default_rng(0).uniform(low, high, (poses, robot.nq))
    wanted = jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q, (body,))))(q)
    position, turn = wanted.position[:, 0], wanted.quaternion[:, 0]
    keys = jax.random.split(jax.random.key(0), poses)

    def one(position: jax.Array, turn: jax.Array, key: jax.Array) -> kinematics.Solution:
        return kinematics.inverse_kinematics(robot, {tip: kinematics.Target(position, turn)}, robot.home)

    def several(position: jax.Array, turn: jax.Array, key: jax.Array) -> kinematics.Solution:
        targets = {tip: kinematics.Target(position, turn)}
        return kinematics.search_inverse_kinematics(robot, targets, robot.home, key=key)

    arguments = (jnp.asarray(position), jnp.asarray(turn), keys)
    functions = {"one start": jax.jit(jax.vmap(one)), "16 starts": jax.jit(jax.vmap(several))}
    candidates = [candidate(what, f, *arguments, items=poses) for what, f in functions.items()]
    theirs = pinocchio_model(source, robot) if peers else None
    few = min(poses, 50)
    if theirs is not None:
        call = lambda: _pinocchio_loop(theirs, robot, tip, np.asarray(position[:few]), np.asarray(turn[:few]))  # noqa: E731
        candidates.append(Candidate("Pinocchio's example in a loop", call, few))
    found = race(candidates, repeats=repeats, min_time=0.0)
    for what, solve in functions.items():
        condition = f"{name}, {what}, {poses} poses, float64"
        yield compare("inverse kinematics", condition, found[what], found.get("Pinocchio's example in a loop"))
        solution = solve(*arguments)
        reached = (solution.position_error <= TOLERANCE) & (solution.rotation_error <= TOLERANCE)
        yield Row("poses solved within limits", condition, 100 * float(jnp.mean(reached)), "%", n=poses)
        yield compile_row(f"{name}, inverse kinematics, {what}", found[what])
    if theirs is not None:
        share = 100 * float(np.mean(call()))
        yield Row("poses solved, limits ignored", f"{name}, Pinocchio's example, one start", share, "%", n=few)


def _pinocchio_loop(
    model: Any, robot: kinematics.Robot, tip: str, position: np.ndarray, turn: np.ndarray
) -> list[bool]:
    """Solve each pose by the loop of Pinocchio's documentation; tell which were reached."""
    pinocchio = find_peer("pinocchio")
    assert pinocchio is not None
    data, frame = model.createData(), model.getFrameId(tip)
    solved = []
    for where, quaternion in zip(position, turn, strict=True):
        goal = pinocchio.SE3(pinocchio.Quaternion(*quaternion).toRotationMatrix(), where)
        q = np.array(robot.home)
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
