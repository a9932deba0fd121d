"""The particle filter's step: resample, propose, weigh."""

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters.kalman.model import clean
from jaxest.filters.particle.guided import Guided, picked, take
from jaxest.filters.particle.proposal import Proposal
from jaxest.filters.particle.summary import weighted
from jaxest.filters.resampling import Resampled, Resampler, normalize, systematic
from jaxest.manifolds.base import Manifold
from jaxest.types import NON_FINITE, OK, WEIGHTS_VANISHED, Array, ArrayLike, PyTree, Step


class Model(NamedTuple):
    """A particle filter: all static, numbers come in as `params`. Build it once, it is hashed by its functions."""

    manifold: Manifold
    """Where the state lives, dimension d."""
    propose: Proposal
    """`bootstrap(...)`, `guided(...)`, or one's own."""
    resample: Resampler = systematic
    """At every step; `adaptive(systematic, 0.5)` where the effective sample size has fallen below half."""
    ancestors: bool = False
    """Whether infos carry the ancestors, N numbers a step."""


class State(NamedTuple):
    """What the next step needs."""

    particles: PyTree
    """Leaves (N, ...), elements of the manifold."""
    log_weights: Array
    """(N,), their exponentials sum to one."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate of one step and how it came about."""

    mean: PyTree
    """Weighted intrinsic mean of the particles; a guided filter takes out what its choice of ancestors did by luck."""
    covariance: Array
    """(d, d) in the tangent space at the mean."""
    log_likelihood: Array
    """() log-density of this step's measurement given the earlier ones, estimated; their sum is the log-evidence, whose
    exponential has no bias. -inf where all weights vanished."""
    ess: Array
    """() effective sample size of the weights, before any resampling."""
    ancestors: Array | None
    """(N,) int32, which particles of the step before these come from; None unless the model asks for them."""
    status: Array
    """() int32, `OK`, `NON_FINITE` or `WEIGHTS_VANISHED`."""


class _Foresight(NamedTuple):
    """By what ancestors were chosen."""

    log_likelihood: Array
    """() what of the log-evidence is not in the weights afterwards."""
    chances: Array
    """(N,) of each particle, they sum to one."""
    aims: PyTree
    """Leaves (N, ...), the most probable next state of each."""


def init(particles: PyTree, log_weights: ArrayLike | None = None) -> State:
    """Return the state that has seen no data.

    Args:
        particles: leaves (N, ...), drawn from what is known before the first measurement.
        log_weights: (N,) of any scale; equal if None.

    Returns:
        The state before the first measurement, to which the first step moves on over its own `dt`.

    Raises:
        ValueError: the leaves have no common leading axis, or the weights another length.
    """
    particles = jax.tree.map(jnp.asarray, particles)
    leaves = jax.tree.leaves(particles)
    counts = {leaf.shape[0] if leaf.ndim else None for leaf in leaves}
    if len(counts) != 1 or None in counts:
        raise ValueError(f"particles: leaves have shapes {[x.shape for x in leaves]}, expected (N, ...) with one N")
    count, dtype = leaves[0].shape[0], jnp.result_type(*leaves)
    given = jnp.zeros(count, dtype) if log_weights is None else jnp.asarray(log_weights, dtype)
    if given.shape != (count,):
        raise ValueError(f"log_weights: has shape {given.shape}, expected ({count},), one a particle")
    return State(particles, normalize(given)[0], jnp.zeros((), jnp.int32))


@cache
def filter_step(model: Model) -> Step:
    """Return the particle filter of a model, for `run` or a live loop.

    Args:
        model: static. The same model gives the same object, so that `run` compiles once.

    Returns:
        `(params, state, measurement, *, key) -> (state, info)` with `State` and `Info` of this file. Particles stay
        weighted between steps, and are resampled at the start of the next. Where all weights vanish, the particles are
        kept as they were proposed, with equal weights, and the status says so. Without a key it raises ValueError.
    """
    return partial(_step, model)


def _step(
    model: Model, params: PyTree, state: State, measurement: PyTree, *, key: Array | None = None
) -> tuple[State, Info]:
    if key is None:
        raise ValueError("key: got None, expected the key of the run; a particle filter draws random numbers")
    measurement, broken = clean(measurement)
    choice, motion = jax.random.split(jax.random.fold_in(key, state.index))
    chosen, before, moved, increments, foresight = _moved(model, params, state, measurement, choice, motion)
    particles, increments = settled(before, moved, increments.astype(state.log_weights.dtype))
    return concluded(model, state, chosen, particles, increments, broken, foresight)


