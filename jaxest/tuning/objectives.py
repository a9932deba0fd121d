"""What is to be small: functions of parameters and one recording, under one contract.

`supervised` compares with a truth, `likelihood` needs none (Kalman filters, and particle filters, whose gradient is the
score), `smoothed` is Laplace's approximation of it along a smoothed path, `density` any function that gives a log-
density of a recording, `consistency` asks the innovations to be as large as the filter says. `total` is the mean over a
batch.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters import kalman, run
from jaxest.parallel import one_by_one
from jaxest.tuning.recordings import Recording
from jaxest.types import Array, Init, PyTree, Step, System


class Objective(NamedTuple):
    """What one recording says of the parameters; static, hashed by identity. Build it once."""

    loss: Callable[..., Array]
    """`(params, recording, key) -> ()`; the key is None where nothing is drawn."""
    likelihood: bool = False
    """Whether the loss is minus a log-density, so that its curvature, summed over recordings, is an information."""
    random: bool = False
    """Whether a loss is an estimate, drawn with a key; its gradient estimates the gradient of the expectation."""
    apart: bool = False
    """Whether recordings and starts are run one after the other instead of side by side: quicker for an estimator that
    skips most of its work at most steps, which a batch does for all at every step."""


class Tally(NamedTuple):
    """An estimator's state, beside which a run counts."""

    state: PyTree
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple


Term = Callable[[PyTree, PyTree], PyTree]
"""`(info, truth of that step) -> what is kept of it`, such as an angle."""
Reduce = Callable[[PyTree, Array], Array]
"""`(terms (T, ...), counts (T,)) -> ()`."""


def mean(terms: Array, counts: Array) -> Array:
    """Return the mean () of the terms (T,) that count, 0 where none does."""
    number = jnp.sum(counts)
    return jnp.sum(jnp.where(counts, terms, 0)) / jnp.where(number == 0, 1, number).astype(terms.dtype)


def rms(terms: Array, counts: Array) -> Array:
    """Return the root mean square () of the terms (T,) that count; its gradient is 0, not NaN, at 0."""
    square = mean(jnp.where(counts, terms, 0) ** 2, counts)
    there = square > 0
    return jnp.where(there, jnp.sqrt(jnp.where(there, square, 1)), 0)


def supervised(system: System, term: Term, reduce: Reduce = rms, *, apart: bool = False) -> Objective:
    """Compare estimates with a truth.

    Args:
        system: the estimator.
        term: `(info, truth) -> error` of one step.
        reduce: `(errors, counts) -> ()`; `rms` and `mean` are here, `errors.free_heading` turns a heading first.
        apart: see `Objective`; four times quicker for the attitude filter `ekf`, which corrects at every ninth sample.

    Returns:
        The objective. Particle filters are refused: their estimates have no honest gradient, use `likelihood`.
    """
    return Objective(partial(_supervised, system.init, _beside(system.step, term), reduce), apart=apart)


def _supervised(init: Init, step: Step, reduce: Reduce, params: PyTree, one: Recording, key: Array | None) -> Array:
    start = Tally(init(params), jnp.zeros((), jnp.int32))
    _, terms = run(step, params, start, (one.measurements, one.truth))
    return reduce(terms, jnp.asarray(one.counts))


def _beside(step: Step, term: Term) -> Step:
    def both(params: PyTree, state: Tally, measurement: Any, *, key: Array | None = None) -> tuple[Tally, PyTree]:
        seen, truth = measurement
        after, info = step(params, state.state, seen, key=key)
        return Tally(after, state.index + 1), term(info, truth)

    return both


def _density(state: PyTree, info: Any) -> Array:
    return jnp.sum(info.log_likelihood)  # of a step whose parts have one each, all


def likelihood(system: System, *, random: bool = False) -> Objective:
    """Take minus the log marginal likelihood, the sum of `info.log_likelihood` over the steps that count.

    Args:
        system: the estimator: a Kalman filter (`kalman_system`), or a particle filter.
        random: whether it draws (a particle filter); the value is then an estimate of the log-evidence, and its
            gradient an estimate of the score by Fisher's identity, which does not pass through resampling.

    Returns:
        The objective.
    """
    return Objective(partial(_likelihood, system), likelihood=True, random=random)


def _likelihood(system: System, params: PyTree, one: Recording, key: Array | None) -> Array:
    first, rest = (None, None) if key is None else jax.random.split(key)
    state = system.init(params, key=first)
    _, terms = run(system.step, params, state, one.measurements, key=rest, history=_density)
    return -jnp.sum(jnp.where(jnp.asarray(one.counts), terms, 0))


