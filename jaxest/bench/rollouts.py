"""Simulated steps of an arm beside `mujoco.rollout` on two threads, and MJX."""

from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics
from jaxest.bench.harness import Candidate, Timing, candidate, compare, compile_row, race
from jaxest.bench.robots import Subject
from jaxest.io.report import Row

THREADS = 2


def rollout_rows(subject: Subject, steps: int, peers: bool, small: bool) -> Iterable[Row]:
    """Time simulations by semi-implicit Euler under constant torques, without constraints, float64.

    `mujoco.rollout` is compiled C over one state at a time, whose few kilobytes stay in the nearest cache. In ours
    and in MJX every operation reads and writes the whole batch, since XLA on CPU runs a loop over links as one kernel
    after another; on one core those kernels run one at a time.

    Args:
        subject: a robot of hinges and slides, and where its simulations start.
        steps: of each simulation.
        peers: whether to run MuJoCo and MJX.
        small: fewer rounds.

    Yields:
        Time per step of one simulation, and the times to compile.
    """
    count = len(subject.q)
    states = tuple(jnp.asarray(x) for x in (subject.q, subject.v, subject.tau))
    candidates = [candidate("ours", jax.jit(jax.vmap(simulated(subject, steps))), *states, items=count * steps)]
    if peers:
        candidates.append(Candidate("mujoco.rollout on 2 threads", mujoco_rollout(subject, steps), count * steps))
        candidates.append(_mjx_candidate(subject, steps, states))
    found = race(candidates, repeats=2 if small else 5, min_time=0.0)
    condition = f"{subject.name}, {count} x {steps} steps, float64, per step"
    rivals: list[Timing | None] = [found[one.name] for one in candidates[1:]]
    for peer in rivals or [None]:
        yield compare("rollout", condition, found["ours"], peer)
    yield compile_row(f"rollout, {subject.name}", found["ours"])
    if peers:
        mjx = "MJX, without fusion emitters"
        yield compare("rollout by MJX", condition, found[mjx], found["mujoco.rollout on 2 threads"])
        yield compile_row(f"rollout by MJX, {subject.name}", found[mjx])


def simulated(subject: Subject, steps: int) -> Callable[..., tuple[jax.Array, jax.Array]]:
    """Return the simulation of one state: `(q, v, tau) -> (T, n)` coordinates and velocities after each step.

    Args:
        subject: a robot of hinges and slides.
        steps: T.
    """
    dt = float(subject.model.opt.timestep)

    def run(q: jax.Array, v: jax.Array, tau: jax.Array) -> tuple[jax.Array, jax.Array]:
        def step(state: Any, _: None) -> Any:
            q, v = state
            v = v + dt * kinematics.forward_dynamics(subject.robot, q, v, tau)
            state = q + dt * v, v
            return state, state

        return jax.lax.scan(step, (q, v), None, length=steps)[1]

    return run


def mujoco_rollout(subject: Subject, steps: int) -> Callable[[], np.ndarray]:
    """Return the same simulations by `mujoco.rollout`: `() -> (batch, T, 1 + nq + nv)`, each row time, q and v.

    Args:
        subject: a robot, and where its simulations start.
        steps: T.
    """
    import mujoco
    from mujoco.rollout import Rollout

    model = subject.model
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    initial = np.zeros((len(subject.q), mujoco.mj_stateSize(model, spec)))
    initial[:, 1 : 1 + model.nq + model.nv] = np.concatenate([subject.q, subject.v], axis=1)
    force = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
    torques = np.ascontiguousarray(np.broadcast_to(subject.tau[:, None], (len(subject.q), steps, model.nv)))
    pool = Rollout(nthread=THREADS)
    data = [mujoco.MjData(model) for _ in range(THREADS)]
    return lambda: pool.rollout(model, data, initial, torques, control_spec=force)[0]


def _mjx_candidate(subject: Subject, steps: int, states: tuple[jax.Array, ...]) -> Candidate:
    from jaxest.kinematics import mjx

    backend = mjx.build(subject.source, constraints=False)

    def run(q: jax.Array, v: jax.Array, tau: jax.Array) -> Any:
        return mjx.rollout(backend, mjx.State(q, v), jnp.tile(tau[None], (steps, 1))).state

    items = len(subject.q) * steps
    return candidate("MJX, without fusion emitters", mjx.jit(jax.vmap(run)), *states, items=items)
