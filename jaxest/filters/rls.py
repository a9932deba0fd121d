"""Recursive least squares for vector observations y = O x + noise, with a covariance that can be believed.

`step` keeps the information form of Sato 2024, Algorithm 1, and goes past it in two ways. Regressors that are
themselves noisy shrink the estimate; what their noise adds to the information on average is taken off again. Residuals
of overlapping windows are correlated; the covariance is therefore that of the sums of whole blocks of steps, each
longer than the correlation, evaluated at the newest estimate. `square_root_step` is the same recursion without either,
on a triangular factor: half the digits suffice.

Source: Sato 2024, eqs. 16 to 20 and Algorithm 1, with the forgetting on the old terms; Moon and Stirling 2000, section
4.11.1; Fuller 1987 (Measurement Error Models), section 2.2; Newey and West 1987 for the sandwich.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters._rls_root import Triangle, square_root_step
from jaxest.filters._small import (
    applied,
    eye,
    inverse3,
    outer,
    product,
    sandwich,
    trace,
    transposed,
    turned_back,
)
from jaxest.filters._state import apart, within_range
from jaxest.filters._time import elapsed
from jaxest.linalg._eigen4 import eigen4
from jaxest.types import NON_FINITE, OK, Array, ArrayLike, Reading


class Params(NamedTuple):
    """What may be tuned or differentiated."""

    forgetting: ArrayLike = 1.0
    """() gamma_pos: how much of the past is kept at each valid step, above 0 to 1."""
    prior: ArrayLike = 0.0
    """() standard deviation of each unknown before any data, about 0; 0 for no prior."""
    floor: ArrayLike = 1e-6
    """() least standard deviation of an observation, in its own unit; keeps the residuals' covariance regular."""


class Observation(NamedTuple):
    """One vector observation."""

    regressor: Reading
    """value (3, 3), O."""
    target: Reading
    """value (3,), y."""
    regressor_noise: ArrayLike
    """(3, 3) expected E' E of the regressor's noise E whose columns the unknowns multiply; zeros if exact. It is taken
    off the information with the mean variance of the residuals."""
    dt: ArrayLike
    """() s, time since the previous step; only its sign counts."""


class State(NamedTuple):
    """What the next step needs; the weights are inverses of residual covariances."""

    information: Array
    """(3, 3) P^-1, without the prior."""
    projection: Array
    """(3,) Q."""
    estimate: Array
    """(3,) x, as the last step's info has it."""
    queue: Array
    """(N_lag, 3) residuals as they came, newest last."""
    block: Array
    """(9,) Q and the upper triangle of P^-1 of the steps since the last whole block."""
    blocks: Array
    """(9, 9) sum over whole blocks of that vector with itself."""
    pending: Array
    """() bool, whether the sums are still to be divided by the residuals' variance."""
    seen: Array
    """() int32, valid steps."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate after a step."""

    estimate: Array
    """(3,) x."""
    covariance: Array
    """(3, 3) that of blocks once there are 8 of them, P before."""
    formal: Array
    """(3, 3) P, as if residuals were independent."""
    residual: Array
    """(3,) y - O x with the estimate before; 0 where there is nothing."""
    noise: Array
    """(3, 3) C, covariance of the residuals over N_lag."""
    variance: Array
    """() mean variance of the residuals over N_lag: a third of the trace of `noise`."""
    valid: Array
    """() bool, whether every unknown is determined."""
    status: Array
    """() int32, `OK`, `NON_FINITE`, or `OUT_OF_RANGE` (state as before)."""


def init(params: Params, *, key: Array | None = None, lag: int = 100) -> State:
    """Return the state that has seen nothing, in the dtype of the parameters.

    Args:
        params: the filter's parameters.
        key: not used.
        lag: N_lag, static: residuals that their covariance is taken over.

    Returns:
        The state.

    Raises:
        ValueError: `lag` is below 3.
    """
    if lag < 3:
        raise ValueError(f"lag: got {lag}, expected at least 3")
    dtype = jnp.result_type(*params)
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    none = jnp.zeros((), jnp.int32)
    information, projection, queue, block, blocks = (
        jnp.zeros(shape, dtype) for shape in ((3, 3), (3,), (lag, 3), (9,), (9, 9))
    )
    return apart(State(information, projection, projection, queue, block, blocks, none > 0, none, none))


Start = Callable[[Array, Array], tuple[Array, Array]]


def patient(noise: Array, full: Array) -> tuple[Array, Array]:
    """Weigh all alike until the queue is full, then rescale what came so far by the mean variance.

    A covariance of a few residuals, of estimates that those residuals made, would give single steps any weight.

    Args:
        noise: (3, 3) covariance of the residuals.
        full: () bool, whether the queue is.

    Returns:
        The weight (3, 3), and whether it is to be rescaled later.
    """
    return jnp.where(full[None, None], inverse3(noise), eye(3, noise[0, 0])), ~full