def density(log_density: Callable[[PyTree, PyTree], Array]) -> Objective:
    """Take minus a log-density that one function gives of a whole recording.

    Args:
        log_density: `(params, measurements) -> ()`; steps that are padded say nothing in it.

    Returns:
        The objective.
    """
    return Objective(lambda params, one, key: -log_density(params, one.measurements), likelihood=True)


def kalman_system(model: kalman.Model, init: Callable[[PyTree], kalman.State]) -> System:
    """Bundle a Kalman filter's model and its start.

    Args:
        model: the state-space model.
        init: `params -> kalman.State` before the first measurement.

    Returns:
        The system; it has no `simulate` and no default parameters.
    """

    def start(params: PyTree, *, key: Array | None = None) -> kalman.State:
        return init(params)

    return System(None, start, kalman.filter_step(model), _no_simulation)


def _no_simulation(params: PyTree, *, key: Array, **options: Any) -> Any:
    raise ValueError("simulate: a model alone cannot be simulated")


def smoothed(model: kalman.Model, init: Callable[[PyTree], kalman.State], *, iterations: int = 1) -> Objective:
    """Take minus the log marginal likelihood of the model linearised along its smoothed path.

    Args:
        model: the state-space model.
        init: `params -> kalman.State` before the first measurement.
        iterations: linearisations of the path; 1 is exact for a linear model.

    Returns:
        The objective.
    """

    def loss(params: PyTree, one: Recording, key: Array | None) -> Array:
        history = kalman.smooth(model, params, init(params), one.measurements, iterations=iterations)
        return -jnp.sum(jnp.where(jnp.asarray(one.counts), history.log_likelihood, 0))

    return Objective(loss, likelihood=True)


def _innovation(state: PyTree, info: Any) -> tuple[Array, Array]:
    return info.nis, info.dof


def consistency(system: System) -> Objective:
    """Ask that innovations are as large as the filter says: r - 1 - log r of the ratio r = sum NIS / sum dof.

    One number a recording, so it settles the size of all noise together, not of each; combine it with other objectives
    or free one parameter.

    Args:
        system: an estimator whose infos have `nis` and `dof`.

    Returns:
        The objective: 0 where the mean normalised innovation squared equals its degrees of freedom, without unit.
    """

    def loss(params: PyTree, one: Recording, key: Array | None) -> Array:
        state = system.init(params, key=key)
        _, (nis, dof) = run(system.step, params, state, one.measurements, key=key, history=_innovation)
        counts = jnp.asarray(one.counts)
        rows = jnp.sum(jnp.where(counts, dof, 0)).astype(nis.dtype)
        ratio = jnp.sum(jnp.where(counts, nis, 0)) / jnp.where(rows == 0, 1, rows)
        there = ratio > 0
        ratio = jnp.where(there, ratio, 1)
        return jnp.where(there, ratio - 1 - jnp.log(ratio), 0)

    return Objective(loss)


def total(objective: Objective, params: PyTree, batch: Recording, key: Array | None = None) -> Array:
    """Return the mean loss () of a batch of recordings (B, T, ...), each drawn with a key of its own."""
    return jnp.mean(each(objective, params, batch, key))


def each(objective: Objective, params: PyTree, batch: Recording, key: Array | None = None) -> Array:
    """Return the loss (B,) of every recording of a batch."""
    return per_recording(objective, lambda one, k: objective.loss(params, one, k), batch, key)


def per_recording(
    objective: Objective, function: Callable[[Recording, Array | None], PyTree], batch: Recording, key: Array | None
) -> PyTree:
    """Return a function of `(recording, key)` for every recording of a batch, each with a key of its own if drawn."""
    batch = jax.tree.map(jnp.asarray, batch)  # a closure's arrays of NumPy are constants that no root finder takes
    if not objective.random:
        return batched(objective)(lambda one: function(one, None))(batch)
    if key is None:
        raise ValueError("key: got None, expected a key, for this objective is drawn")
    return batched(objective)(function)(batch, jax.random.split(key, jnp.shape(batch.counts)[0]))


def batched(objective: Objective) -> Callable[[Callable[..., PyTree]], Callable[..., PyTree]]:
    """Return what makes of a function of one item that of a batch: `vmap`, or a loop where items are run apart."""
    return one_by_one if objective.apart else jax.vmap


__all__ = [
    "Objective",
    "batched",
    "consistency",
    "density",
    "each",
    "kalman_system",
    "likelihood",
    "mean",
    "per_recording",
    "rms",
    "smoothed",
    "supervised",
    "total",
]
