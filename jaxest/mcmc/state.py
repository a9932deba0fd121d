"""What every sampler shares: its parameters, a chain's state, what an iteration says, and how a chain goes on."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.mcmc.model import Linear, Model, Prior, Unknown
from jaxest.types import Array, PyTree

POWER = -1 / 3


class Tuning(NamedTuple):
    """What a warm-up finds and the chain then keeps."""

    linear: Linear
    """Along a path that is not the chain's own."""
    centre: Array
    """(d,) mean of z."""
    root: Array
    """(d, d) lower triangular root of the covariance of z."""
    stride: Array
    """() share of z that is drawn anew at each proposal, in (0, 1]."""
    theta_root: Array
    """(p, p) a root of the covariance of theta; only the baseline's random walk needs it."""


class Params(NamedTuple):
    """Parameters of a kernel."""

    model: PyTree
    """Of the model's transition."""
    prior: Prior
    tuning: Tuning


class State(NamedTuple):
    """A chain."""

    path: Array
    """(T, n)"""
    unknown: Unknown
    log_likelihood: Array
    """() what a particle method estimated for this state; 0 where the kernel keeps none."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, iterations done."""


class Info(NamedTuple):
    """One iteration."""

    unknown: Unknown
    accepted: Array
    """() share of the proposals of variances and theta that were accepted."""
    updated: Array
    """(T,) bool, whether each time's state is another than before."""
    ess: Array
    """(T,) effective sample size."""
    log_likelihood: Array
    """() estimate of log p(y | theta, variances)."""
    probe: Array
    """(T,) a number a time by which its mixing is judged: the sum of the measured entries of the state."""


Kernel = Callable[..., tuple[State, Info]]
"""`(params, data, state, *, key) -> (state, info)`."""


def coordinates(variances: Array) -> Array:
    """Return z (d,)."""
    return variances**POWER


def chosen(accept: Array, new: PyTree, old: PyTree) -> PyTree:
    """Return one of two pytrees by a bool ()."""
    return jax.tree.map(lambda a, b: jnp.where(accept, a, b), new, old)


def accept(key: Array, log_ratio: Array) -> Array:
    """Return whether a proposal is accepted, () bool."""
    return jnp.log(jax.random.uniform(key, (), log_ratio.dtype)) < log_ratio


def finish(
    state: State, path: Array, unknown: Unknown, share: Array, ess: Array, log_likelihood: Array, model: Model
) -> tuple[State, Info]:
    """Return the next state of a chain and the info of this iteration."""
    updated = jnp.any(path != state.path, axis=1)
    probe = jnp.sum(path[:, jnp.asarray(model.observed)], axis=1)
    after = State(path, unknown, log_likelihood, state.index + 1)
    return after, Info(unknown, share, updated, ess, log_likelihood, probe)


__all__ = ["POWER", "Info", "Kernel", "Params", "State", "Tuning", "accept", "chosen", "coordinates", "finish"]
