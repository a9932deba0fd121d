"""Particle Metropolis-Hastings: theta and variances by a particle filter's estimate of their likelihood.

A proposal is where three moves of the collapsed sampler of the linear model have led (`kernel.surrogate`); the particle
filter then only corrects for what the linear model gets wrong, so that it runs once for several moves.

Source: Andrieu, Doucet and Holenstein 2010, section 2.4.2; delayed acceptance, Christen and Fox 2005; Zakeri 2023,
section 5.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxest.mcmc import conditional_smc
from jaxest.mcmc.kernel import Info, Kernel, Params, State, accept, chosen, finish, surrogate
from jaxest.mcmc.model import Data, Model, Unknown, log_prior, normals
from jaxest.mcmc.particle_gibbs import Look
from jaxest.mcmc.twist import backward, log_evidence
from jaxest.types import Array


def guided(model: Model, *, count: int = 16, at_once: bool = True, threshold: float = 0.5) -> Kernel:
    """Make the sampler with guided particles and delayed acceptance.

    Args:
        model: the model.
        count: N, particles; static.
        at_once: as in `particle_gibbs.guided`; static.
        threshold: of the effective sample size, where there is resampling; static.

    Returns:
        The kernel. `accepted` is the share that the particle filter accepted. A chain starts with a
        `log_likelihood` of -infinity, so that its first proposal is taken.
    """

    def kernel(params: Params, data: Data, state: State, *, key: Array) -> tuple[State, Info]:
        keys = jax.random.split(jax.random.fold_in(key, state.index), 3)
        linear = params.tuning.linear
        twist = backward(model, params.prior, data, linear, state.unknown.variances)
        unknown, later = surrogate(model, params, data, state.unknown, twist, key=keys[0])
        options: dict[str, Any] = {"key": keys[1], "count": count}
        if at_once:
            found = conditional_smc.at_once(
                model, params.model, data, linear, later, unknown, corrected=True, **options
            )
        else:
            options["threshold"] = threshold
            later = backward(model, params.prior, data, linear, unknown.variances, True)
            found = conditional_smc.run(model, params.model, data, linear, later, unknown, **options)
        inside = jnp.isfinite(log_prior(params.prior, unknown))
        found = found._replace(log_evidence=jnp.where(inside, found.log_evidence, -jnp.inf))
        ratio = found.log_evidence - log_evidence(later, linear, unknown.theta)
        ratio = ratio - state.log_likelihood + log_evidence(twist, linear, state.unknown.theta)
        return _decided(model, state, found, unknown, ratio, keys[2])

    return kernel


def baseline(model: Model, look: Look, *, count: int = 1000, threshold: float = 1.0) -> Kernel:
    """Make the paper's sampler: a random walk on theta and the log variances, and a plain particle filter.

    Args:
        model: the model.
        look: `twist.nothing` for bootstrap particles, as in the paper.
        count: N, particles; static.
        threshold: as in `particle_gibbs.baseline`.

    Returns:
        The kernel. The walk's covariance is that of the tuning for the variances, and the linear model's for theta,
        both times 2.38^2 / (p + d), which is kinder than the paper's.

    Source: Zakeri 2023, section 5.
    """

    def kernel(params: Params, data: Data, state: State, *, key: Array) -> tuple[State, Info]:
        keys = jax.random.split(jax.random.fold_in(key, state.index), 3)
        tuning, prior = params.tuning, params.prior
        unknown, ratio = _walk(params, state.unknown, keys[0], model.linear)
        twist = look(model, prior, data, tuning.linear, unknown.variances)
        found = conditional_smc.run(model, params.model, data, tuning.linear, twist, unknown, key=keys[1], count=count,
                                    threshold=threshold)  # fmt: skip
        ratio = ratio + found.log_evidence - state.log_likelihood
        return _decided(model, state, found, unknown, ratio, keys[2])

    return kernel


@partial(jax.jit, static_argnums=0, static_argnames=("count", "repeats"))
def log_likelihoods(
    model: Model, params: Params, data: Data, unknowns: Unknown, *, key: Array, count: int = 16, repeats: int = 32
) -> Array:
    """Estimate log p(y | theta, variances) again and again, as `guided` does: how far its estimates scatter.

    Args:
        model: the model.
        params: parameters.
        data: the series.
        unknowns: where, leaves (U, ...).
        key: random key.
        count: N, particles; static.
        repeats: estimates at each place; static.

    Returns:
        (U, repeats)
    """

    def estimate(unknown: Unknown, key: Array) -> Array:
        linear = params.tuning.linear
        twist = backward(model, params.prior, data, linear, unknown.variances)
        found = conditional_smc.at_once(
            model, params.model, data, linear, twist, unknown, key=key, count=count, corrected=True
        )
        return found.log_evidence

    def place(now: tuple[Unknown, Array]) -> Array:
        return jax.lax.map(partial(estimate, now[0]), jax.random.split(now[1], repeats))

    return jax.lax.map(place, (unknowns, jax.random.split(key, unknowns.variances.shape[0])))


def _walk(params: Params, unknown: Unknown, key: Array, p: int) -> tuple[Unknown, Array]:
    """A step on theta and log variances, and the log ratio of the prior densities of these coordinates."""
    tuning, prior = params.tuning, params.prior
    size = len(unknown.variances)
    scale = 2.38 / jnp.sqrt(jnp.asarray(p + size, unknown.theta.dtype))
    normal = normals(key, p + size)
    theta = unknown.theta + scale * (tuning.theta_root @ normal[:p])
    # d log s = -3 dz / z
    logs = jnp.log(unknown.variances) - 3 * scale * (tuning.root @ normal[p:]) / tuning.centre
    moved = Unknown(theta, jnp.exp(logs))
    ratio = log_prior(prior, moved) - log_prior(prior, unknown)
    return moved, ratio + jnp.sum(logs) - jnp.sum(jnp.log(unknown.variances))


def _decided(
    model: Model, state: State, found: conditional_smc.Particles, unknown: Unknown, ratio: Array, key: Array
) -> tuple[State, Info]:
    fresh = state.log_likelihood == -jnp.inf
    ratio = jnp.where(fresh & jnp.isfinite(found.log_evidence), 0, jnp.where(jnp.isnan(ratio), -jnp.inf, ratio))
    yes = accept(key, ratio)
    new = (found.path, unknown, found.log_evidence)
    path, unknown, log_likelihood = chosen(yes, new, (state.path, state.unknown, state.log_likelihood))
    return finish(state, path, unknown, yes.astype(path.dtype), found.ess, log_likelihood, model)


__all__ = ["baseline", "guided", "log_likelihoods"]
