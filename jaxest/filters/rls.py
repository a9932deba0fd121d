"""Recursive least squares for vector observations y = O x + noise, with a covariance that can be believed.

`step` keeps the information form of Sato 2024, Algorithm 1, and goes past it in two ways. Regressors that are
themselves noisy shrink the estimate; what their noise adds to the information on average is taken off again. Residuals
of overlapping windows are correlated; the covariance is therefore that of the sums of whole blocks of steps, each
longer than the correlation, evaluated at the newest estimate. `square_root_step` is the same recursion without either,
on a triangular factor: half the digits suffice.

Source: Sato 2024, eqs. 16 to 20 and Algorithm 1, with the forgetting on the old terms; Moon and Stirling 2000, section
4.11.1; Fuller 1987 (Measurement Error Models), section 2.2; Newey and West 1987 for the sandwich.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxest.filters._rls_root import Triangle, square_root_step
from jaxest.filters._rls_sums import Observation, Params, Residuals, State, advance, init, usable
from jaxest.filters._rls_weights import Start, patient, pseudo_inverse, unweighted
from jaxest.filters._small import applied, eye, inverse3, sandwich, trace, transposed
from jaxest.filters._state import within_range
from jaxest.types import Array


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
