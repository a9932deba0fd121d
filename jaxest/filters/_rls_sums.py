"""What recursive least squares keeps of the observations: sums, and the newest residuals."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters._rls_weights import Start, noise_of, variance_of
from jaxest.filters._small import applied, outer, product, trace, transposed, turned_back
from jaxest.filters._state import apart
from jaxest.filters._time import elapsed
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


class Residuals(NamedTuple):
    """What the newest residuals say."""

    newest: Array
    """(3,) y - O x with the estimate before; 0 where there is nothing."""
    noise: Array
    """(3, 3) covariance over N_lag."""
    variance: Array
    """() mean variance over N_lag."""


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
    noise, unit = noise_of(queue, seen, floor), variance_of(queue, seen, floor)
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


__all__ = ["Observation", "Params", "Residuals", "State", "advance", "init", "usable"]
