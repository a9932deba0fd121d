"""The one driver of every estimator: scan a step over measurements, keep what a reducer asks for."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.types import Array, PyTree, Reducer, Step


def full(state: PyTree, info: PyTree) -> PyTree:
    """Keep the whole info of every step.

    Args:
        state: the estimator's state after the step; not kept.
        info: the step's info.

    Returns:
        `info`; `run` stacks it to leaves (T, ...), one row per measurement.
    """
    return info


class Last(NamedTuple):
    """Keep the final step only; needs no memory per step."""

    keep: Reducer = full
    """What to keep of that step."""


class Every(NamedTuple):
    """Keep each k-th step, as `every` makes it; needs memory for the kept steps only."""

    period: int
    """Steps from one kept row to the next."""
    keep: Reducer = full
    """What to keep of each kept step."""


class Sampled(NamedTuple):
    """What `every(k)` kept of T measurements."""

    value: PyTree
    """Leaves (ceil(T / k), ...), in order of time; zeros where not valid."""
    valid: Array
    """(ceil(T / k),) bool; only the last row may be invalid, and none is if k divides T."""


last = Last()


def every(period: int, keep: Reducer = full) -> Every:
    """Keep each `period`-th step, counted from `state.index` and not from the start of a chunk.

    A step is kept when the number of steps that the state has seen is a multiple of `period`. Chunks of any length
    therefore keep, one after the other, exactly the rows that the whole run keeps (`value[valid]`).

    Args:
        period: steps from one kept row to the next, at least 1; static.
        keep: what to keep of a kept step, `(state, info) -> pytree`.

    Returns:
        A reducer for `run`, whose history is a `Sampled`.

    Raises:
        ValueError: the period is below 1.
    """
    if period < 1:
        raise ValueError(f"period: got {period}, expected at least 1")
    return Every(int(period), keep)


def run(
    step: Step,
    params: PyTree,
    state0: PyTree,
    measurements: PyTree,
    *,
    key: Array | None = None,
    history: Reducer | Last | Every = full,
) -> tuple[PyTree, PyTree]:
    """Step through measurements and return the final state and the history.

    The same call starts (`state0` from `init`), resumes and runs in chunks (`state0` from the call before): since the
    state carries `index` and a step folds it into `key`, chunks give the same numbers as one call. The scan is
    compiled once per `step`, `history` and shapes, so both should be objects that live on, not fresh lambdas.

    Args:
        step: `(params, state, measurement, *, key) -> (state, info)`; hashable, static.
        params: the step's parameters, any pytree.
        state0: the state before the first measurement; has a field `index`, the number of steps it has seen.
        measurements: the step's measurement with a leading time axis of T on every leaf.
        key: key of the whole run, or None for a step that draws nothing.
        history: what to keep. `full`: every info, leaves (T, ...). `last`: the final info. `every(k)`: each k-th,
            as `Sampled`. Any function `(state, info) -> pytree`: its results, stacked to (T, ...).

    Returns:
        The state after the last measurement, and the history.

    Raises:
        ValueError: the leaves of `measurements` have no common leading axis, `state0` has no `index`, or `last` is
            asked of no measurement at all.
    """
    length = _length(measurements)
    if callable(getattr(state0, "index", len)):  # every tuple has a method of that name
        raise ValueError(f"state0: got {type(state0).__name__} without a field 'index', expected a state that counts")
    if isinstance(history, Last) and length == 0:
        raise ValueError("measurements: got 0 steps, expected at least 1 for the history 'last'")
    return _run(step, history, params, state0, measurements, key)


@partial(jax.jit, static_argnums=(0, 1))
def _run(step: Step, history: Any, params: PyTree, state0: PyTree, measurements: PyTree, key: Any) -> Any:
    keep = history.keep if isinstance(history, Last | Every) else history

    def advance(state: PyTree, measurement: PyTree) -> tuple[PyTree, PyTree]:
        state, info = step(params, state, measurement, key=key)
        return state, keep(state, info)

    if isinstance(history, Last):
        return _last(advance, state0, measurements)
    if isinstance(history, Every):
        return _every(advance, history.period, state0, measurements)
    return jax.lax.scan(advance, state0, measurements)


def _last(advance: Any, state0: PyTree, measurements: PyTree) -> tuple[PyTree, PyTree]:
    """Only the state is kept in the loop: what the steps before the last one say beyond it is never computed."""
    before, final = jax.tree.map(lambda x: x[:-1], measurements), jax.tree.map(lambda x: x[-1], measurements)
    state, _ = jax.lax.scan(lambda state, measurement: (advance(state, measurement)[0], None), state0, before)
    return advance(state, final)


def _every(advance: Any, period: int, state0: PyTree, measurements: PyTree) -> tuple[PyTree, Sampled]:
    """Any `period` steps in a row hold exactly one that is kept, so groups of that length are scanned for it."""
    length = _length(measurements)
    whole = length - length % period
    if length == 0:
        empty = _empty(advance, state0, measurements)
        return state0, Sampled(jax.tree.map(lambda x: x[None][:0], empty), jnp.zeros(0, bool))

    def body(carry: Any, measurement: PyTree) -> tuple[Any, None]:
        state, (kept, valid) = carry
        state, row = advance(state, measurement)
        now = state.index % period == 0
        kept = jax.tree.map(lambda new, old: jnp.where(now, new, old), row, kept)
        return (state, (kept, valid | now)), None

    def group(state: PyTree, rows: PyTree) -> tuple[PyTree, Any]:
        start = (_empty(advance, state, rows), jnp.zeros((), bool))
        return jax.lax.scan(body, (state, start), rows)[0]

    blocks = jax.tree.map(lambda x: x[:whole].reshape(-1, period, *x.shape[1:]), measurements)
    state, (value, valid) = jax.lax.scan(group, state0, blocks)
    if whole < length:
        state, (row, found) = group(state, jax.tree.map(lambda x: x[whole:], measurements))
        value = jax.tree.map(lambda head, tail: jnp.concatenate([head, tail[None]]), value, row)
        valid = jnp.concatenate([valid, found[None]])
    return state, Sampled(value, valid)


def _empty(advance: Any, state: PyTree, measurements: PyTree) -> PyTree:
    """Zeros like one kept row, found without running the step."""
    first = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), measurements)
    _, row = jax.eval_shape(advance, state, first)
    return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), row)


def _length(measurements: PyTree) -> int:
    leaves, _ = jax.tree_util.tree_flatten_with_path(measurements)
    if not leaves:
        raise ValueError("measurements: got no arrays, expected leaves with a leading time axis")
    lengths = {f"measurements{jax.tree_util.keystr(path)}": jnp.shape(leaf)[:1] for path, leaf in leaves}
    (first, expected), *others = lengths.items()
    for name, shape in [(first, expected), *others]:
        if not shape:
            raise ValueError(f"{name}: got a scalar, expected a leading time axis")
        if shape != expected:
            raise ValueError(f"{name}: got {shape[0]} rows, expected {expected[0]} as {first} has")
    return expected[0]
