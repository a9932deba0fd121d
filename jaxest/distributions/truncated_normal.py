"""A normal number that must lie within bounds; elementwise over any shape.

Either bound may be infinite. All is accurate however far the bounds are from the mode, in float32 too: what lies in a
tail is measured from the bound next to the mode, so that nothing vanishes or cancels.

Source: the tail integrals are Mills' ratio M(a) = (1 - Phi(a)) / phi(a) (Abramowitz and Stegun 26.2).
"""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erf, erfcx, erfinv

from jaxest.distributions._checks import fits, floating
from jaxest.types import Array, ArrayLike

_ROOT2 = math.sqrt(2.0)
_LOG_ROOT_TURN = 0.5 * math.log(2 * math.pi)
_NODES, _WEIGHTS = ((x + 1) / 2 if i == 0 else x / 2 for i, x in enumerate(np.polynomial.legendre.leggauss(8)))


class _Frame(NamedTuple):
    """The interval [a, b] in units of the scale, turned so that it reaches further to the right than to the left."""

    a: Array
    b: Array
    d: Array  # b - a, from the bounds themselves: the difference of large a and b would lose it
    flip: Array
    tail: Array  # the mode lies outside


@jax.custom_jvp
def _mills(a: Array) -> Array:
    """Return M(a) for a >= 0, its derivative being -_excess(a)."""
    return math.sqrt(math.pi / 2) * erfcx(a / _ROOT2)


def _excess(a: Array) -> Array:
    """Return 1 - a M(a), the integral of t exp(-a t - t^2 / 2), from a continued fraction where that cancels."""
    far = a > 4
    large = jnp.where(far, a, 4.0)
    fraction = jnp.zeros_like(a)
    for n in range(24, 1, -1):
        fraction = n / (large + fraction)
    rest = 1 / (large + fraction)
    near = jnp.where(far, 0.0, a)
    return jnp.where(far, rest / (large + rest), 1 - near * _mills(near))


@_mills.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    return _mills(*primals), -_excess(*primals) * tangents[0]


def _frame(location: Array, scale: Array, low: Array, high: Array) -> _Frame:
    left, right = (_standard(bound, location, scale) for bound in (low, high))
    flip = left + right < 0
    a, b = jnp.where(flip, -right, left), jnp.where(flip, -left, right)
    bounded = jnp.isfinite(low) & jnp.isfinite(high)
    width = jnp.where(bounded, high, 1.0) - jnp.where(bounded, low, 0.0)
    return _Frame(a, b, jnp.where(bounded, width / scale, jnp.inf), flip, a > 0)


def _standard(bound: Array, location: Array, scale: Array) -> Array:
    """Return (bound - location) / scale; an infinite bound stays and has no derivative, instead of NaN."""
    finite = jnp.isfinite(bound)
    return jnp.where(finite, (jnp.where(finite, bound, 0.0) - location) / scale, bound)


def _drop(a: Array, t: Array) -> Array:
    """Return a t + t^2 / 2, the log of phi(a) / phi(a + t)."""
    return t * (a + t / 2)


def _short(a: Array, t: Array, power: int = 0) -> Array:
    """Return the integral over [0, t] of s^power exp(-a s - s^2 / 2) where the exponent stays within about 1."""
    parts = (w * (x * t) ** power * jnp.exp(-_drop(a, x * t)) for x, w in zip(_NODES, _WEIGHTS, strict=True))
    return t * functools.reduce(jnp.add, parts)


class _Tail(NamedTuple):
    """Integrals over [a, b] of the density relative to that at a >= 0."""

    a: Array
    d: Array  # finite; 1 where the tail is infinite, with `left` 0
    narrow: Array  # the density falls by less than e
    left: Array  # phi(b) / phi(a)
    mass: Array
    first: Array  # of the distance from a


