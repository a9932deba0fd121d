"""Whether explicit Euler steps are short enough for a robot's motion, before anything is built on them.

Euler's steps put energy into a motion without friction: for some speeds they let it run away where shorter steps do
not. What is compared is the motion that the model itself predicts over some hundred steps, in its own steps and in
eight times shorter ones.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics.robot import Robot
from jaxest.mcmc.model import Data, Linear, Model
from jaxest.systems.torque_model import Inputs, constant
from jaxest.types import Array, InputError

WINDOW = 100  # steps predicted without looking at the data again; the paper's whole series
FINER, FASTER = 8, 10.0  # steps so many times shorter are taken for true; speeds so many times theirs are a blow-up


def check_step(robot: Robot, x: Array, dt: float, seconds: float, given: Array | None = None) -> None:
    """Refuse a step for which explicit Euler blows up.

    Args:
        robot: the robot.
        x: (3 n,) start and torques.
        dt: s, the step.
        seconds: length of the series.
        given: (n,) known torque, constant or (T, n), a row for each step.

    Raises:
        InputError: the motion without noise leaves all bounds; names the largest step that does not.
    """
    n, steps = robot.nv, max(round(seconds / dt), 1)
    known = jnp.broadcast_to(jnp.zeros(n) if given is None else jnp.asarray(given), (steps, n))[None]
    inputs = Inputs(jnp.full((1, steps), dt), known, jnp.zeros((1, steps), jnp.int32))
    _check(constant(n), robot, x[2 * n :], x[None, : 2 * n], inputs, jnp.zeros((1, steps, 0)))


def check_series(model: Model, robot: Robot, data: Data, linear: Linear) -> None:
    """Refuse a series whose steps are too long, from what the smoother makes of it.

    Args:
        model: of `torque_model`.
        robot: the robot.
        data: the series.
        linear: along the most probable path; its states are where predictions start, at most 100 steps long.

    Raises:
        InputError: the prediction from one of them leaves all bounds; names the largest step for which none does.
    """
    path, n = np.asarray(linear.path), 2 * len(model.observed)
    steps = len(path) - 1
    size = min(WINDOW, steps)
    first = np.unique(np.minimum(np.arange(0, steps, size), steps - size))
    rows = first[:, None] + np.arange(size)
    inputs = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[rows]), data.inputs)
    _check(model, robot, linear.centre, jnp.asarray(path[first]), inputs, jnp.asarray(path[rows][:, :, n:]))


def _check(model: Model, robot: Robot, theta: Array, starts: Array, inputs: Inputs, torques: Array) -> None:
    size = inputs.dt.shape[1]
    run = partial(_fastest, model, robot, theta, starts, inputs, torques)
    fine = np.asarray(run(FINER * size))
    limit = FASTER * np.maximum(np.where(np.isfinite(fine), fine, np.inf), 1.0)

    def safe(count: int) -> bool:
        return bool(np.all(np.asarray(run(count)) <= limit))

    if safe(size):
        return
    dt = float(np.max(np.asarray(inputs.dt)))
    counts = (int(np.ceil(size * 1.1**k)) for k in range(1, 60))
    largest = next((dt * size / count for count in counts if safe(count)), 0.0)
    raise InputError(
        f"step h = {dt:g} s: explicit Euler blows up within {float(np.asarray(inputs.dt).sum(axis=1).max()):g} s on "
        f"this robot of {robot.nv} joints; the largest safe step is about {largest:.2g} s"
    )


@partial(jax.jit, static_argnums=0)
def _fastest(
    model: Model, robot: Robot, theta: Array, starts: Array, inputs: Inputs, torques: Array, count: int
) -> Array:
    """Largest speeds (W,) of motions without noise in so many even parts of each series; infinite where not finite."""
    n = len(model.observed)
    size = inputs.dt.shape[1]

    def window(x: Array, inputs: Inputs, torques: Array) -> Array:
        def advance(i: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
            x, fastest = now
            row = i * size // count
            given = jax.tree.map(lambda leaf: leaf[row], inputs)
            x = jnp.concatenate([x[: 2 * n], torques[row]])
            x = model.transition(robot, theta, x, given._replace(dt=given.dt * size / count))
            return x, jnp.maximum(fastest, jnp.max(jnp.abs(x[n : 2 * n])))

        x, fastest = jax.lax.fori_loop(0, count, advance, (x, jnp.zeros(())))
        return jnp.where(jnp.all(jnp.isfinite(x)) & jnp.isfinite(fastest), fastest, jnp.inf)

    return jax.vmap(window)(starts, inputs, torques)


__all__ = ["check_series", "check_step"]
