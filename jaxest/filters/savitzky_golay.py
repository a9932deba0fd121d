"""Savitzky-Golay filter on real time stamps: value and derivative of several channels at any time within a window.

A polynomial of degree M is fitted to the 2 N + 1 samples of a window by discrete orthogonal polynomials (the three-term
recurrence of Stieltjes, time scaled by the window), which is the QR factor of the Vandermonde matrix in closed form: no
normal equations, no LAPACK, missing samples are weights of zero. `step` streams, `smooth` takes a whole recording and
queries it anywhere; both give the same numbers, for both are `weights` on the same window.

Source: Sato 2024, section III-C, eqs. 21 to 24 and Fig. 3; Forsythe 1957 (orthogonal polynomials).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.types import NON_FINITE, OK, Array, ArrayLike, InputError, Reading

PADDING = 512
"""`smooth` compiles for numbers of queries that are multiples of this."""


class Params(NamedTuple):
    """What may be tuned or differentiated."""

    shift: ArrayLike = 0.0
    """() s, the query is this much later than the window's centre; clamped to the window."""


class Sample(NamedTuple):
    """One sample of all channels."""

    signal: Reading
    """value (C,) any unit."""
    dt: ArrayLike
    """() s, time since the previous step."""


class Weights(NamedTuple):
    """Linear combinations of a window's samples; 0 where a sample is missing."""

    value: Array
    """(W,) the fit at the query."""
    derivative: Array
    """(W,) 1/s, the fit's derivative at the query."""
    samples: Array
    """() int32, how many samples are there."""


class State(NamedTuple):
    """The window, oldest first; a missing sample holds the time and the value of the one before it."""

    age: Array
    """(W,) s, how long ago a sample came."""
    value: Array
    """(W, C)"""
    valid: Array
    """(W,) bool"""
    elapsed: Array
    """(W,) s, how long ago a step was, whether or not its sample came."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The fit at `delay` before this step."""

    value: Array
    """(C,)"""
    derivative: Array
    """(C,) per second."""
    value_gain: Array
    """() variance of `value` over that of a sample's white noise: sum of squared weights."""
    derivative_gain: Array
    """() 1/s^2, likewise for `derivative`."""
    delay: Array
    """() s, time from the query to this step."""
    valid: Array
    """() bool, whether the window is full and has more samples than the degree."""
    status: Array
    """() int32, `OK` or `NON_FINITE`."""


def weights(time: Array, valid: Array, query: ArrayLike, *, degree: int) -> Weights:
    """Return what a window's samples count for in the fit at one time.

    Args:
        time: (W,) s, any origin, in any order; what stands where a sample is missing does not matter if it is finite.
        valid: (W,) bool.
        query: () s, same origin; clamped to the first and last valid time, nothing is extrapolated.
        degree: M, static. Where fewer than M + 1 samples (or distinct times) are there, the degree is lower.

    Returns:
        The weights; all 0 where no sample is there.

    Raises:
        ValueError: a shape is wrong or the degree negative.

    Source: Sato 2024, eqs. 21 to 23, and Fig. 3 for the clamp.
    """
    if degree < 0:
        raise ValueError(f"degree: got {degree}, expected 0 or more")
    if time.ndim != 1 or valid.shape != time.shape:
        raise ValueError(f"time, valid: got shapes {time.shape} and {valid.shape}, expected (W,) both")
    dtype = time.dtype
    there = valid.astype(dtype)
    early = jnp.min(jnp.where(valid, time, jnp.inf))
    late = jnp.max(jnp.where(valid, time, -jnp.inf))
    some = early <= late
    at = jnp.clip(jnp.asarray(query, dtype), jnp.where(some, early, 0), jnp.where(some, late, 0))
    span = jnp.where(late > early, late - early, 1)
    span = jnp.where(some, span, 1)
    x = jnp.where(valid, (time - at) / span, 0)
    value, slope = _expansion(x, there, degree)
    return Weights(value, slope / span, jnp.sum(valid, dtype=jnp.int32))


