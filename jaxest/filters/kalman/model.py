"""A state-space model, and the filter step that comes of it.

Write the model once, as functions of `(params, x, measurement)`; `filter_step(model)` filters it, `smooth(model, ...)`
smooths it.
"""

import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters._state import within_range
from jaxest.filters._time import elapsed
from jaxest.filters.kalman.factors import Factor
from jaxest.filters.kalman.gain import Gain, by_size
from jaxest.filters.kalman.gaussian import Gaussian, predict
from jaxest.filters.kalman.update import update
from jaxest.manifolds.base import Manifold
from jaxest.types import NON_FINITE, OK, Array, ArrayLike, PyTree, Reading, Step


class Sensor(NamedTuple):
    """One sensor of a model, as functions; `sensor` makes one from a measurement function."""

    residual: Callable[[PyTree, PyTree, PyTree], Array]
    """`(params, x, measurement) -> (m,)`, measured minus predicted; finite in masked rows too."""
    noise: Callable[[PyTree, PyTree], ArrayLike]
    """`(params, measurement) -> (m,)`, (m, m) or (k, d, d), as in `Factor`."""
    valid: Callable[[PyTree], ArrayLike]
    """`measurement -> () or (k,)` bool; each entry rules m / k rows."""
    loss: Callable[[Array], Array] | None = None
    """Robust loss, as in `Factor`."""
    gate: float | None = None
    """Squared Mahalanobis distance, as in `Factor`."""


class Model(NamedTuple):
    """A state-space model: all static, numbers come in as `params`. Build it once, it is hashed by identity."""

    manifold: Manifold
    """Where the state lives, dimension n."""
    dynamics: Callable[[PyTree, PyTree, PyTree], PyTree]
    """`(params, x, measurement) -> x` a step of `measurement.dt` later. Every `Reading` it sees is finite: 0 where it
    is invalid, and what then happens is the model's own choice."""
    process_noise: Callable[[PyTree, PyTree, PyTree], ArrayLike]
    """`(params, x, measurement) -> (n, n)` covariance over that step, in the tangent space at its end."""
    sensors: tuple[Sensor, ...]
    """Independent given the state."""
    iterations: int = 1
    """Linearisations of an update at most; 1 is the extended Kalman filter."""
    tolerance: float | None = None
    """As in `update`."""
    gain: Gain = by_size
    """As in `update`."""


class State(NamedTuple):
    """What the next step needs."""

    mean: PyTree
    """An element of the manifold."""
    covariance: Array
    """(n, n) in the tangent space at the mean."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate of one step and how it came about."""

    mean: PyTree
    """The state at this measurement."""
    covariance: Array
    """(n, n) in the tangent space at the mean."""
    log_likelihood: Array
    """() log-density of this step's measurement given the earlier ones; their sum is the log-evidence."""
    nis: Array
    """() normalised innovation squared."""
    dof: Array
    """() int32, rows used, the degrees of freedom of `nis`."""
    innovation: Array
    """(m,) measured minus predicted, of all sensors in order; 0 where masked."""
    used: Array
    """(m,) bool, rows that existed, were finite and passed their gate."""
    iterations: Array
    """() int32, linearisations."""
    status: Array
    """() int32, `OK`, `NON_FINITE`, `NOT_CONVERGED`, or `OUT_OF_RANGE` (state as before)."""


def sensor(
    reading: str,
    predict: Callable[[PyTree, PyTree, PyTree], PyTree],
    noise: Callable[[PyTree, PyTree], ArrayLike],
    *,
    manifold: Manifold | None = None,
    loss: Callable[[Array], Array] | None = None,
    gate: float | None = None,
) -> Sensor:
    """Build a sensor from what it would read.

    Args:
        reading: the measurement's field, a `Reading`; its `valid` has the leading axes of its value.
        predict: `(params, x, measurement) ->` what the sensor reads in state x, shaped as the reading's value.
        noise: `(params, measurement) -> (m,)` variances or a covariance, in the tangent space at the prediction.
        manifold: where the value lives, dimension m; differences of the entries if None.
        loss: robust loss, `huber` or `cauchy`.
        gate: squared Mahalanobis distance beyond which a block of the noise is left out.

    Returns:
        The sensor. A masked value is replaced by its own prediction before anything is computed from it.
    """

    def residual(params: PyTree, x: PyTree, measurement: PyTree) -> Array:
        expected = predict(params, x, measurement)
        value, valid = getattr(measurement, reading)
        stand_in = jax.lax.stop_gradient(expected)
        value = jax.tree.map(lambda v, e: jnp.where(_wide(valid, v), v, e), value, stand_in)
        return (value - expected).reshape(-1) if manifold is None else manifold.local(expected, value)

    return Sensor(residual, noise, lambda measurement: getattr(measurement, reading).valid, loss, gate)


