"""Savitzky-Golay filter on real time stamps: value and derivative of several channels at any time within a window.

A polynomial of degree M is fitted to the 2 N + 1 samples of a window by discrete orthogonal polynomials (the three-term
recurrence of Stieltjes, time scaled by the window), which is the QR factor of the Vandermonde matrix in closed form: no
normal equations, no LAPACK, missing samples are weights of zero. `step` streams, `smooth` takes a whole recording and
queries it anywhere; both give the same numbers, for both are `weights` on the same window.

Source: Sato 2024, section III-C, eqs. 21 to 24 and Fig. 3; Forsythe 1957 (orthogonal polynomials).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxest.filters._savitzky_golay_recording import Smoothed, smooth, windows
from jaxest.filters._savitzky_golay_weights import Weights, averaging, evaluate, weights
from jaxest.filters._state import apart
from jaxest.filters._time import elapsed
from jaxest.types import NON_FINITE, OK, Array, ArrayLike, Reading


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
    seen = jnp.zeros(width, bool)
    return apart(State(age, jnp.zeros((width, channels), dtype), seen, age, jnp.zeros((), jnp.int32)))


def push(state: State, value: Array, valid: Array, dt: Array) -> State:
    """Let a step come and the oldest go.

    Args:
        state: the window; axes behind, in all arguments, are batches.
        value: (C,) finite.
        valid: () bool.
        dt: () s, since the previous step.

    Returns:
        The next window.
    """
    age, elapsed = state.age + dt[None], state.elapsed + dt[None]
    fresh = jnp.where(valid, 0, jnp.where(jnp.any(state.valid, axis=0), age[-1], 0))
    kept = jnp.where(valid[None], value, state.value[-1])
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


def usable(measurement: Sample, channels: int, dtype: Any) -> tuple[Array, Array, Array, Array]:
    """Return the sample's value with 0 where missing, whether it is there, dt and the status; ValueError for shapes."""
    value = jnp.asarray(measurement.signal.value, dtype)
    valid, dt = jnp.asarray(measurement.signal.valid, bool), jnp.asarray(measurement.dt, dtype)
    if value.shape != (channels,) or valid.shape != () or dt.shape != ():
        raise ValueError(
            f"measurement: got shapes {value.shape}, {valid.shape} and {dt.shape} for value, valid and dt, expected "
            f"({channels},), () and (); vmap or run adds other axes"
        )
    finite, (dt, timely) = jnp.all(jnp.isfinite(value)), elapsed(dt)
    there = valid & finite & timely
    status = jnp.where((valid & ~finite) | ~timely, NON_FINITE, OK).astype(jnp.int32)
    return jnp.where(there, value, 0), there, dt, status


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
