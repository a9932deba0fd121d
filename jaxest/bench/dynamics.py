"""Batched dynamics beside MuJoCo, Pinocchio and MJX."""

import importlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics, models
from jaxest.bench.harness import Candidate, Progress, Timing, candidate, compare, compile_row, find_peer, race
from jaxest.bench.robots import Subject, subjects
from jaxest.bench.robots import subject as one
from jaxest.bench.rollouts import rollout_rows
from jaxest.io.report import Row


def rows(*, peers: bool, progress: Progress, small: bool = False, robots: Sequence[str] = ()) -> Iterable[Row]:
    """Time plain `jax.jit(jax.vmap(forward_dynamics))` in float64 and its kin, for serial arms and for robots.

    MuJoCo and Pinocchio are called in a Python loop that only sets the state and calls. MuJoCo's `mj_forward` does
    more than dynamics (sensors, actuators; constraints are switched off).

    Args:
        peers: whether to run MuJoCo, Pinocchio and MJX.
        progress: hears what is being measured.
        small: 16 states of one arm.
        robots: further robots, as files.

    Yields:
        Times per state of the dynamics and their gradient, times to compile, and simulated steps of the arm of 7.
    """
    batch = 16 if small else 1024
    with jax.enable_x64(True):
        for subject in subjects((7,) if small else (7, 20), not small, robots, batch, peers):
            progress(subject.name)
            yield from _robot_rows(subject, peers, 2 if small else 15)
        arm = one("chain of 7", models.chain(7), batch, peers)
        if peers and not small:
            progress("mjx.forward")
            yield from _mjx_rows(arm)
        progress("rollouts")
        yield from rollout_rows(arm, 3 if small else 100, peers, small)


def _robot_rows(subject: Subject, peers: bool, repeats: int) -> Iterable[Row]:
    robot, batch = subject.robot, len(subject.q)
    states = tuple(jnp.asarray(x) for x in (subject.q, subject.v, subject.tau))

    def weighted(q: jax.Array, v: jax.Array, tau: jax.Array) -> jax.Array:
        return kinematics.forward_dynamics(robot, q, v, tau) @ jnp.linspace(-1, 1, robot.nv)

    functions: dict[str, Callable[..., jax.Array]] = {
        "forward dynamics": lambda q, v, tau: kinematics.forward_dynamics(robot, q, v, tau),
        "gradient of forward dynamics": jax.grad(weighted, argnums=(0, 1, 2)),
        "inverse dynamics": lambda q, v, a: kinematics.inverse_dynamics(robot, q, v, a),
        "mass matrix": lambda q, v, a: kinematics.mass_matrix(robot, q),
    }
    candidates = [candidate(name, jax.jit(jax.vmap(f)), *states, items=batch) for name, f in functions.items()]
    if peers:
        candidates.append(Candidate("MuJoCo's mj_forward in a loop", lambda: _mujoco_loop(subject), batch))
    theirs = _pinocchio_calls(subject) if subject.pinocchio is not None else {}
    candidates += [Candidate(name, call, batch) for name, call in theirs.items()]
    found = race(candidates, repeats=repeats)
    condition = f"{subject.name}, {batch} states, float64"
    for name in functions:
        references = _references(name, found)
        for reference in references or [None]:
            yield compare(name, condition, found[name], reference)
        if name.endswith("forward dynamics"):
            yield compile_row(f"{subject.name}, {name}", found[name])


def _references(name: str, found: dict[str, Timing]) -> list[Timing | None]:
    """Choose what a timing stands beside."""
    if name.startswith("gradient"):
        return [found["forward dynamics"]]
    peers = {
        "forward dynamics": ("pinocchio.aba in a loop", "pinocchio.abaInParallel", "MuJoCo's mj_forward in a loop"),
        "inverse dynamics": ("pinocchio.rnea in a loop",),
        "mass matrix": ("pinocchio.crba in a loop",),
    }
    return [found[peer] for peer in peers[name] if peer in found]


def _mujoco_loop(subject: Subject) -> None:
    import mujoco

    model, data = subject.model, mujoco.MjData(subject.model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    call = mujoco.mj_forward
    for q, v, tau in zip(subject.q, subject.v, subject.tau, strict=True):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, tau
        call(model, data)


def _pinocchio_calls(subject: Subject) -> dict[str, Callable[[], Any]]:
    pinocchio = find_peer("pinocchio")
    assert pinocchio is not None
    model, data = subject.pinocchio, subject.pinocchio.createData()
    states = list(zip(subject.q, subject.v, subject.tau, strict=True))

    def looped(call: Callable[..., Any], arguments: int) -> Callable[[], None]:
        def run() -> None:
            for state in states:
                call(model, data, *state[:arguments])

        return run

    calls: dict[str, Callable[[], Any]] = {
        "pinocchio.aba in a loop": looped(pinocchio.aba, 3),
        "pinocchio.rnea in a loop": looped(pinocchio.rnea, 3),
        "pinocchio.crba in a loop": looped(pinocchio.crba, 1),
    }
    if hasattr(pinocchio, "abaInParallel"):
        pool = pinocchio.ModelPool(model, 2)
        columns = [np.asfortranarray(x.T) for x in (subject.q, subject.v, subject.tau)]
        calls["pinocchio.abaInParallel"] = lambda: pinocchio.abaInParallel(2, pool, *columns)
    return calls


def _mjx_rows(subject: Subject) -> Iterable[Row]:
    from jaxest.kinematics import mjx  # first: MJX's own import prints what it has not found

    forward = importlib.import_module("mujoco.mjx").forward

    backend = mjx.build(models.chain(7), constraints=False)
    states = tuple(jnp.asarray(x) for x in (subject.q, subject.v, subject.tau))

    def smooth(q: jax.Array, v: jax.Array, tau: jax.Array) -> jax.Array:
        return forward(backend.model, backend.blank.replace(qpos=q, qvel=v, qfrc_applied=tau)).qacc_smooth

    def ours(q: jax.Array, v: jax.Array, tau: jax.Array) -> jax.Array:
        return kinematics.forward_dynamics(subject.robot, q, v, tau)

    batch = len(subject.q)
    found = race(
        [
            candidate("forward", jax.jit(jax.vmap(ours)), *states, items=batch),
            candidate("mjx", mjx.jit(jax.vmap(smooth)), *states, items=batch),
        ],
        repeats=10,
    )
    peer = found["mjx"]._replace(name="mjx.forward, without fusion emitters")
    yield compare("forward dynamics", f"{subject.name}, {batch} states, float64", found["forward"], peer)
    yield compile_row("mjx.forward, without fusion emitters, chain of 7", peer)
