"""Moves of the variances with theta and path along, and the collapsed sampler that they make.

Variances are moved in the coordinates z = variance^(-1/3), in which the reciprocal of a gamma-like density is nearly
normal (Wilson and Hilferty). A proposal keeps a normal density of z invariant, fitted while the chain warms up
(preconditioned Crank-Nicolson); theta follows from the linear model given the new variances, and the path keeps the
numbers from which the linear model would have drawn it. What is left for the acceptance to correct is small.
"""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.distributions import inverse_gamma
from jaxest.mcmc.model import (
    Data,
    Model,
    Prior,
    Unknown,
    linear_steps,
    log_prior,
    log_weight,
    normals,
    remainder,
)
from jaxest.mcmc.state import (
    POWER,
    Info,
    Kernel,
    Params,
    State,
    Tuning,
    accept,
    chosen,
    coordinates,
    finish,
)
from jaxest.mcmc.twist import Collapsed, Twist, backward, collapse, draw, flow, log_evidence, whiten
from jaxest.types import Array


class Proposal(NamedTuple):
    """A proposed state of the linear model."""

    unknown: Unknown
    twist: Twist
    log_ratio: Array
    """() log acceptance ratio in the linear model with theta integrated out."""


def _log_target(prior: Prior, unknown: Unknown, log_evidence: Array) -> Array:
    """Log density of z up to a constant: prior and evidence, times the derivative of the variances by z, -3 z^-4."""
    return log_prior(prior, unknown) + log_evidence - 4 * jnp.sum(jnp.log(coordinates(unknown.variances)))


def log_density(model: Model, params: Params, data: Data, z: Array) -> Array:
    """Return the linear model's log density of z (d,), theta and path integrated out, up to a constant."""
    prior, linear = params.prior, params.tuning.linear
    variances = z ** (1 / POWER)
    found = collapse(prior, linear, backward(model, prior, data, linear, variances))
    middle = jnp.clip(linear.centre, prior.low, prior.high)
    return _log_target(prior, Unknown(middle, variances), found.log_evidence)


def _log_reference(tuning: Tuning, z: Array) -> Array:
    white = linalg.solve_triangular(tuning.root, z - tuning.centre)
    return -jnp.sum(white * white) / 2


def draw_theta(key: Array, collapsed: Collapsed) -> Array:
    """Draw theta (p,) given the variances, in the linear model without its box."""
    if not len(collapsed.mean):
        return collapsed.mean
    normal = normals(key, *collapsed.mean.shape)
    return collapsed.mean + linalg.solve_triangular(collapsed.root, normal, transposed=True)


def propose(
    model: Model, params: Params, data: Data, unknown: Unknown, twist: Twist, *, key: Array, boxed: bool = True
) -> Proposal:
    """Propose variances and theta, and say how they fare in the linear model.

    Args:
        model: the model.
        params: parameters.
        data: the series.
        unknown: where the chain is.
        twist: of its variances.
        key: random key.
        boxed: whether theta must lie within its box; static.

    Returns:
        The proposal; its ratio is -infinity outside the box.
    """
    prior, tuning = params.prior, params.tuning
    key_z, key_theta = jax.random.split(key)
    z = coordinates(unknown.variances)
    normal = normals(key_z, *z.shape)
    keep = jnp.sqrt(1 - tuning.stride**2)
    moved = tuning.centre + keep * (z - tuning.centre) + tuning.stride * (tuning.root @ normal)
    good = jnp.all(moved > 0)
    moved = jnp.where(good, moved, z)
    variances = moved ** (1 / POWER)
    later = backward(model, prior, data, tuning.linear, variances, twist.here is not None)
    collapsed, before = collapse(prior, tuning.linear, later), collapse(prior, tuning.linear, twist)
    found = Unknown(draw_theta(key_theta, collapsed), variances)
    if not boxed:
        prior = prior._replace(low=jnp.full_like(prior.low, -jnp.inf), high=jnp.full_like(prior.high, jnp.inf))
    ratio = _log_target(prior, found, collapsed.log_evidence) - _log_target(prior, unknown, before.log_evidence)
    ratio = ratio + _log_reference(tuning, z) - _log_reference(tuning, moved)
    return Proposal(found, later, jnp.where(good & jnp.isfinite(ratio), ratio, -jnp.inf))


def move_together(
    model: Model, params: Params, data: Data, state: State, twist: Twist, *, key: Array
) -> tuple[State, Twist, Array]:
    """Move variances, theta and path together, so that the path does not hold the others back.

    Args:
        model: the model.
        params: parameters.
        data: the series.
        state: the chain's.
        twist: of its variances.
        key: random key.

    Returns:
        The state, the twist of its variances, and whether the proposal was accepted.
    """
    key_move, key_accept = jax.random.split(key)
    linear = params.tuning.linear
    proposal = propose(model, params, data, state.unknown, twist, key=key_move)
    normal = whiten(twist, linear, state.unknown.theta, state.path)
    path = draw(flow(proposal.twist, linear, proposal.unknown.theta), linear, normal[None])[0]

    def weigh(unknown: Unknown, path: Array) -> Array:
        error = remainder(model, params.model, linear, unknown.theta, data, path)
        return log_weight(model, data, linear, unknown, path, error)

    both = jax.tree.map(lambda a, b: jnp.stack([a, b]), (proposal.unknown, path), (state.unknown, state.path))
    after, before = jax.vmap(weigh)(*both)
    ratio = proposal.log_ratio + after - before
    yes = accept(key_accept, jnp.where(jnp.isnan(ratio), -jnp.inf, ratio))
    moved = state._replace(path=path, unknown=proposal.unknown)
    return chosen(yes, moved, state), chosen(yes, proposal.twist, twist), yes


