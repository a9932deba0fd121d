"""What the samples of a window count for in a polynomial fitted to it."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxest.types import Array, ArrayLike


class Weights(NamedTuple):
    """Linear combinations of a window's samples; 0 where a sample is missing."""

    value: Array
    """(W,) the fit at the query."""
    derivative: Array
    """(W,) 1/s, the fit's derivative at the query."""
    samples: Array
    """() int32, how many samples are there."""
    inside: Array
    """() bool, whether the query lies between the first and the last of them."""


def weights(time: Array, valid: Array, query: ArrayLike, *, degree: int) -> Weights:
    """Return what a window's samples count for in the fit at one time.

    Args:
        time: (W,) s, any origin, in any order; what stands where a sample is missing does not matter if it is finite.
            Axes behind, in all three arguments, are batches.
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
    if time.ndim < 1 or valid.shape != time.shape:
        raise ValueError(f"time, valid: got shapes {time.shape} and {valid.shape}, expected (W,) both")
    dtype = time.dtype
    there = valid.astype(dtype)
    early = jnp.min(jnp.where(valid, time, jnp.inf), axis=0)
    late = jnp.max(jnp.where(valid, time, -jnp.inf), axis=0)
    some = early <= late
    asked = jnp.asarray(query, dtype)
    at = jnp.clip(asked, jnp.where(some, early, 0), jnp.where(some, late, 0))
    span = jnp.where(late > early, late - early, 1)
    span = jnp.where(some, span, 1)
    x = jnp.where(valid, (time - at[None]) / span[None], 0)
    value, slope = _expansion(x, there, degree)
    inside = (early <= asked) & (asked <= late)
    return Weights(value, slope / span[None], jnp.sum(valid, axis=0, dtype=jnp.int32), inside)


def _expansion(x: Array, there: Array, degree: int) -> tuple[Array, Array]:
    """Weights of the value and the derivative at x = 0, summed over orthogonal polynomials."""
    least = (32 * float(jnp.finfo(x.dtype).eps)) ** 2
    zero = jnp.zeros(x.shape[1:], x.dtype)
    before, here = jnp.zeros_like(x), there
    value_before, value_here, slope_before, slope_here = zero, zero + 1, zero, zero
    value, slope, norm_before = jnp.zeros_like(x), jnp.zeros_like(x), zero + 1
    for k in range(degree + 1):
        norm = jnp.sum(here * here, axis=0)
        good = norm > least
        share = jnp.where(good, 1 / jnp.where(good, norm, 1), 0)
        value = value + (value_here * share)[None] * here
        slope = slope + (slope_here * share)[None] * here
        a = jnp.sum(x * here * here, axis=0) * share
        b = jnp.where(good & (k > 0), norm / norm_before, 0)
        here, before = jnp.where(good[None], (x - a[None]) * here - b[None] * before, 0), here
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
    mass = -jnp.cumsum(derivative, axis=0)[:-1] * step
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


def evaluate(fit: Weights, value: Array) -> tuple[Array, Array, Array, Array]:
    """Return value (C,), derivative (C,) and their noise gains () of a window (W, C) with finite entries."""
    columns = [jnp.sum(w[:, None] * value, axis=0) for w in (fit.value, fit.derivative)]
    return columns[0], columns[1], jnp.sum(fit.value**2), jnp.sum(fit.derivative**2)


__all__ = ["Weights", "averaging", "evaluate", "weights"]
