"""Batched forward kinematics and its gradient beside MuJoCo, Pinocchio and MJX."""

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics, models
from jaxest.bench.harness import Candidate, Progress, Timing, candidate, compare, compile_row, find_peer, race
from jaxest.bench.robots import Subject, joints_above, subjects
from jaxest.io.report import Row


def rows(*, peers: bool, progress: Progress, small: bool = False, robots: Sequence[str] = ()) -> Iterable[Row]:
    """Time plain `jax.jit(jax.vmap(forward))` in float32 for serial arms of 7, 20 and 50 joints and for robots.

    MuJoCo and Pinocchio are called in a Python loop that only sets q and calls; Pinocchio's Python package has no
    threaded forward kinematics to compare with. A gradient's reference is the forward of the same frame.

    Args:
        peers: whether to run MuJoCo, Pinocchio and MJX.
        progress: hears what is being measured.
        small: 16 configurations of one arm.
        robots: further robots, as files.

    Yields:
        Times per configuration for all frames, for two, for one and its gradient, and the times to compile.
    """
    batch = 16 if small else 2048
    for subject in subjects((7,) if small else (7, 20, 50), not small, robots, batch, peers):
        progress(subject.name)
        yield from _robot_rows(subject, peers, 2 if small else 15)
    if peers and not small:
        progress("mjx.kinematics")
        yield from _mjx_rows(batch)


def _robot_rows(subject: Subject, peers: bool, repeats: int) -> Iterable[Row]:
    robot, q = subject.robot, jnp.asarray(subject.q, jnp.float32)
    batch, robot_frames = len(q), len(robot.frame_names)
    pair = two_frames(robot)

    def poses(frames: Any) -> Any:
        return jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q, frames)))

    def reach(q: jax.Array) -> jax.Array:
        return kinematics.forward(robot, q, pair[:1]).position[0] @ jnp.array([0.3, 0.4, 0.5], q.dtype)

    weights = [np.linspace(-1, 1, robot_frames * k, dtype=np.float32).reshape(-1, k) for k in (3, 4)]

    def spread(q: jax.Array) -> jax.Array:
        position, quaternion = kinematics.forward(robot, q)
        return jnp.vdot(weights[0], position) + jnp.vdot(weights[1], quaternion)

    candidates = [
        candidate("all", poses(None), q, items=batch),
        candidate("two", poses(pair), q, items=batch),
        candidate("one", poses(pair[:1]), q, items=batch),
        candidate("gradient", jax.jit(jax.vmap(jax.grad(reach))), q, items=batch),
        candidate("gradient of all", jax.jit(jax.vmap(jax.grad(spread))), q, items=batch),
    ]
    if peers:
        candidates.append(Candidate("MuJoCo in a loop", lambda: _mujoco_loop(subject), batch))
    if subject.pinocchio is not None:
        candidates.append(Candidate("Pinocchio in a loop", lambda: _pinocchio_loop(subject), batch))
    found = race(candidates, repeats=repeats)
    mujoco, pinocchio = found.get("MuJoCo in a loop"), found.get("Pinocchio in a loop")
    for name, what in (("all", f"all {robot_frames} frames"), ("two", "two frames")):
        condition = f"{subject.name}, {what}, {batch} configurations, float32"
        yield compare("forward kinematics", condition, found[name], mujoco)
        if pinocchio is not None:
            yield compare("forward kinematics", condition, found[name], pinocchio)
    one = found["one"]._replace(name="forward of the same frame")
    yield compare("gradient of a position", f"{subject.name}, {batch} configurations", found["gradient"], one)
    forward = found["all"]._replace(name="forward of all frames")
    yield compare(
        "gradient of all frames", f"{subject.name}, {batch} configurations", found["gradient of all"], forward
    )
    for name, what in (("all", "forward of all frames"), ("gradient of all", "gradient of all frames")):
        yield compile_row(f"{subject.name}, {what}", found[name])


def two_frames(robot: kinematics.Robot) -> tuple[int, int]:
    """Choose two bodies far out on a robot: the one with most joints before it, and one on another branch.

    Args:
        robot: the robot.

    Returns:
        Their frames; on a chain the second is its middle.
    """
    above = joints_above(robot)
    first = max(range(len(above)), key=lambda body: len(above[body]))
    beside = [b for b in range(len(above)) if above[b] and above[b][0] not in above[first]]
    if beside:
        return first, max(beside, key=lambda body: len(above[body]))
    return first, max(b for b in range(len(above)) if 2 * len(above[b]) <= len(above[first]))


def _mujoco_loop(subject: Subject) -> None:
    import mujoco

    model, data = subject.model, mujoco.MjData(subject.model)
    call = mujoco.mj_kinematics
    for q in subject.q:
        data.qpos[:] = q
        call(model, data)


def _pinocchio_loop(subject: Subject) -> None:
    pinocchio = find_peer("pinocchio")
    assert pinocchio is not None
    model, data = subject.pinocchio, subject.pinocchio.createData()
    call = pinocchio.forwardKinematics
    for q in subject.q:
        call(model, data, q)


def _mjx_rows(batch: int) -> Iterable[Row]:
    from jaxest.kinematics import mjx

    for joints, compiled, what in ((4, jax.jit, "plain"), (7, mjx.jit, "without fusion emitters")):
        robot, backend = kinematics.load(models.chain(joints)), mjx.build(models.chain(joints))
        q = jnp.asarray(np.random.default_rng(0).uniform(-2, 2, (batch, joints)), jnp.float32)

        ours = jax.jit(jax.vmap(lambda q, robot=robot: kinematics.forward(robot, q)))
        found: dict[str, Timing] = race(
            [
                candidate("forward", ours, q, items=batch),
                candidate("mjx", compiled(jax.vmap(partial(mjx.forward, backend))), q, items=batch),
            ],
            repeats=10,
        )
        peer = found["mjx"]._replace(name=f"mjx.kinematics, {what}")
        condition = f"chain of {joints}, all frames, {batch} configurations, float32"
        yield compare("forward kinematics", condition, found["forward"], peer)
        yield compile_row(f"mjx.kinematics, {what}, chain of {joints}", peer)
