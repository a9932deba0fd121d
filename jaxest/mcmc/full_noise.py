"""Particle Gibbs where noises of a time go together: whole covariance matrices, inverse-Wishart given a path.

For small series: a matrix of p noises has p (p + 1) / 2 entries. Theta and path are moved together as in
`kernel.move_together`, the matrices by their conditional only, so that one of which the data say little mixes slowly.
"""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.distributions import inverse_wishart
from jaxest.mcmc import conditional_smc
from jaxest.mcmc.kernel import draw_theta
from jaxest.mcmc.model import Covariances, Data, Linear, Model, Prior, Unknown, log_weight, next_states, remainder
from jaxest.mcmc.particle_gibbs import theta_given_path
from jaxest.mcmc.state import Info, Kernel, Params, State, accept, chosen, finish
from jaxest.mcmc.twist import Twist, collapse, draw, flow, sweep, whiten
from jaxest.types import Array

Blocks = tuple[tuple[int, ...], ...]


def start(model: Model, state: State) -> State:
    """Return a chain with the variances of another one on the diagonals; leaves may have leading axes."""
    n, whole = model.size, jnp.vectorize(jnp.diag, signature="(k)->(k,k)")(state.unknown.variances)
    return state._replace(unknown=_unknown(state.unknown.theta, whole[..., :n, :n], whole[..., n:, n:]))


def _unknown(theta: Array, process: Array, sensor: Array) -> Unknown:
    noise: Any = Covariances(process, sensor)
    return Unknown(theta, noise)


def prior_of(prior: Prior, at: Any) -> tuple[Array, Array]:
    """Return the inverse-Wishart prior of the noises `at`: each variance then has the inverse-gamma one of `prior`.

    Args:
        prior: its shapes must be the same for all of them; the first one's is taken.
        at: p indices into the variances, process noise first; static.

    Returns:
        () degrees of freedom 2 alpha + p - 1 and (p, p) scale, 2 beta on its diagonal.
    """
    at = np.asarray(at)
    return 2 * prior.alpha[at[0]] + len(at) - 1, jnp.diag(2 * prior.beta[at])


def backward(model: Model, prior: Prior, data: Data, linear: Linear, noise: Covariances) -> Twist:
    """Run the backward information filter as `twist.backward` does; a row that misses any joint is left out."""
    steps, n = linear.path.shape
    at = np.asarray(model.observed)
    there = jnp.all(data.valid, axis=1)
    inverse, sensor_log_det = linalg.solve_and_log_det(noise.sensor, jnp.eye(len(at), dtype=noise.sensor.dtype))
    process, process_log_det = linalg.solve_and_log_det(noise.process, jnp.eye(n, dtype=noise.process.dtype))
    rows = jnp.zeros((steps, len(at), n + 1 + model.linear), linear.path.dtype)
    rows = rows.at[:, np.arange(len(at)), at].set(1).at[:, :, n].set(linear.path[:, at] - data.value)
    measured = jnp.einsum("tma,ml,tlb->tab", rows, inverse, rows) * there[:, None, None]
    size = len(at) * jnp.log(2 * jnp.pi) + sensor_log_det
    first = jnp.diag(1 / prior.variance)[None]
    precision = jnp.concatenate([first, jnp.broadcast_to(process, (steps - 1, n, n))])
    log_det = jnp.full(steps, -process_log_det).at[0].set(-jnp.sum(jnp.log(prior.variance)))
    return sweep(linear, measured, jnp.where(there, -size / 2, 0), precision, log_det)


@cache
def gibbs(model: Model, blocks: Blocks, *, count: int = 16) -> Kernel:
    """Make the particle Gibbs sampler.

    Args:
        model: the model.
        blocks: which entries of the process noise go together, such as those of angles and those of velocities; each
            entry in one of them. The sensors are one block.
        count: N, particles; static.

    Returns:
        The kernel; `Unknown.variances` is a `Covariances` in its states, `start` makes them.

    Source: Zakeri 2023, eqs. 26 to 31, with whole matrices.
    """

    def kernel(params: Params, data: Data, state: State, *, key: Array) -> tuple[State, Info]:
        keys = jax.random.split(jax.random.fold_in(key, state.index), 4)
        before, noise = state.path, _noise(state.unknown)
        twist = backward(model, params.prior, data, params.tuning.linear, noise)
        state, yes = _move_theta(model, params, data, state, twist, keys[0])
        found = conditional_smc.at_once(
            model, params.model, data, params.tuning.linear, twist, state.unknown, key=keys[1], count=count,
            path=state.path,
        )  # fmt: skip
        weight = linalg.inverse(noise.process)
        theta = theta_given_path(model, params, data, found.path, state.unknown.theta, weight, key=keys[2])
        unknown = _draw(keys[3], model, params, data, found.path, theta, blocks)
        state, info = finish(state, found.path, unknown, yes, found.ess, found.log_evidence, model)
        return state, info._replace(updated=jnp.any(found.path != before, axis=1))

    return kernel


def _noise(unknown: Unknown) -> Covariances:
    noise: Any = unknown.variances
    return Covariances(*noise)


def _move_theta(
    model: Model, params: Params, data: Data, state: State, twist: Twist, key: Array
) -> tuple[State, Array]:
    """Move theta and the path with it: drawn from the linear model given the noise, corrected for the rest."""
    linear, prior = params.tuning.linear, params.prior
    key_theta, key_accept = jax.random.split(key)
    theta = draw_theta(key_theta, collapse(prior, linear, twist))
    normal = whiten(twist, linear, state.unknown.theta, state.path)
    path = draw(flow(twist, linear, theta), linear, normal[None])[0]

    def weigh(theta: Array, path: Array) -> Array:
        error = remainder(model, params.model, linear, theta, data, path)
        return log_weight(model, data, linear, state.unknown._replace(theta=theta), path, error)

    after, now = jax.vmap(weigh)(jnp.stack([theta, state.unknown.theta]), jnp.stack([path, state.path]))
    inside = jnp.all((theta >= prior.low) & (theta <= prior.high))
    ratio = after - now
    yes = accept(key_accept, jnp.where(inside & ~jnp.isnan(ratio), ratio, -jnp.inf))
    moved = state._replace(path=path, unknown=state.unknown._replace(theta=theta))
    return chosen(yes, moved, state), yes.astype(path.dtype)


def _draw(key: Array, model: Model, params: Params, data: Data, path: Array, theta: Array, blocks: Blocks) -> Unknown:
    """Draw the matrices given path and theta."""
    n, m = model.size, len(model.observed)
    left = path[1:] - next_states(model, params.model, theta, data, path)
    there = jnp.all(data.valid, axis=1)
    away = jnp.where(there[:, None], data.value - path[:, np.asarray(model.observed)], 0)
    keys = jax.random.split(key, len(blocks) + 1)

    def matrix(key: Array, at: Any, residuals: Array, count: Any) -> Array:
        found = inverse_wishart.posterior(*prior_of(params.prior, at), residuals.T @ residuals, count)
        return inverse_wishart.sample(key, *found)

    process = jnp.zeros((n, n), path.dtype)
    for key, block in zip(keys, blocks, strict=False):
        at = np.asarray(block)
        process = process.at[np.ix_(at, at)].set(matrix(key, at, left[:, at], len(left)))
    sensor = matrix(keys[-1], np.arange(n, n + m), away, jnp.sum(there).astype(path.dtype))
    return _unknown(theta, process, sensor)


__all__ = ["Blocks", "backward", "gibbs", "prior_of", "start"]