def _expansion(x: Array, there: Array, degree: int) -> tuple[Array, Array]:
    """Weights of the value and the derivative at x = 0, summed over orthogonal polynomials."""
    least = (32 * float(jnp.finfo(x.dtype).eps)) ** 2
    zero = jnp.zeros((), x.dtype)
    before, here = jnp.zeros_like(x), there
    value_before, value_here, slope_before, slope_here = zero, zero + 1, zero, zero
    value, slope, norm_before = jnp.zeros_like(x), jnp.zeros_like(x), zero + 1
    for k in range(degree + 1):
        norm = jnp.sum(here * here)
        good = norm > least
        share = jnp.where(good, 1 / jnp.where(good, norm, 1), 0)
        value = value + value_here * share * here
        slope = slope + slope_here * share * here
        a = jnp.sum(x * here * here) * share
        b = jnp.where(good & (k > 0), norm / norm_before, 0)
        here, before = jnp.where(good, (x - a) * here - b * before, 0), here
        slope_here, slope_before = slope_here * (-a) + value_here - b * slope_before, slope_here
        value_here, value_before = value_here * (-a) - b * value_before, value_here
        norm_before = jnp.where(good, norm, 1)
    return value, slope


def averaging(time: Array, derivative: Array) -> Array:
    """Return weights (W,) of the mean that belongs to a derivative.

    A derivative that is a weighted sum of samples is the mean of the true derivative over the window, weighted with
    minus the running sum of the weights. Other signals that are to be compared with such a derivative must be averaged
    in the same way, or the filter's response stays in the comparison. The mean is taken by the trapezoidal rule, with
    its error's leading term taken off by second divided differences: a sine of 4 Hz at 62.5 Hz would come out 1.3 %
    small in any window.

    Args:
        time: (W,) s, not decreasing; where a sample is missing, the time (and, later, the value) of the one before it.
        derivative: (W,) 1/s, from `weights`, 0 where a sample is missing.

    Returns:
        (W,) weights, which sum to 1 where the degree is at least 1.
    """
    step = time[1:] - time[:-1]
    mass = -jnp.cumsum(derivative)[:-1] * step
    half = mass / 2
    nothing = jnp.zeros_like(mass[:1])
    plain = jnp.concatenate([half, nothing]) + jnp.concatenate([nothing, half])
    # An interval's error is its length squared / 12 times the mean bend at its ends, where both can be had.
    fine = (step[1:] > 0) & (step[:-1] > 0)  # not beside a missing sample
    none = jnp.zeros_like(fine[:1])
    ends = jnp.concatenate([none, fine]).astype(step.dtype) + jnp.concatenate([fine, none]).astype(step.dtype)
    bend = mass * step * step / (12 * jnp.where(ends > 0, ends, 1))
    left, right = (jnp.where(fine, x, 1) for x in (step[:-1], step[1:]))
    taken = jnp.where(fine, 2 * (bend[1:] + bend[:-1]) / (left + right), 0)
    before, behind = taken / left, taken / right
    bare = jnp.zeros_like(taken[:1])
    pad = jnp.concatenate
    return plain - pad([before, bare, bare]) + pad([bare, before + behind, bare]) - pad([bare, bare, behind])


def init(params: Params, *, key: Array | None = None, half_width: int = 7, channels: int = 3) -> State:
    """Return the empty window of 2 `half_width` + 1 steps of `channels` channels, in the dtype of the parameters.

    Args:
        params: the filter's parameters.
        key: not used.
        half_width: N, static.
        channels: C, static.

    Returns:
        The state with index 0.

    Raises:
        ValueError: the window has no width.
    """
    if half_width < 1:
        raise ValueError(f"half_width: got {half_width}, expected at least 1")
    dtype = jnp.result_type(*params)
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    width = 2 * half_width + 1
    age = jnp.zeros(width, dtype)
    return State(age, jnp.zeros((width, channels), dtype), jnp.zeros(width, bool), age, jnp.zeros((), jnp.int32))