def _tail(frame: _Frame) -> _Tail:
    a = jnp.where(frame.tail, frame.a, 1.0)
    bounded = jnp.isfinite(frame.d)
    d = jnp.where(frame.tail & bounded, frame.d, 1.0)
    drop = _drop(a, d)
    narrow = bounded & (drop <= 1)
    left = jnp.where(bounded, jnp.exp(-drop), 0.0)
    short = jnp.where(narrow, d, 0.0)
    mass = jnp.where(narrow, _short(a, short), _mills(a) - left * _mills(a + d))
    far = _excess(a) - left * (_excess(a + d) + d * _mills(a + d))
    return _Tail(a, d, narrow, left, mass, jnp.where(narrow, _short(a, short, 1), far))


def _inside(frame: _Frame) -> tuple[Array, Array]:
    """Return erf(a / sqrt 2) and erf(b / sqrt 2) of an interval around the mode, harmless ones elsewhere."""
    a, b = jnp.where(frame.tail, -1.0, frame.a), jnp.where(frame.tail, 1.0, frame.b)
    return erf(a / _ROOT2), erf(b / _ROOT2)


def log_prob(x: ArrayLike, location: ArrayLike, scale: ArrayLike, low: ArrayLike, high: ArrayLike) -> Array:
    """Return the log density.

    Args:
        x: (...).
        location: (...) mode of the normal density without bounds, in the unit of x.
        scale: (...) its standard deviation, positive.
        low: (...) lower bound, or -infinity.
        high: (...) upper bound, above `low`, or infinity.

    Returns:
        (...); -infinity outside the bounds.

    Raises:
        ValueError: the shapes do not fit together.
    """
    x, location, scale, low, high = floating(x=x, location=location, scale=scale, low=low, high=high)
    frame = _frame(location, scale, low, high)
    tail = _tail(frame)
    inside = (x >= low) & (x <= high)
    x = jnp.where(inside, x, jnp.where(frame.flip, high, low))
    bound = jnp.where(frame.tail, jnp.where(frame.flip, high, low), x)  # finite wherever there is a tail
    t = jnp.where(frame.flip, bound - x, x - bound) / scale
    z = jnp.where(frame.tail | ~inside, 0.0, (x - location) / scale)
    left, right = _inside(frame)
    within = -z * z / 2 - _LOG_ROOT_TURN - jnp.log((right - left) / 2)
    value = jnp.where(frame.tail, -_drop(tail.a, t) - jnp.log(tail.mass), within) - jnp.log(scale)
    return jnp.where(inside, value, -jnp.inf)


def mean(location: ArrayLike, scale: ArrayLike, low: ArrayLike, high: ArrayLike) -> Array:
    """Return the mean (...) of the bounded number; arguments as in `log_prob`."""
    location, scale, low, high = floating(location=location, scale=scale, low=low, high=high)
    frame = _frame(location, scale, low, high)
    tail = _tail(frame)
    step = scale * tail.first / tail.mass
    left, right = _inside(frame)
    centre = (_density(frame.a) - _density(frame.b)) * 2 / (right - left)
    sign = jnp.where(frame.flip, -1.0, 1.0).astype(scale.dtype)
    bound = jnp.where(frame.tail, jnp.where(frame.flip, high, low), 0.0)
    return jnp.where(frame.tail, bound + sign * step, location + sign * scale * centre)


def entropy(location: ArrayLike, scale: ArrayLike, low: ArrayLike, high: ArrayLike) -> Array:
    """Return the differential entropy (...), nat; arguments as in `log_prob`."""
    location, scale, low, high = floating(location=location, scale=scale, low=low, high=high)
    frame = _frame(location, scale, low, high)
    tail = _tail(frame)
    drop = (1 - tail.d * tail.left / tail.mass + tail.a * tail.first / tail.mass) / 2
    left, right = _inside(frame)
    a, b = (jnp.where(jnp.isfinite(v), v, 0.0) for v in (frame.a, frame.b))
    square = 1 + (a * _density(frame.a) - b * _density(frame.b)) * 2 / (right - left)
    within = _LOG_ROOT_TURN + jnp.log((right - left) / 2) + square / 2
    return jnp.log(scale) + jnp.where(frame.tail, jnp.log(tail.mass) + drop, within)


