"""Particle Gibbs: a path given theta and variances by conditional SMC, theta and variances given the path in turn.

Given the path, theta is normal within its box and each variance is inverse-gamma. Theta mixes slowly that way, and so
does a variance that the data say little of; `kernel.move_together` therefore moves them once more, the path with them.

Source: Andrieu, Doucet and Holenstein 2010, section 2.4.3; Zakeri 2023, eqs. 25 to 31 with their errata; interweaving,
Yu and Meng 2011.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.distributions import gaussian, truncated_normal
from jaxest.mcmc import conditional_smc
from jaxest.mcmc.kernel import Info, Kernel, Params, State, draw_variances, finish, move_together
from jaxest.mcmc.model import Data, Linear, Model, Prior, Unknown
from jaxest.mcmc.twist import Twist, backward, next_only, nothing
from jaxest.types import Array, PyTree

Look = Callable[[Model, Prior, Data, Linear, Array], Twist]
"""`twist.backward`, `next_only` or `nothing`."""


def _steps(model: Model, params: PyTree, data: Data, path: Array, theta: Array) -> tuple[Array, Array]:
    """Return next states (T - 1, n) along a path and their derivative by theta (T - 1, n, p)."""

    def step(x: Array, given: PyTree) -> tuple[Array, Array]:
        def move(theta: Array) -> tuple[Array, Array]:
            ahead = model.transition(params, theta, x, given)
            return ahead, ahead

        slope, ahead = jax.jacfwd(move, has_aux=True)(theta)
        return ahead, slope

    return jax.vmap(step)(path[:-1], data.inputs)


def draw_unknown(model: Model, params: Params, data: Data, path: Array, unknown: Unknown, *, key: Array) -> Unknown:
    """Draw theta given path and variances, then the variances given path and theta.

    Args:
        model: the model.
        params: parameters.
        data: the series.
        path: (T, n).
        unknown: the current values.
        key: random key.

    Returns:
        New values.

    Source: Zakeri 2023, eqs. 25 to 31; eq. 25 with the S2^-1 that it omits.
    """
    key_theta, key_variances = jax.random.split(key)
    weight = jnp.diag(1 / unknown.variances[: model.size])
    ahead, slope = _steps(model, params.model, data, path, unknown.theta)
    left, theta = path[1:] - ahead, unknown.theta
    if model.linear:
        theta = _theta(key_theta, params.prior, theta, slope, left, weight)
        left = left - jnp.einsum("tip,p->ti", slope, theta - unknown.theta)
    return Unknown(theta, draw_variances(key_variances, model, params.prior, data, path, left))


def theta_given_path(
    model: Model, params: Params, data: Data, path: Array, theta: Array, weight: Array, *, key: Array
) -> Array:
    """Draw theta given path and process noise: normal within its box.

    Args:
        model: the model.
        params: parameters.
        data: the series.
        path: (T, n).
        theta: (p,) the current one.
        weight: (n, n) precision of the process noise.
        key: random key.

    Returns:
        (p,)

    Source: Zakeri 2023, eq. 25, with the S2^-1 that it omits.
    """
    if not model.linear:
        return theta
    ahead, slope = _steps(model, params.model, data, path, theta)
    return _theta(key, params.prior, theta, slope, path[1:] - ahead, weight)


def _theta(key: Array, prior: Prior, theta: Array, slope: Array, left: Array, weight: Array) -> Array:
    weighed = jnp.einsum("tip,ij->tjp", slope, weight)
    precision = jnp.einsum("tip,tiq->pq", weighed, slope)
    return _within(key, prior, theta, precision, jnp.einsum("tip,ti->p", weighed, left))


def _within(key: Array, prior: Prior, theta: Array, precision: Array, right: Array) -> Array:
    """One sweep through the components of a normal theta within the box; `right` is the slope at the current theta."""
    mean = theta + linalg.solve(precision, right)

    def component(theta: Array, now: tuple[Array, Array]) -> tuple[Array, None]:
        i, key = now
        location, scale = gaussian.component_given_rest(theta, mean, precision, i)
        value = truncated_normal.sample(key, location, scale, prior.low[i], prior.high[i])
        return theta.at[i].set(value), None

    return jax.lax.scan(component, theta, (jnp.arange(len(theta)), jax.random.split(key, len(theta))))[0]


def guided(model: Model, *, count: int = 16, together: bool = True, at_once: bool = True,
           threshold: float = 0.5, ancestors: bool = False) -> Kernel:  # fmt: skip
    """Make the particle Gibbs sampler whose particles know the data to come.

    Args:
        model: the model.
        count: N, particles; static.
        together: whether variances, theta and path are also moved together; static.
        at_once: whether whole paths are drawn from the linear model (`conditional_smc.at_once`), or state by state
            with the model's own steps and resampling; static.
        threshold: of the effective sample size, where there is resampling; static.
        ancestors: whether the kept path's past is drawn anew there; static.

    Returns:
        The kernel.
    """

    def kernel(params: Params, data: Data, state: State, *, key: Array) -> tuple[State, Info]:
        keys = jax.random.split(jax.random.fold_in(key, state.index), 3)
        linear = params.tuning.linear
        before, share = state.path, jnp.zeros((), state.path.dtype)
        twist = backward(model, params.prior, data, linear, state.unknown.variances, not at_once)
        if together:
            state, twist, yes = move_together(model, params, data, state, twist, key=keys[0])
            share = yes.astype(share.dtype)
        options: dict[str, Any] = {"key": keys[1], "count": count, "path": state.path}
        if at_once:
            found = conditional_smc.at_once(model, params.model, data, linear, twist, state.unknown, **options)
        else:
            options |= {"threshold": threshold, "ancestors": ancestors}
            found = conditional_smc.run(model, params.model, data, linear, twist, state.unknown, **options)
        unknown = draw_unknown(model, params, data, found.path, state.unknown, key=keys[2])
        state, info = finish(state, found.path, unknown, share, found.ess, found.log_evidence, model)
        return state, info._replace(updated=jnp.any(found.path != before, axis=1))

    return kernel


def baseline(model: Model, look: Look, *, count: int = 1000, threshold: float = 1.0, ancestors: bool = False) -> Kernel:
    """Make the paper's particle Gibbs sampler, or a sampler between it and the guided one.

    Args:
        model: the model.
        look: `twist.nothing` for bootstrap particles, as in the paper, `twist.next_only` for fully adapted ones.
        count: N, particles; static.
        threshold: share of N under which particles are resampled; 1 resamples at each step, as the paper does.
        ancestors: whether the kept path's past is drawn anew; static.

    Returns:
        The kernel.

    Source: Zakeri 2023, section 4.
    """

    def kernel(params: Params, data: Data, state: State, *, key: Array) -> tuple[State, Info]:
        key_path, key_unknown = jax.random.split(jax.random.fold_in(key, state.index))
        linear = params.tuning.linear
        twist = look(model, params.prior, data, linear, state.unknown.variances)
        found = conditional_smc.run(
            model, params.model, data, linear, twist, state.unknown, key=key_path, count=count, path=state.path,
            threshold=threshold, ancestors=ancestors,
        )  # fmt: skip
        unknown = draw_unknown(model, params, data, found.path, state.unknown, key=key_unknown)
        share = jnp.ones((), state.path.dtype)
        return finish(state, found.path, unknown, share, found.ess, found.log_evidence, model)

    return kernel


__all__ = ["Look", "baseline", "draw_unknown", "guided", "next_only", "nothing", "theta_given_path"]
