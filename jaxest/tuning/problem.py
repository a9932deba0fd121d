"""What is tuned: a loss of free numbers, and its gradient, forward where that takes less."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.tuning.objectives import Objective, batched, per_recording, total
from jaxest.tuning.parameters import Space
from jaxest.tuning.recordings import Recording, Windows
from jaxest.types import Array

FORWARD = 6


class Problem(NamedTuple):
    """What is tuned; static, hashed by identity. Build it once, it compiles once."""

    objective: Objective
    space: Space
    forward: bool | None = None
    """Whether gradients go forward, which takes no memory and costs a run per free number; if None, where there are at
    most `FORWARD` of them and nothing is drawn."""
    windows: Windows | None = None
    """Mini-batches; None for whole recordings."""


def loss_at(problem: Problem, z: Array, one: Recording, key: Array | None = None) -> Array:
    """Return the loss () of one recording at a point (n,)."""
    return problem.objective.loss(problem.space.unpack(z), one, key)


def goes_forward(problem: Problem) -> bool:
    """Say whether gradients go forward."""
    few = problem.space.size <= FORWARD and not problem.objective.random
    return few if problem.forward is None else problem.forward


def value_and_gradient(problem: Problem, z: Array, batch: Recording, key: Array | None = None) -> tuple[Array, Array]:
    """Return the mean loss () of a batch at a point (n,), and its gradient (n,)."""
    if not goes_forward(problem):

        def one(recording: Recording, key: Array | None) -> tuple[Array, Array]:
            return jax.value_and_grad(partial(loss_at, problem))(z, recording, key)

        values, gradients = per_recording(problem.objective, one, batch, key)
        return jnp.mean(values), jnp.mean(gradients, axis=0)

    def loss(z: Array) -> Array:
        return total(problem.objective, problem.space.unpack(z), batch, key)

    push = jax.vmap(lambda v: jax.jvp(loss, (z,), (v,)), out_axes=(None, 0))
    return push(jnp.eye(z.shape[0], dtype=z.dtype))


@partial(jax.jit, static_argnums=0)
def values_at(problem: Problem, points: Array, batch: Recording, key: Array | None = None) -> Array:
    """Return the mean loss (K,) of a batch at points (K, n), drawn with the same key."""
    return batched(problem.objective)(lambda z: total(problem.objective, problem.space.unpack(z), batch, key))(points)


__all__ = ["FORWARD", "Problem", "goes_forward", "loss_at", "value_and_gradient", "values_at"]