def unweighted(noise: Array, full: Array) -> tuple[Array, Array]:
    """Weigh all alike for ever; the covariance is still that of the residuals. Arguments as for `patient`."""
    return eye(3, noise[0, 0]), jnp.ones_like(full)


def pseudo_inverse(noise: Array, full: Array) -> tuple[Array, Array]:
    """Weigh by the pseudo-inverse from the first residual on, as the paper does; arguments as for `patient`."""
    wide = jnp.zeros((4, 4), noise.dtype).at[:3, :3].set(noise)
    values, vectors = eigen4(wide)
    real = values > 1e-3 * jnp.sqrt(jnp.finfo(noise.dtype).eps) * jnp.max(values)
    inverse = product(vectors * jnp.where(real, 1 / jnp.where(real, values, 1), 0)[None, :], vectors.T)
    return inverse[:3, :3], jnp.zeros_like(full)


def step(
    params: Params,
    state: State,
    measurement: Observation,
    *,
    key: Array | None = None,
    block: int = 50,
    start: Start = patient,
) -> tuple[State, Info]:
    """Take in one observation.

    Args:
        params: forgetting, prior and floor.
        state: as `init` or the previous step returned it.
        measurement: one observation; without either of its readings nothing changes and nothing is forgotten.
        key: not used.
        block: static, valid steps in a block; several times the correlation of the residuals, such as a filter's
            window.
        start: static, how residuals become a weight: `patient`, `pseudo_inverse` or `unweighted`.

    Returns:
        The next state and the estimate.

    Raises:
        ValueError: a shape is wrong or the block is empty.

    Source: Sato 2024, Algorithm 1, residuals queued as they came, P^-1[n] = gamma P^-1[n-1] + O' C^-1 O.
    """
    if block < 1:
        raise ValueError(f"block: got {block}, expected at least 1")
    o, y, noisy, there, status = usable(measurement, state.projection.dtype)
    moved, known = advance(params, state, (o, y, noisy, there), block=block, start=start)
    found = solved(params, moved, known.variance)
    return within_range(state, moved._replace(estimate=found[0]), read(moved, found, known, status, block=block))


class Residuals(NamedTuple):
    """What the newest residuals say."""

    newest: Array
    """(3,) y - O x with the estimate before; 0 where there is nothing."""
    noise: Array
    """(3, 3) covariance over N_lag."""
    variance: Array
    """() mean variance over N_lag."""


def advance(
    params: Params, state: State, observed: tuple[Array, Array, Array, Array], *, block: int, start: Start,
    go: Array | None = None,
) -> tuple[State, Residuals]:  # fmt: skip
    """Take in one observation without reading the estimate.

    Args:
        params: as for `step`.
        state: as for `step`; residuals are of its `estimate`. Axes behind are batches, here and in `observed`.
        observed: O (3, 3), y (3,), noise term (3, 3) and whether they are there (), zeros where not; as from `usable`.
        block: as for `step`.
        start: as for `step`.
        go: as `_small.held` has it, for a batch behind.

    Returns:
        The next state, its estimate still the former, and the residuals.
    """
    o, y, noisy, there = observed
    dtype = state.projection.dtype
    gamma, floor = (jnp.asarray(x, dtype) for x in (params.forgetting, params.floor))
    residual = jnp.where(there[None], y - applied(o, state.estimate), 0)
    queue = jnp.where(there[None, None], jnp.concatenate([state.queue[1:], residual[None]]), state.queue)
    seen = state.seen + there.astype(jnp.int32)
    noise, unit = _noise(queue, seen, floor), _unit(queue, seen, floor)
    weight, pending = start(noise, seen >= queue.shape[0])
    pending = jnp.where(there, pending, state.pending)
    ratio = jnp.where(state.pending & ~pending, 1 / unit, 1)
    # What is added is zero where nothing came: the regressor and the target are.
    weighted = product(weight, o)
    gain = product(transposed(o), weighted) - jnp.where(there, trace(weight) / 3, 0)[None, None] * noisy
    moved = turned_back(weighted, y)
    kept = jnp.where(there, gamma, 1) * ratio
    part = ratio[None] * state.block + jnp.concatenate([moved, gain[0], gain[1, 1:], gain[2, 2:]])
    whole = there & (seen % block == 0)

    def add(blocks: Array) -> Array:
        return (kept * kept)[None, None] * blocks + jnp.where(whole[None, None], outer(part, part), 0)

    # Most steps end no block of a batch's.
    some = None if go is None else jnp.any(whole | (kept != 1))
    blocks = add(state.blocks) if some is None else jax.lax.cond(some, add, lambda x: x, state.blocks)
    state = State(
        kept[None, None] * state.information + gain, kept[None] * state.projection + moved, state.estimate, queue,
        jnp.where(whole[None], 0, part), blocks, pending, seen, state.index + 1,
    )  # fmt: skip
    return state, Residuals(residual, noise, unit)


