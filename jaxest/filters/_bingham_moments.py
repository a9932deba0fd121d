"""What the Bingham linear filter keeps of the pairs: their moments."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.filters._small import outer, trace
from jaxest.filters._time import elapsed
from jaxest.types import NON_FINITE, OK, Array, ArrayLike, Reading


class Params(NamedTuple):
    """What may be tuned or differentiated."""

    covariance_a: ArrayLike = np.diag([1e-4] * 3)
    """(3, 3) of a sample's white noise in `a`, (rad/s)^2."""
    covariance_b: ArrayLike = np.diag([1e-4] * 3)
    """(3, 3) likewise in `b`."""
    bias: ArrayLike = 1.0
    """() rad/s, standard deviation, about each axis, of the relative bias before any data; 0 for none."""
    forgetting: ArrayLike = 1.0
    """() gamma_rot: how much of the past is kept at each valid pair, above 0 to 1."""


class Pair(NamedTuple):
    """One pair of vectors."""

    a: Reading
    """value (3,) rad/s, in the destination frame."""
    b: Reading
    """value (3,) rad/s, in the source frame."""
    dt: ArrayLike
    """() s, time since the previous step; only its sign counts."""


class State(NamedTuple):
    """Moments of the pairs z = (a, b)."""

    weight: Array
    """() number of pairs, less what was forgotten."""
    mean: Array
    """(6,) rad/s"""
    scatter: Array
    """(6, 6) weighted sum of (z - mean)(z - mean)'."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


def init(params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen no pair, in the dtype of the parameters; `key` is not used."""
    dtype = jnp.result_type(*params)
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    zero = jnp.zeros((), dtype)
    return State(zero, jnp.zeros(6, dtype), jnp.zeros((6, 6), dtype), jnp.zeros((), jnp.int32))


def usable(measurement: Pair, dtype: Any) -> tuple[Array, Array, Array]:
    """Return the pair (6,) with 0 where it is not there, whether it is, and the status; ValueError for shapes."""
    timely = elapsed(measurement.dt)[1]
    values, flags, bad = [], [], [~timely]
    for name in ("a", "b"):
        reading = getattr(measurement, name)
        value, flag = jnp.asarray(reading.value, dtype), jnp.asarray(reading.valid, bool)
        if value.shape != (3,) or flag.shape != ():
            raise ValueError(
                f"measurement.{name}: got shapes {value.shape} and {flag.shape}, expected (3,) and (); vmap or run "
                "adds other axes"
            )
        finite = jnp.all(jnp.isfinite(value))
        values.append(value)
        flags.append(flag & finite)
        bad.append(flag & ~finite)
    there = flags[0] & flags[1] & timely
    z = jnp.concatenate(values)
    return jnp.where(there, z, 0), there, jnp.where(bad[0] | bad[1] | bad[2], NON_FINITE, OK).astype(jnp.int32)


def add(state: State, z: Array, weight: Array, forgetting: Array) -> State:
    """Take in one pair.

    Args:
        state: the moments; axes behind, here and in z and weight, are batches.
        z: (6,) a and b, finite.
        weight: () how much it counts; with 0 nothing changes, nothing is forgotten.
        forgetting: () factor on the past.

    Returns:
        The next state.

    Source: Sato 2024, eq. 36; Welford 1962 for the centred sums.
    """
    past = jnp.where(weight > 0, forgetting * state.weight, state.weight)
    total = past + weight
    share = weight / jnp.where(total > 0, total, 1)
    away = z - state.mean
    kept = jnp.where(weight > 0, forgetting, 1)[None, None] * state.scatter
    scatter = kept + (past * share)[None, None] * outer(away, away)
    return State(total, state.mean + share[None] * away, scatter, state.index + 1)


def moments(params: Params, state: State) -> Array:
    """Return the second moments (6, 6) with the relative bias integrated out under its prior."""
    dtype = state.mean.dtype
    noise = trace(jnp.asarray(params.covariance_a) + jnp.asarray(params.covariance_b)).astype(dtype) / 3
    prior = jnp.asarray(params.bias, dtype) ** 2
    # n pairs against a prior of n0 pairs: the mean counts n n0 / (n + n0), which tends to n where no bias is allowed.
    some = noise + prior * state.weight
    share = state.weight * noise / jnp.where(some > 0, some, 1)
    return state.scatter + share[None, None] * outer(state.mean, state.mean)


__all__ = ["Pair", "Params", "State", "add", "init", "moments", "usable"]