def push(state: State, value: Array, valid: Array, dt: Array) -> State:
    """Let a step come and the oldest go.

    Args:
        state: the window.
        value: (C,) finite.
        valid: () bool.
        dt: () s, since the previous step.

    Returns:
        The next window.
    """
    age, elapsed = state.age + dt, state.elapsed + dt
    fresh = jnp.where(valid, 0, jnp.where(jnp.any(state.valid), age[-1], 0))
    kept = jnp.where(valid, value, state.value[-1])
    return State(
        jnp.concatenate([age[1:], fresh[None]]),
        jnp.concatenate([state.value[1:], kept[None]]),
        jnp.concatenate([state.valid[1:], valid[None]]),
        jnp.concatenate([elapsed[1:], jnp.zeros_like(elapsed[:1])]),
        state.index + 1,
    )


def step(
    params: Params, state: State, measurement: Sample, *, key: Array | None = None, degree: int = 3
) -> tuple[State, Info]:
    """Take in one sample and fit the window about its centre, N steps ago.

    Args:
        params: where in the window to evaluate the fit.
        state: as `init` or the previous step returned it.
        measurement: one sample.
        key: not used.
        degree: M, static, less than the number of steps in the window.

    Returns:
        The next state and the fit.

    Raises:
        ValueError: a shape is wrong, or the window is no longer than the degree.
    """
    dtype, width, channels = state.age.dtype, *state.value.shape
    if not 0 <= degree < width:
        raise ValueError(f"degree: got {degree}, expected 0 to {width - 1} for a window of {width}")
    value, there, dt, status = usable(measurement, channels, dtype)
    state = push(state, value, there, dt)
    delay = state.elapsed[width // 2] - jnp.asarray(params.shift, dtype)
    fit = weights(-state.age, state.valid, -delay, degree=degree)
    delay = jnp.clip(delay, 0, state.elapsed[0])
    valid = (state.index >= width) & (fit.samples > degree)
    return state, Info(*evaluate(fit, state.value), delay, valid, status)


def evaluate(fit: Weights, value: Array) -> tuple[Array, Array, Array, Array]:
    """Return value (C,), derivative (C,) and their noise gains () of a window (W, C) with finite entries."""
    columns = [jnp.sum(w[:, None] * value, axis=0) for w in (fit.value, fit.derivative)]
    return columns[0], columns[1], jnp.sum(fit.value**2), jnp.sum(fit.derivative**2)


def usable(measurement: Sample, channels: int, dtype: Any) -> tuple[Array, Array, Array, Array]:
    """Return the sample's value with 0 where missing, whether it is there, dt and the status; ValueError for shapes."""
    value = jnp.asarray(measurement.signal.value, dtype)
    valid, dt = jnp.asarray(measurement.signal.valid, bool), jnp.asarray(measurement.dt, dtype)
    if value.shape != (channels,) or valid.shape != () or dt.shape != ():
        raise ValueError(
            f"measurement: got shapes {value.shape}, {valid.shape} and {dt.shape} for value, valid and dt, expected "
            f"({channels},), () and (); vmap or run adds other axes"
        )
    finite, timed = jnp.all(jnp.isfinite(value)), jnp.isfinite(dt)
    there = valid & finite & timed
    status = jnp.where((valid & ~finite) | ~timed, NON_FINITE, OK).astype(jnp.int32)
    return jnp.where(there, value, 0), there, jnp.where(timed, dt, 0), status


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


__all__ = [
    "Info",
    "Params",
    "Sample",
    "Smoothed",
    "State",
    "Weights",
    "averaging",
    "evaluate",
    "init",
    "push",
    "smooth",
    "step",
    "usable",
    "weights",
    "windows",
]