def concluded(
    model: Model, state: State, chosen: Resampled, particles: PyTree, increments: Array, broken: Array,
    foresight: Any = None,
) -> tuple[State, Info]:  # fmt: skip
    """Return what follows once all particles are where they are.

    Args:
        model: the filter's.
        state: before the step.
        chosen: who went on, and with which weights.
        particles: leaves (N, ...), where to, finite.
        increments: (N,) logarithms of their weights' factors.
        broken: () bool, whether the measurement held what is not finite.
        foresight: by what ancestors were chosen, where a measurement was looked at before.

    Returns:
        The next state, and the step's info.
    """
    log_weights, log_likelihood, vanished = normalize(chosen.log_weights + increments)
    weights = jnp.exp(log_weights)
    mean, covariance = weighted(model.manifold, particles, weights)
    if foresight is not None:
        log_likelihood = log_likelihood + foresight.log_likelihood
        mean = _balanced(model.manifold, mean, foresight, chosen)
    status = jnp.where(vanished, WEIGHTS_VANISHED, jnp.where(broken, NON_FINITE, OK)).astype(jnp.int32)
    info = Info(
        mean,
        covariance,
        log_likelihood,
        1 / jnp.sum(weights * weights),
        chosen.ancestors if model.ancestors else None,
        status,
    )
    return State(particles, log_weights, state.index + 1), info


def _moved(
    model: Model, params: PyTree, state: State, measurement: PyTree, choice: Array, motion: Array
) -> tuple[Resampled, PyTree, PyTree, Array, _Foresight | None]:
    """Choose who goes on and send them.

    Returns the choice, those who go, where to, their weights' factors, and what the choice was made by.
    """
    held = jax.lax.stop_gradient(state.particles)
    if not isinstance(model.propose, Guided):
        chosen = model.resample(choice, state.log_weights)
        before = jax.tree.map(partial(picked, chosen.ancestors), held)
        return chosen, before, *model.propose(params, before, measurement, motion), None
    ahead, plan = model.propose.look(params, held, measurement, state.index == 0)
    aims = model.propose.aims(plan)
    ahead = model.propose.heeded(ahead.astype(state.log_weights.dtype), state.log_weights)
    chosen = model.resample(choice, state.log_weights + ahead)
    chances, total, _ = normalize(state.log_weights + ahead)
    before = jax.tree.map(partial(picked, chosen.ancestors), held)
    plan = take(plan, chosen.ancestors)
    moved, increments = model.propose.send(params, before, plan, measurement, motion, chosen.log_weights)
    foresight = _Foresight(total, jnp.exp(chances), aims)
    favour = jnp.where(plan.scattered, 0, picked(chosen.ancestors, ahead))
    return chosen, before, moved, increments - favour, foresight


def _balanced(manifold: Manifold, mean: PyTree, foresight: _Foresight, chosen: Resampled) -> PyTree:
    """Move the mean by where all aim, by their chances, less where those aim who were chosen.

    Both agree but for the luck of the choice, which is most of what the mean of a few well guided particles errs by.
    """
    count = foresight.chances.shape[0]
    took = jnp.zeros(count, foresight.chances.dtype).at[chosen.ancestors].add(jnp.exp(chosen.log_weights))
    away = jax.vmap(manifold.local, (None, 0))(mean, foresight.aims)
    shift = jnp.matmul(foresight.chances - took, away, precision=jax.lax.Precision.HIGHEST)
    shift = jax.lax.stop_gradient(jnp.where(jnp.all(jnp.isfinite(shift)), shift, 0))
    return manifold.retract(mean, shift)


def settled(before: PyTree, moved: PyTree, increments: Array) -> tuple[PyTree, Array]:
    """Put particles that are not finite, or whose weight is not, back where they came from, without one."""
    finite = ~jnp.isnan(increments) & (increments < jnp.inf)
    for leaf in jax.tree.leaves(moved):
        finite = finite & jnp.all(jnp.isfinite(leaf), axis=tuple(range(1, leaf.ndim)))

    def back(old: Array, new: Array) -> Array:
        return jnp.where(finite.reshape(-1, *(1 for _ in new.shape[1:])), new, old)

    return jax.tree.map(back, before, moved), jnp.where(finite, increments, -jnp.inf)


__all__ = ["Info", "Model", "State", "filter_step", "init"]
