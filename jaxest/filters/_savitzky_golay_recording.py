"""Polynomials fitted to a whole recording, at any times."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.filters._savitzky_golay_weights import evaluate, weights
from jaxest.types import Array, ArrayLike, InputError

PADDING = 512
"""`smooth` compiles for numbers of queries that are multiples of this."""


class Smoothed(NamedTuple):
    """The fit at each of Q times."""

    value: Array
    """(Q, C)"""
    derivative: Array
    """(Q, C) per second."""
    value_gain: Array
    """(Q,) as in `Info`."""
    derivative_gain: Array
    """(Q,) 1/s^2, as in `Info`."""
    valid: Array
    """(Q,) bool: a full window, more samples than the degree, and a time that needed no clamp."""


def smooth(
    time: ArrayLike,
    value: ArrayLike,
    valid: ArrayLike | None = None,
    query: ArrayLike | None = None,
    *,
    half_width: int = 7,
    degree: int = 3,
) -> Smoothed:
    """Fit a recording at given times, each within the window about the nearest sample.

    This brings a sensor to another's clock: query its recording at the other's stamps. Stamps are handled on the host
    in float64; the fit is differentiable in `value`.

    Args:
        time: (T,) s, increasing, host data.
        value: (T, C).
        valid: (T,) bool; all if None.
        query: (Q,) s, host data; `time` if None.
        half_width: N.
        degree: M.

    Returns:
        The fits, in the dtype of `value`.

    Raises:
        InputError: times are not finite or do not increase, or there are fewer samples than a window has.
        ValueError: a shape is wrong, or the window is no longer than the degree.
    """
    stamps = np.asarray(time, np.float64)
    at = stamps if query is None else np.asarray(query, np.float64)
    value = jnp.asarray(value)
    if stamps.ndim != 1 or value.ndim != 2 or len(value) != len(stamps) or at.ndim != 1:
        raise ValueError(f"time, value: got shapes {stamps.shape} and {value.shape}, expected (T,) and (T, C)")
    if not 0 <= degree <= 2 * half_width:
        raise ValueError(f"degree: got {degree}, expected 0 to {2 * half_width} for a half width of {half_width}")
    rows, offset = windows(stamps, at, half_width)
    there = np.ones(len(stamps), bool) if valid is None else np.asarray(valid, bool)
    inside = (at >= stamps[rows[:, 0]]) & (at <= stamps[rows[:, -1]])
    dtype = value.dtype if jnp.issubdtype(value.dtype, jnp.floating) else jnp.result_type(float)
    # Recordings of nearly the same length share a program.
    more = ((0, -len(at) % PADDING), (0, 0))
    rows, offset, there = np.pad(rows, more, "edge"), np.pad(offset, more, "edge"), np.pad(there[rows], more, "edge")
    picked = value[rows] if isinstance(value, jax.core.Tracer) else jnp.asarray(np.asarray(value)[rows])
    found = _smooth(offset.astype(dtype), picked.astype(dtype), there, degree)
    found = jax.tree.map(lambda x: x[: len(at)], found)
    return found._replace(valid=found.valid & inside)


@partial(jax.jit, static_argnums=3)
def _smooth(offset: Any, value: Array, valid: Any, degree: int) -> Smoothed:
    def one(offset: Array, value: Array, valid: Array) -> Smoothed:
        fit = weights(offset, valid, 0.0, degree=degree)
        return Smoothed(*evaluate(fit, jnp.where(valid[:, None], value, 0)), fit.samples > degree)

    found: Smoothed = jax.vmap(one)(offset, value, valid)
    return found


def windows(time: NDArray[Any], query: NDArray[Any], half_width: int) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Choose each query's window: the sample nearest to it and N to either side, moved inwards at the ends.

    Args:
        time: (T,) s, float64, increasing.
        query: (Q,) s.
        half_width: N.

    Returns:
        Rows (Q, 2 N + 1) and their times (Q, 2 N + 1) relative to the query, s.

    Raises:
        InputError: times are not finite or do not increase, or there are too few.
    """
    width = 2 * half_width + 1
    if not np.isfinite(query).all():
        raise InputError(f"query: row {int(np.argmin(np.isfinite(query)))} is not finite")
    if len(time) < width:
        raise InputError(f"time: got {len(time)} samples, expected at least {width}, the length of a window")
    wrong = np.flatnonzero(~(np.diff(time) > 0))
    if not np.isfinite(time).all() or len(wrong):
        row = int(wrong[0]) + 1 if len(wrong) else int(np.argmin(np.isfinite(time)))
        raise InputError(f"time: row {row} is {time[row]} after {time[row - 1]}, expected finite and increasing stamps")
    right = np.clip(np.searchsorted(time, query), 1, len(time) - 1)
    nearest = np.where(query - time[right - 1] <= time[right] - query, right - 1, right)
    centre = np.clip(nearest, half_width, len(time) - 1 - half_width)
    rows = centre[:, None] + np.arange(-half_width, half_width + 1)
    return rows, time[rows] - query[:, None]


__all__ = ["Smoothed", "smooth", "windows"]