def draw_variances(key: Array, model: Model, prior: Prior, data: Data, path: Array, left: Array) -> Array:
    """Draw the variances given a path: each is inverse-gamma.

    Args:
        key: random key.
        model: the model.
        prior: the prior.
        data: the series.
        path: (T, n).
        left: (T - 1, n) the process noise along it.

    Returns:
        (n + m,)

    Source: Zakeri 2023, eqs. 26 to 28, for diagonal covariances.
    """
    away = jnp.where(data.valid, data.value - path[:, jnp.asarray(model.observed)], 0)
    squares = jnp.concatenate([jnp.sum(left * left, axis=0), jnp.sum(away * away, axis=0)])
    process = jnp.full(model.size, left.shape[0], path.dtype)
    counts = jnp.concatenate([process, jnp.sum(data.valid, axis=0).astype(path.dtype)])
    alpha, beta = inverse_gamma.posterior(prior.alpha, prior.beta, squares, counts)
    return inverse_gamma.sample(key, alpha, beta)


def augmented(
    model: Model, params: Params, data: Data, variances: Array, twist: Twist, *, key: Array
) -> tuple[Array, Twist, Array]:
    """Draw theta and a path of the linear model, and variances given these: finds its way from anywhere.

    Leaves the linear model's posterior of the variances as it is (theta without its box), reversibly.

    Args:
        model: the model.
        params: parameters.
        data: the series.
        variances: (n + m,) current ones.
        twist: theirs.
        key: random key.

    Returns:
        New variances, their twist, and the path on the way.
    """
    linear = params.tuning.linear
    keys = jax.random.split(key, 3)
    theta = draw_theta(keys[0], collapse(params.prior, linear, twist))
    normal = normals(keys[1], 1, *linear.path.shape)
    path = draw(flow(twist, linear, theta), linear, normal)[0]
    left = path[1:] - linear_steps(linear, theta, path)
    variances = draw_variances(keys[2], model, params.prior, data, path, left)
    return variances, backward(model, params.prior, data, linear, variances), path


@cache
def collapsed(model: Model) -> Kernel:
    """Make the collapsed sampler of the linear model: theta and path integrated out of every decision, no particles.

    Exact where the model is linear, and as good as its linearisation elsewhere; `particle_mh` corrects it.

    Args:
        model: the model.

    Returns:
        The kernel, the same object for the same model.
    """

    def kernel(params: Params, data: Data, state: State, *, key: Array) -> tuple[State, Info]:
        keys = jax.random.split(jax.random.fold_in(key, state.index), 3)
        linear = params.tuning.linear
        twist = backward(model, params.prior, data, linear, state.unknown.variances)
        variances, twist, path = augmented(model, params, data, state.unknown.variances, twist, key=keys[0])
        theta, outside = _theta_within(keys[1], params, twist)
        unknown, twist, yes = _moved(model, params, data, Unknown(theta, variances), twist, keys[2])
        unknown = chosen(outside, state.unknown, unknown)
        state, info = finish(state, path, unknown, yes, jnp.zeros(len(path)), jnp.zeros(()), model)
        return state, info._replace(log_likelihood=log_evidence(twist, linear, unknown.theta))

    return kernel


def _theta_within(key: Array, params: Params, twist: Twist) -> tuple[Array, Array]:
    """Draw theta given the variances, and say whether it lies outside its box."""
    theta = draw_theta(key, collapse(params.prior, params.tuning.linear, twist))
    return theta, ~jnp.all((theta >= params.prior.low) & (theta <= params.prior.high))


def _moved(
    model: Model, params: Params, data: Data, unknown: Unknown, twist: Twist, key: Array, boxed: bool = True
) -> tuple[Unknown, Twist, Array]:
    key_move, key_accept = jax.random.split(key)
    proposal = propose(model, params, data, unknown, twist, key=key_move, boxed=boxed)
    yes = accept(key_accept, proposal.log_ratio)
    unknown, twist = chosen(yes, (proposal.unknown, proposal.twist), (unknown, twist))
    return unknown, twist, yes.astype(unknown.theta.dtype)


def surrogate(
    model: Model, params: Params, data: Data, unknown: Unknown, twist: Twist, *, key: Array
) -> tuple[Unknown, Twist]:
    """Move as the collapsed sampler does, forth and back, so that the whole is reversible; theta knows no box here.

    Args:
        model: the model.
        params: parameters.
        data: the series.
        unknown: where the chain is.
        twist: of its variances.
        key: random key.

    Returns:
        Theta and variances, and the twist of the latter. Theta may lie outside its box; then the prior refuses it.
    """
    keys = jax.random.split(key, 4)
    first, later, _ = _moved(model, params, data, unknown, twist, keys[0], boxed=False)
    variances, later, _ = augmented(model, params, data, first.variances, later, key=keys[1])
    theta, _ = _theta_within(keys[2], params, later)
    second, later, _ = _moved(model, params, data, Unknown(theta, variances), later, keys[3], boxed=False)
    return second, later


__all__ = [
    "Info",
    "Kernel",
    "Params",
    "Proposal",
    "State",
    "Tuning",
    "accept",
    "augmented",
    "chosen",
    "collapsed",
    "coordinates",
    "draw_theta",
    "draw_variances",
    "finish",
    "log_density",
    "move_together",
    "propose",
    "surrogate",
]