def _density(z: Array) -> Array:
    """Return the standard normal density."""
    return jnp.exp(-z * z / 2 - _LOG_ROOT_TURN)


def sample(
    key: Array,
    location: ArrayLike,
    scale: ArrayLike,
    low: ArrayLike,
    high: ArrayLike,
    shape: tuple[int, ...] | int | None = None,
) -> Array:
    """Draw numbers by inverting the distribution function; one uniform number a draw.

    Args:
        key: random key.
        location: as in `log_prob`, broadcast to `shape`.
        scale: as in `log_prob`, broadcast to `shape`.
        low: as in `log_prob`, broadcast to `shape`.
        high: as in `log_prob`, broadcast to `shape`.
        shape: the sample's whole shape, static; None for that of the parameters.

    Returns:
        (*shape), within the bounds.

    Raises:
        ValueError: the parameters do not broadcast to `shape`.
    """
    location, scale, low, high = floating(location=location, scale=scale, low=low, high=high)
    whole = fits(shape, parameters=location.shape)
    location, scale, low, high = (jnp.broadcast_to(x, whole) for x in (location, scale, low, high))
    u = jax.random.uniform(key, whole, location.dtype, minval=float(jnp.finfo(location.dtype).tiny))
    return quantile(u, location, scale, low, high)


@jax.jit
def quantile(u: ArrayLike, location: ArrayLike, scale: ArrayLike, low: ArrayLike, high: ArrayLike) -> Array:
    """Return the number with the probability u between it and the bound that is nearer to the mode's side.

    Args:
        u: (...) in (0, 1). Counted from `low`, except where the bounds reach further down from the mode than up:
            there from `high`.
        location: as in `log_prob`.
        scale: as in `log_prob`.
        low: as in `log_prob`.
        high: as in `log_prob`.

    Returns:
        (...), within the bounds.

    Raises:
        ValueError: the shapes do not fit together.
    """
    u, location, scale, low, high = floating(u=u, location=location, scale=scale, low=low, high=high)
    frame = _frame(location, scale, low, high)
    step = scale * _invert(_tail(frame), u)
    left, right = _inside(frame)
    z = _ROOT2 * erfinv(left + u * (right - left))
    sign = jnp.where(frame.flip, -1.0, 1.0).astype(scale.dtype)
    bound = jnp.where(frame.tail, jnp.where(frame.flip, high, low), 0.0)
    return jnp.clip(jnp.where(frame.tail, bound + sign * step, location + sign * scale * z), low, high)


def _invert(tail: _Tail, u: Array) -> Array:
    """Return the distance from a below which the probability is u: Newton's method.

    Where the density falls far, on the log of the probability that is left, which is nearly a parabola.
    """
    a, mills = tail.a, _mills(tail.a)
    rest = tail.left * _mills(a + tail.d) / mills
    wanted = -jnp.log1p(-u * (1 - rest))
    hazard = 1 / mills
    bend = hazard * hazard * _excess(a)  # the hazard's slope h (h - a)
    start = 2 * wanted / (hazard + jnp.sqrt(hazard * hazard + 2 * bend * wanted))
    t = jnp.where(tail.narrow, u * tail.d, start)

    def newton(_: int, t: Array) -> Array:
        here = _mills(a + t)
        wide = t - (_drop(a, t) - jnp.log(here / mills) - wanted) * here
        short = jnp.where(tail.narrow, t, 0.0)
        narrow = short - (_short(a, short) - u * tail.mass) * jnp.exp(_drop(a, short))
        return jnp.maximum(jnp.where(tail.narrow, narrow, wide), 0.0)

    return jax.lax.fori_loop(0, 4, newton, t)


__all__ = ["entropy", "log_prob", "mean", "quantile", "sample"]
