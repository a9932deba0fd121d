"""The models that the samplers work on: additive Gaussian noise, and unknowns that enter linearly.

x[t] = f(x[t-1], theta) + u[t], y[t] = H x[t] + w[t], both noises independent with unknown variances. x[0] has a known
prior and y[0] already belongs to it. f may be anything in x and is linear in theta.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.distributions._words import words
from jaxest.types import Array, PyTree


class Model(NamedTuple):
    """What is static: functions and sizes. Build it once, it is hashed by identity."""

    transition: Callable[[PyTree, Array, Array, PyTree], Array]
    """`(params, theta (p,), x (n,), input) -> (n,)`, the next state without noise; linear in theta."""
    observed: tuple[int, ...]
    """Which entries of the state are measured, m of them."""
    size: int
    """n, of the state."""
    linear: int
    """p, of theta; 0 where nothing but variances is unknown."""


class Prior(NamedTuple):
    """Priors of all that is unknown."""

    low: Array
    """(p,) theta is uniform between `low` ..."""
    high: Array
    """(p,) ... and `high`."""
    alpha: Array
    """(n + m,) shape of each variance's inverse-gamma prior, process noise first."""
    beta: Array
    """(n + m,) scale, in the unit of the variance."""
    mean: Array
    """(n,) of the first state."""
    variance: Array
    """(n,) of the first state."""


class Data(NamedTuple):
    """A series."""

    value: Array
    """(T, m) measurements; any finite number where not valid."""
    valid: Array
    """(T, m) bool."""
    inputs: PyTree
    """Leaves (T - 1, ...), what `transition` is told of each step."""


class Linear(NamedTuple):
    """The model along a path: x[t] - path[t] = jacobian (x[t-1] - path[t-1]) + offset + design (theta - centre) + u.

    Row 0 is the prior of the first state: no jacobian, offset its mean.
    """

    path: Array
    """(T, n)"""
    centre: Array
    """(p,)"""
    jacobian: Array
    """(T, n, n)"""
    offset: Array
    """(T, n)"""
    design: Array
    """(T, n, p)"""


class Unknown(NamedTuple):
    """What the samplers draw, beside the path."""

    theta: Array
    """(p,)"""
    variances: Array
    """(n + m,) process noise first."""


class Covariances(NamedTuple):
    """In place of `Unknown.variances` where noises of a time go together (`full_noise`)."""

    process: Array
    """(n, n)"""
    sensor: Array
    """(m, m)"""


def linearize(model: Model, params: PyTree, prior: Prior, data: Data, path: Array, theta: Array) -> Linear:
    """Linearise a model along a path, all times at once.

    Args:
        model: the model.
        params: its parameters.
        prior: for the mean of the first state.
        data: for the inputs.
        path: (T, n) states.
        theta: (p,) where to linearise.

    Returns:
        The linear model.
    """

    def step(x: Array, given: PyTree) -> tuple[Array, Array, Array]:
        def move(both: Array) -> tuple[Array, Array]:
            ahead = model.transition(params, both[model.size :], both[: model.size], given)
            return ahead, ahead

        slope, ahead = jax.jacfwd(move, has_aux=True)(jnp.concatenate([x, theta]))
        return slope[:, : model.size], slope[:, model.size :], ahead

    jacobian, design, ahead = jax.vmap(step)(path[:-1], data.inputs)
    first = jnp.zeros((1, model.size), path.dtype)
    return Linear(
        path,
        theta,
        jnp.concatenate([jnp.zeros((1, model.size, model.size), path.dtype), jacobian]),
        jnp.concatenate([first + (prior.mean - path[0])[None], ahead - path[1:]]),
        jnp.concatenate([jnp.zeros((1, model.size, model.linear), path.dtype), design]),
    )


def log_prior(prior: Prior, unknown: Unknown) -> Array:
    """Return the log density of the prior (), up to a constant; -infinity outside the box."""
    inside = jnp.all((unknown.theta >= prior.low) & (unknown.theta <= prior.high))
    s = unknown.variances
    value = -jnp.sum((prior.alpha + 1) * jnp.log(s) + prior.beta / s)
    return jnp.where(inside, value, -jnp.inf)


def next_states(model: Model, params: PyTree, theta: Array, data: Data, path: Array) -> Array:
    """Return the model's next states (T - 1, n) without noise along a path (T, n)."""

    def step(x: Array, given: PyTree) -> Array:
        return model.transition(params, theta, x, given)

    return jax.vmap(step)(path[:-1], data.inputs)


def remainder(model: Model, params: PyTree, linear: Linear, theta: Array, data: Data, path: Array) -> Array:
    """Return by how much the model's steps differ from the linear model's, (T - 1, n), along a path (T, n)."""
    return next_states(model, params, theta, data, path) - linear_steps(linear, theta, path)


def linear_steps(linear: Linear, theta: Array, path: Array) -> Array:
    """Return the linear model's next states (T - 1, n) along a path (T, n)."""
    away = jnp.einsum("tij,tj->ti", linear.jacobian[1:], path[:-1] - linear.path[:-1])
    moved = jnp.einsum("tip,p->ti", linear.design[1:], theta - linear.centre)
    return linear.path[1:] + linear.offset[1:] + away + moved


def log_weight(model: Model, data: Data, linear: Linear, unknown: Unknown, path: Array, error: Array) -> Array:
    """Return the log density of a path and the data over that of the linear model.

    Args:
        model: the model.
        data: the series.
        linear: the linear model.
        unknown: theta and variances.
        path: (T, n).
        error: (T - 1, n) as `remainder` gives it.

    Returns:
        ().
    """
    ahead = path[1:] - linear_steps(linear, unknown.theta, path)
    noise: Array | Covariances = unknown.variances
    if isinstance(noise, Covariances):
        return jnp.sum((ahead - error / 2) * linalg.solve(noise.process, error.T).T)
    return jnp.sum((ahead - error / 2) * error / noise[None, : model.size])


def normals(key: Array, *shape: int) -> Array:
    """Draw standard normal numbers as float64, of float32's resolution and no larger than 5.3, which no chain can tell.

    A particle filter draws a million at a time; float64's own take four times as long.
    """
    size = math.prod(shape)
    bits = words(key, (2, (size + 1) // 2))
    # A loop of two keeps XLA from fusing it with what follows, whose short rows would hinder vector instructions.
    drawn = jax.lax.map(_normal, bits).reshape(-1)[:size]
    return drawn.astype(jnp.float64).reshape(shape)


def _normal(bits: Array) -> Array:
    """The middles of 2^23 equal parts of (-1, 1), to normal numbers."""
    middle = ((bits >> 9).astype(jnp.float32) + 0.5) * 2.0**-22 - 1
    return math.sqrt(2) * jax.lax.erf_inv(middle)


__all__ = [
    "Covariances",
    "Data",
    "Linear",
    "Model",
    "Prior",
    "Unknown",
    "linear_steps",
    "linearize",
    "log_prior",
    "log_weight",
    "next_states",
    "normals",
    "remainder",
]