def _noise(queue: Array, seen: Array, floor: Array) -> Array:
    """Covariance of the residuals in the queue; zeros that pad it at the start do not count."""
    count = jnp.clip(seen, 2, queue.shape[0]).astype(queue.dtype) - 1
    squares = jnp.sum(queue[:, :, None] * queue[:, None, :], axis=0) / count[None, None]
    return squares + (floor * floor)[None, None] * eye(3, squares[0, 0])


def _unit(queue: Array, seen: Array, floor: Array) -> Array:
    """Mean variance of the residuals in the queue."""
    count = jnp.clip(seen, 2, queue.shape[0]).astype(queue.dtype)
    return jnp.sum(queue * queue, axis=(0, 1)) / (3 * (count - 1)) + floor * floor


def solved(params: Params, state: State, unit: Array) -> tuple[Array, Array]:
    """Return the estimate (3,) and P (3, 3) with the prior, 0 where something is not determined.

    P wants to be multiplied by the residuals' variance `unit` () while that is pending. Axes behind are batches.
    """
    prior = jnp.asarray(params.prior, state.projection.dtype)
    extra = jnp.where(prior > 0, 1 / jnp.where(prior > 0, prior, 1) ** 2, 0)[None, None]
    one = eye(3, state.projection[0])
    ratio = jnp.where(state.pending, 1 / unit, 1)[None, None]
    information = state.information * ratio
    found = inverse3((information + transposed(information)) / 2 + extra * one) * ratio
    return applied(found, state.projection), found


def read(state: State, found: tuple[Array, Array], residuals: Residuals, status: Array, *, block: int) -> Info:
    """Return the info of what `solved` found; axes behind are batches."""
    (estimate, scaled), (residual, noise, unit) = found, residuals
    formal = scaled * jnp.where(state.pending, unit, 1)[None, None]
    # A block's score at the newest estimate is Q_b - P_b^-1 x.
    reading = jnp.concatenate([eye(3, unit) + jnp.zeros_like(scaled), -_rows(estimate)], axis=1)
    meat = sandwich(reading, state.blocks)
    count = state.seen // block
    scale = (count / jnp.maximum(count - 1, 1)).astype(unit.dtype)[None, None]
    covariance = sandwich(scaled, meat * scale)  # P is symmetric
    covariance = jnp.where((count >= 8)[None, None], (covariance + transposed(covariance)) / 2, formal)
    return Info(estimate, covariance, formal, residual, noise, unit, trace(formal) > 0, status)


def _rows(x: Array) -> Array:
    """Matrix (3, 6) that takes the upper triangle of a symmetric (3, 3), row by row, to its product with x."""
    a, b, c = x
    zero = jnp.zeros_like(a)
    entries = [a, b, c, zero, zero, zero, zero, a, zero, b, c, zero, zero, zero, a, zero, b, c]
    return jnp.stack(entries).reshape((3, 6, *a.shape))


def usable(measurement: Observation, dtype: Any) -> tuple[Array, Array, Array, Array, Array]:
    """Return O, y and the noise term with 0 where missing, whether they are there, and the status.

    Raises:
        ValueError: a shape is wrong.
    """
    o, y = (jnp.asarray(x.value, dtype) for x in measurement[:2])
    flags = [jnp.asarray(x.valid, bool) for x in measurement[:2]]
    noisy = jnp.asarray(measurement.regressor_noise, dtype)
    shapes = [x.shape for x in (o, y, noisy, *flags)]
    if shapes != [(3, 3), (3,), (3, 3), (), ()]:
        raise ValueError(
            f"measurement: got shapes {shapes} for regressor, target, regressor_noise and the two valid, expected "
            "(3, 3), (3,), (3, 3), (), (); vmap or run adds other axes"
        )
    finite, timely = [jnp.all(jnp.isfinite(x)) for x in (o, y)], elapsed(measurement.dt)[1]
    there = flags[0] & flags[1] & finite[0] & finite[1] & jnp.all(jnp.isfinite(noisy)) & timely
    broken = ~timely | (flags[0] & ~finite[0]) | (flags[1] & ~finite[1])
    status = jnp.where(broken, NON_FINITE, OK).astype(jnp.int32)
    o, y, noisy = (jnp.where(there, x, 0) for x in (o, y, noisy))
    return o, y, noisy, there, status


__all__ = [
    "Info",
    "Observation",
    "Params",
    "Residuals",
    "Start",
    "State",
    "Triangle",
    "advance",
    "init",
    "patient",
    "pseudo_inverse",
    "read",
    "solved",
    "square_root_step",
    "step",
    "unweighted",
    "usable",
]
