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
    in float64; the fit is differentiable in `value`. A whole recording that is evenly spaced to rounding and queried at
    its own stamps is a correlation, several times quicker than a fit for each window.

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
    there = np.ones(len(stamps), bool) if valid is None else np.asarray(valid, bool)
    dtype = value.dtype if jnp.issubdtype(value.dtype, jnp.floating) else jnp.result_type(float)
    if query is None and len(stamps) > 2 * half_width and there.all():
        spacing = even(stamps, 2 * half_width, float(jnp.finfo(dtype).eps))
        if spacing is not None:
            return _correlated(value.astype(dtype), spacing, half_width, degree)
    rows, offset = windows(stamps, at, half_width)
    inside = (at >= stamps[rows[:, 0]]) & (at <= stamps[rows[:, -1]])
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


def even(time: NDArray[Any], steps: int, eps: float) -> float | None:
    """Return the spacing of stamps (T,) s that are even to rounding, theirs or that of `steps` of them; else None."""
    spacing = float(time[-1] - time[0]) / (len(time) - 1)
    line = time[0] + spacing * np.arange(len(time))
    rounding = max(2 * float(np.spacing(np.abs(time).max())), 2 * eps * steps * spacing)
    return spacing if spacing > 0 and bool(np.abs(time - line).max() <= rounding < spacing / 100) else None


def _correlated(value: Array, spacing: float, half_width: int, degree: int) -> Smoothed:
    """Fit an even recording (T, C) at its own stamps."""
    count, library = len(value), jnp if isinstance(value, jax.core.Tracer) else np
    padded = library.pad(library.asarray(value), ((0, -count % PADDING), (0, 0)))
    last = padded[count - 2 * half_width - 1 : count]
    found: Smoothed = _even(padded, last, np.asarray(spacing, value.dtype), np.int32(count), half_width, degree)
    return jax.tree.map(lambda x: x[:count], found)


@partial(jax.jit, static_argnums=(4, 5))
def _even(value: Array, last: Array, spacing: Array, count: Array, half_width: int, degree: int) -> Smoothed:
    """Fits at all rows of `value`, of which `count` are a recording that ends with the window `last`."""
    n, width = half_width, 2 * half_width + 1
    at = jnp.arange(width, dtype=value.dtype)
    offset = spacing * (at[:, None] - at[None])  # of a sample (axis 0) from a query
    fit = weights(offset, jnp.ones(offset.shape, bool), jnp.zeros(width, value.dtype), degree=degree)
    length = len(value) - width + 1
    put = jax.lax.dynamic_update_slice_in_dim

    def over(w: Array) -> Array:
        inner = sum(w[k, n] * value[k : k + length] for k in range(width))
        early, late = (jnp.sum(w[:, :, None] * end[:, None], axis=0) for end in (value[:width], last))
        return put(jnp.concatenate([early[:n], inner, early[:n]]), late[n + 1 :], count - n, axis=0)

    def gain(w: Array) -> Array:
        every = jnp.sum(w**2, axis=0)
        middle = jnp.full(len(value) - n, every[n])
        return put(jnp.concatenate([every[:n], middle]), every[n + 1 :], count - n, axis=0)

    both = fit.value, fit.derivative
    there = jnp.ones(len(value), bool)
    return Smoothed(over(both[0]), over(both[1]), gain(both[0]), gain(both[1]), there)


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