def init(mean: PyTree, covariance: ArrayLike) -> State:
    """Return the state that has seen no data.

    Args:
        mean: an element of the model's manifold.
        covariance: (n, n) in the tangent space at the mean.

    Returns:
        The state before the first measurement, from which the first step predicts over its own `dt`.
    """
    return State(jax.tree.map(jnp.asarray, mean), jnp.asarray(covariance), jnp.zeros((), jnp.int32))


@cache
def filter_step(model: Model) -> Step:
    """Return the error-state Kalman filter of a model, for `run` or a live loop.

    Args:
        model: static. The same model gives the same object, so that `run` compiles once.

    Returns:
        `(params, state, measurement, *, key=None) -> (state, info)` with `State` and `Info` of this file. A missing
        reading leaves the prediction; a reading that is valid and not finite counts as missing and is reported.
    """
    return partial(_step, model)


def _step(
    model: Model, params: PyTree, state: State, measurement: PyTree, *, key: Array | None = None
) -> tuple[State, Info]:
    measurement, broken = clean(measurement)
    belief = Gaussian(state.mean, state.covariance)
    moved = predict(
        model.manifold,
        belief,
        lambda x: model.dynamics(params, x, measurement),
        _typed(model.process_noise(params, state.mean, measurement), state.covariance),
    )
    belief, info = update(
        model.manifold,
        moved,
        factors(model, params, measurement),
        iterations=model.iterations,
        tolerance=model.tolerance,
        gain=model.gain,
    )
    status = jnp.where(broken & (info.status == OK), NON_FINITE, info.status).astype(jnp.int32)
    fields = {name: getattr(info, name) for name in Info._fields[2:-1]}
    found = Info(belief.mean, belief.covariance, **fields, status=status)
    state, found = within_range(state, State(belief.mean, belief.covariance, state.index + 1), found)
    return state, found._replace(mean=state.mean, covariance=state.covariance)


def factors(model: Model, params: PyTree, measurement: PyTree) -> list[Factor]:
    """Return what a measurement, cleaned by `clean`, says: one factor a sensor."""

    def factor(one: Sensor) -> Factor:
        def residual(x: PyTree) -> Array:
            return one.residual(params, x, measurement)

        noise = jnp.asarray(one.noise(params, measurement))
        size = noise.shape[0] if noise.ndim < 3 else noise.shape[0] * noise.shape[1]
        valid = jnp.asarray(one.valid(measurement), bool).reshape(-1)
        if size % valid.shape[0]:
            raise ValueError(f"valid: has {valid.shape[0]} entries, expected a number that divides {size} rows")
        return Factor(residual, noise, jnp.repeat(valid, size // valid.shape[0]), one.loss, one.gate)

    return [factor(one) for one in model.sensors]


def clean(measurement: PyTree) -> tuple[PyTree, Array]:
    """Replace what is masked or not finite by zeros, before anything is computed from it.

    Args:
        measurement: any pytree with `Reading`s.

    Returns:
        The same with finite values, whose `valid` is false where the value was not finite, and everywhere where a field
        `dt` is negative or not finite, which is then 0; and whether any was.
    """
    bad, timely = [], jnp.ones((), bool)
    if hasattr(measurement, "dt"):
        dt, timely = elapsed(measurement.dt)
        measurement = measurement._replace(dt=dt)
        bad.append(~timely)

    def mend(leaf: Any) -> Any:
        if not isinstance(leaf, Reading):
            return leaf
        valid = jnp.asarray(leaf.valid, bool)
        finite = jnp.ones(valid.shape, bool)
        for value in jax.tree.leaves(leaf.value):
            inner = tuple(range(valid.ndim, jnp.ndim(value)))
            finite = finite & jnp.all(jnp.isfinite(value), axis=inner)
        bad.append(jnp.any(valid & ~finite))
        valid = valid & finite & timely
        return Reading(jax.tree.map(lambda v: jnp.where(_wide(valid, v), v, 0), leaf.value), valid)

    mended = jax.tree.map(mend, measurement, is_leaf=lambda x: isinstance(x, Reading))
    return mended, jnp.any(jnp.stack(bad)) if bad else jnp.zeros((), bool)


def _typed(value: ArrayLike, like: Array) -> Array:
    return jnp.asarray(value, like.dtype)


def _wide(valid: Any, value: Any) -> Array:
    """Append axes to a mask until it broadcasts against the value."""
    valid = jnp.asarray(valid, bool)
    shape = valid.shape + (1,) * (jnp.ndim(value) - valid.ndim)
    if math.prod(valid.shape) > 1 and valid.shape != jnp.shape(value)[: valid.ndim]:
        raise ValueError(f"valid: has shape {valid.shape}, expected leading axes of the value, {jnp.shape(value)}")
    return jnp.broadcast_to(valid.reshape(shape), jnp.shape(value))


__all__ = ["Info", "Model", "Sensor", "State", "clean", "factors", "filter_step", "init", "sensor"]
