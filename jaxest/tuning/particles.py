"""Particle filters for tuning: a score that forgets, and a relaxation that may be differentiated from end to end."""

from functools import cache, partial

import jax
import jax.numpy as jnp

from jaxest.filters.kalman.model import clean
from jaxest.filters.particle import Info, LogLikelihood, State, Transition, mean_and_covariance
from jaxest.filters.resampling import Resampled, Resampler, effective_sample_size, normalize
from jaxest.manifolds.base import Manifold
from jaxest.types import NON_FINITE, OK, WEIGHTS_VANISHED, Array, ArrayLike, PyTree, Step


@cache
def fading(resample: Resampler, share: float) -> Resampler:
    """Let the score forget what particles' ancestors did: at each step only a share of the past is carried on.

    By Fisher's identity a step's score is the mean, given all measurements, of the derivative of that step's densities.
    The filter corrects an old step's mean by every later one through the weights' derivatives, whose variance grows
    with the square of the steps as the ancestors become few, while what later measurements say of an old step soon
    fades. The values of the filter are unchanged.

    Args:
        resample: what resamples; static.
        share: from 0 (each step is corrected by its own measurement alone) to 1 (no forgetting, no bias); the lag is
            about 1 / (1 - share) steps; static.

    Returns:
        The resampler, the same object for the same arguments.

    Raises:
        ValueError: the share lies outside [0, 1].

    Source: Nemeth, Fearnhead, Mihaylova 2016 (Particle approximations of the score and observed information matrix for
    parameter estimation in state-space models with linear computational cost), whose shrinkage this is on weights.
    """
    if not 0 <= share <= 1:
        raise ValueError(f"share: got {share}, expected a number from 0 to 1")
    return partial(_fading, resample, float(share))


def _fading(
    resample: Resampler, share: float, key: Array, log_weights: ArrayLike, count: int | None = None
) -> Resampled:
    found = resample(key, log_weights, count)
    still = jax.lax.stop_gradient(found.log_weights)
    finite = jnp.isfinite(still)  # infinity less infinity is no zero
    moving = jnp.where(finite, found.log_weights, 0) - jnp.where(finite, still, 0)
    return found._replace(log_weights=still + share * moving)


@cache
def relaxed(
    manifold: Manifold,
    transition: Transition,
    log_likelihood: LogLikelihood,
    *,
    smoothing: float = 0.25,
    iterations: int = 30,
) -> Step:
    """Return a particle filter that moves particles by optimal transport instead of choosing among them.

    The draws of the transition move with the parameters, and so do the particles: the log-likelihood of one key is a
    smooth function, whose gradient is its own finite difference. Its expectation is not the log-evidence: entropy
    draws particles together. O(N^2).

    Args:
        manifold: where the state lives, dimension d.
        transition: how it moves; `draw` must be differentiable in the parameters, as that of `particle.gaussian` is.
        log_likelihood: `(params, x, measurement) -> ()`.
        smoothing: weight of the entropy, in units of the particles' mean square distance; static.
        iterations: Sinkhorn passes, static.

    Returns:
        The step, with `State` and `Info` of `jaxest.filters.particle`; without a key it raises ValueError.

    Source: Corenflos, Thornton, Deligiannidis, Doucet 2021 (Differentiable particle filtering via entropy-regularized
    optimal transport).
    """
    return partial(_step, manifold, transition, log_likelihood, float(smoothing), iterations)


def _step(
    manifold: Manifold,
    transition: Transition,
    log_likelihood: LogLikelihood,
    smoothing: float,
    iterations: int,
    params: PyTree,
    state: State,
    measurement: PyTree,
    *,
    key: Array | None = None,
) -> tuple[State, Info]:
    if key is None:
        raise ValueError("key: got None, expected the key of the run; a particle filter draws random numbers")
    measurement, broken = clean(measurement)
    before = transported(manifold, state.particles, state.log_weights, smoothing, iterations)
    count = state.log_weights.shape[0]
    noise = transition.draw(params, measurement, jax.random.fold_in(key, state.index), count)

    def moved(x: PyTree, v: Array) -> PyTree:
        return manifold.retract(transition.mean(params, x, measurement), v)

    particles = jax.vmap(moved)(before, noise)
    weights = jax.vmap(lambda x: log_likelihood(params, x, measurement))(particles)
    log_weights, density, vanished = normalize(weights - jnp.log(jnp.asarray(count, weights.dtype)))
    mean, covariance = mean_and_covariance(manifold, particles, log_weights)
    status = jnp.where(vanished, WEIGHTS_VANISHED, jnp.where(broken, NON_FINITE, OK)).astype(jnp.int32)
    info = Info(mean, covariance, density, effective_sample_size(log_weights), None, status)
    return State(particles, log_weights, state.index + 1), info


def transported(manifold: Manifold, particles: PyTree, log_weights: Array, smoothing: float, iterations: int) -> PyTree:
    """Move weighted particles to where equally weighted ones stand for the same density, each as little as may be.

    Args:
        manifold: where they live.
        particles: leaves (N, ...).
        log_weights: (N,), their exponentials sum to one.
        smoothing: as `relaxed`.
        iterations: as `relaxed`.

    Returns:
        Leaves (N, ...), equally weighted, of the same mean in the tangent space to within what the passes leave.
    """
    centre = jax.lax.stop_gradient(mean_and_covariance(manifold, particles, log_weights)[0])
    flat = jax.vmap(manifold.local, (None, 0))(centre, particles)
    gaps = flat[:, None, :] - flat[None, :, :]
    cost = jnp.sum(gaps * gaps, axis=-1)
    cost = cost / (smoothing * jnp.mean(cost) + jnp.finfo(cost.dtype).tiny)
    equal = -jnp.log(jnp.asarray(flat.shape[0], flat.dtype))

    def balance(_: int, g: Array) -> Array:
        f = equal - jax.nn.logsumexp(g[None, :] - cost, axis=1)
        return log_weights - jax.nn.logsumexp(f[:, None] - cost, axis=0)

    g = jax.lax.fori_loop(0, iterations, balance, log_weights)
    f = equal - jax.nn.logsumexp(g[None, :] - cost, axis=1)
    plan = jnp.exp(f[:, None] + g[None, :] - cost - equal)  # rows sum to one
    flat = jnp.sum(plan[:, :, None] * flat[None, :, :], axis=1)
    return jax.vmap(manifold.retract, (None, 0))(centre, flat)


__all__ = ["fading", "relaxed", "transported"]
