"""Which particles survive: systematic, stratified, multinomial and residual resampling in O(N).

Weights become whole numbers, ticks, whose total is a power of two times the number of draws. Their cumulative sum is
exact, monotone and the same in whatever order it is added up, which a float32 sum of a million weights is not; a weight
is right to 2^-(31 - log2 N) draws (1e-6 at N = 2048, 5e-4 at a million). Nothing is sorted or searched.

Gradients: indices have none. The weights after resampling are equal in value and carry the derivative of the weights
that were resampled, so that what is computed from them keeps the score's estimate (`filters.particle`).
"""

from functools import cache, partial
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from jaxest.distributions._words import words
from jaxest.manifolds.base import as_array
from jaxest.types import Array, ArrayLike

_BITS = 30  # the total of the ticks stays below 2^30, so that nothing overflows on the way


class Resampled(NamedTuple):
    """Who goes on, and with which weights."""

    ancestors: Array
    """(count,) int32, indices of the particles that go on, in rising order."""
    log_weights: Array
    """(count,) of the particles that go on; their exponentials sum to one."""


class Resampler(Protocol):
    """Chooses particles by their weights."""

    def __call__(self, key: Array, log_weights: ArrayLike, count: int | None = None) -> Resampled:
        """Return the choice; `count` is the number of draws, as many as there are weights if None."""
        ...


class _Ticks(NamedTuple):
    """Cumulative weights in whole numbers."""

    ends: Array
    """(N,) int32, where each particle's share ends; the last is `draws << bits`."""
    bits: int
    """Ticks to a draw are `1 << bits`."""


def normalize(log_weights: ArrayLike) -> tuple[Array, Array, Array]:
    """Scale weights so that they sum to one.

    Args:
        log_weights: (N,) logarithms of weights of any scale; NaN and +inf count as no weight.

    Returns:
        (N,) logarithms of the scaled weights, () the logarithm of the sum, and () bool, whether all had vanished: the
        weights returned are equal then, and the logarithm of the sum is -inf.

    Raises:
        ValueError: the shape is another.
    """
    given = as_array("log_weights", log_weights, None)
    usable = jnp.isfinite(given)
    vanished = ~jnp.any(usable)
    safe = jnp.where(usable, given, 0)
    top = jax.lax.stop_gradient(jnp.max(jnp.where(usable, given, -jnp.inf)))
    top = jnp.where(vanished, 0, top)
    weights = jnp.where(usable, jnp.exp(jnp.where(usable, safe - top, 0)), 0)
    total = top + jnp.log(jnp.where(vanished, 1, jnp.sum(weights)))
    equal = jnp.full_like(given, -jnp.log(jnp.asarray(given.shape[0], given.dtype)))
    scaled = jnp.where(usable, safe - total, -jnp.inf)
    return jnp.where(vanished, equal, scaled), jnp.where(vanished, -jnp.inf, total), vanished


def effective_sample_size(log_weights: ArrayLike) -> Array:
    """Return how many equally weighted particles would be worth as much.

    Args:
        log_weights: (N,) logarithms of weights of any scale.

    Returns:
        () (sum w)^2 / sum w^2, from 1 to N; N where all weights have vanished.

    Raises:
        ValueError: the shape is another.
    """
    scaled, _, _ = normalize(log_weights)
    return 1 / jnp.sum(jnp.exp(2 * scaled))


def systematic(key: Array, log_weights: ArrayLike, count: int | None = None) -> Resampled:
    """Resample by one uniform number: equally spaced points with a common random shift.

    Args:
        key: random key.
        log_weights: (N,) logarithms of weights of any scale; equal ones are taken where all have vanished.
        count: number of draws, N if None; static.

    Returns:
        Who goes on; each particle floor(n w) or ceil(n w) times in n draws, n w times on average.

    Raises:
        ValueError: a shape is wrong, or `count` below 1.
    """
    ticks, count = _ticks(log_weights, count)
    shift = _uniform(key, (), ticks.bits)
    ends = (ticks.ends - shift + ((1 << ticks.bits) - 1)) >> ticks.bits
    return _resampled(log_weights, _ancestors(ends, count))


def stratified(key: Array, log_weights: ArrayLike, count: int | None = None) -> Resampled:
    """Resample by one uniform number in each of n equal strata.

    Args:
        key: random key.
        log_weights: (N,) logarithms of weights of any scale; equal ones are taken where all have vanished.
        count: number of draws, N if None; static.

    Returns:
        Who goes on, n w times on average.

    Raises:
        ValueError: a shape is wrong, or `count` below 1.

    Source: Sato 2023, section III-A.
    """
    ticks, count = _ticks(log_weights, count)
    points = _uniform(key, (count,), ticks.bits)
    stratum = ticks.ends >> ticks.bits
    rest = ticks.ends & ((1 << ticks.bits) - 1)
    ends = stratum + (points.at[stratum].get(mode="clip") < rest)  # beyond the last stratum nothing is left over
    return _resampled(log_weights, _ancestors(ends, count))


def multinomial(key: Array, log_weights: ArrayLike, count: int | None = None) -> Resampled:
    """Resample by n independent draws.

    Args:
        key: random key.
        log_weights: (N,) logarithms of weights of any scale; equal ones are taken where all have vanished.
        count: number of draws, N if None; static.

    Returns:
        Who goes on, in rising order, n w times on average, with a variance of n w (1 - w).

    Raises:
        ValueError: a shape is wrong, or `count` below 1.
    """
    ticks, count = _ticks(log_weights, count)
    points = _sorted_points(key, count, jnp.int32(count), ticks.bits)
    return _resampled(log_weights, _ancestors(_count_below(points, ticks, count), count))


def residual(key: Array, log_weights: ArrayLike, count: int | None = None) -> Resampled:
    """Keep each particle floor(n w) times for certain, and draw the rest independently from what is left.

    Args:
        key: random key.
        log_weights: (N,) logarithms of weights of any scale; equal ones are taken where all have vanished.
        count: number of draws, N if None; static.

    Returns:
        Who goes on, n w times on average.

    Raises:
        ValueError: a shape is wrong, or `count` below 1.

    Source: Liu and Chen 1998 (Sequential Monte Carlo methods for dynamic systems), section 3.2.
    """
    ticks, count = _ticks(log_weights, count)
    shares = jnp.diff(ticks.ends, prepend=jnp.zeros(1, ticks.ends.dtype))
    certain = jnp.cumsum(shares >> ticks.bits)
    left = jnp.cumsum(shares & ((1 << ticks.bits) - 1))
    points = _sorted_points(key, count, left[-1] >> ticks.bits, ticks.bits)
    drawn = _count_below(points, _Ticks(left, ticks.bits), count)
    return _resampled(log_weights, _ancestors(certain + drawn, count))


@cache
def adaptive(resample: Resampler, threshold: float = 0.5) -> Resampler:
    """Resample only where the effective sample size has fallen below a share of the particles.

    Args:
        resample: what to do then; static.
        threshold: share of N, from 0 (never) to 1; static.

    Returns:
        The resampler, the same object for the same arguments; it keeps the number of particles. Otherwise every
        particle goes on with its own weight. (Under `vmap` both are computed and one is chosen.)

    Raises:
        ValueError: the threshold lies outside [0, 1].
    """
    if not 0 <= threshold <= 1:
        raise ValueError(f"threshold: got {threshold}, expected a share from 0 to 1")
    return partial(_adaptive, resample, float(threshold))


def _adaptive(
    resample: Resampler, threshold: float, key: Array, log_weights: ArrayLike, count: int | None = None
) -> Resampled:
    scaled, _, _ = normalize(log_weights)
    size = scaled.shape[0]
    if count not in (None, size):
        raise ValueError(
            f"count: got {count}, expected {size}, the number of weights, where resampling may be left out"
        )

    def keep(scaled: Array) -> Resampled:
        return Resampled(jnp.arange(size, dtype=jnp.int32), scaled)

    few = threshold * size * jnp.sum(jnp.exp(2 * scaled)) > 1
    return jax.lax.cond(few, lambda scaled: resample(key, scaled), keep, scaled)


def _ticks(log_weights: ArrayLike, count: int | None) -> tuple[_Ticks, int]:
    """Cumulative weights in whole numbers, and the number of draws."""
    scaled, _, _ = normalize(jax.lax.stop_gradient(log_weights))
    count = scaled.shape[0] if count is None else count
    if count < 1:
        raise ValueError(f"count: got {count}, expected at least 1")
    bits = _BITS - (count - 1).bit_length()
    if bits < 1:
        raise ValueError(f"count: got {count}, expected at most {1 << (_BITS - 1)} draws")
    return _Ticks(_whole(jnp.exp(scaled), jnp.int32(count << bits)), bits), count


def _whole(shares: Array, total: Array) -> Array:
    """Cumulative sums (N,) int32 of shares that sum to about one, in whole numbers, the last exactly `total`.

    Rounded shares sum to `total` but for rounding; the rest is spread in proportion. A share of 0 stays 0.
    """
    ends = jnp.cumsum(jnp.round(shares * total.astype(shares.dtype)).astype(jnp.int32))
    last = jnp.maximum(ends[-1], 1)
    excess = ((total - last) / last).astype(shares.dtype)
    moved = ends + jnp.floor(ends.astype(shares.dtype) * excess).astype(jnp.int32)
    return jnp.where(ends == ends[-1], total, jnp.minimum(moved, total))


def _uniform(key: Array, shape: tuple[int, ...], bits: int) -> Array:
    """Whole numbers, uniform in [0, 2^bits)."""
    return (words(key, shape) >> (32 - bits)).astype(jnp.int32)


def _sorted_points(key: Array, count: int, wanted: Array, bits: int) -> Array:
    """The first `wanted` of (count,) are uniform in [0, wanted << bits) and sorted, the others beyond all ticks."""
    gaps = jax.random.exponential(key, (count + 1,), jnp.float32)
    inside = jnp.arange(count + 1) <= wanted
    gaps = jnp.where(inside, gaps, 0)
    points = _whole(gaps / jnp.sum(gaps), wanted << bits)[:count]
    return jnp.where(inside[1:], points, jnp.iinfo(jnp.int32).max)


def _count_below(points: Array, ticks: _Ticks, count: int) -> Array:
    """How many of the sorted points lie below each particle's end, (N,).

    Points are uniform, so no draw's width holds many of them whatever the weights are (7 of 2048, 10 of a million):
    those of the widths before are known from their cumulative count, the others are looked at one after the other.
    """
    beyond = points == jnp.iinfo(jnp.int32).max
    width = jnp.where(beyond, count, points >> ticks.bits)
    held = jnp.zeros(count + 1, jnp.int32).at[width].add(1, mode="drop", indices_are_sorted=True)
    first = jnp.cumsum(held) - held
    below = first[ticks.ends >> ticks.bits]

    def any_left(carry: tuple[Array, Array]) -> Array:
        return jnp.any(carry[1])

    def look(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        below, going = carry
        going = going & (below < count) & (points.at[below].get(mode="clip") < ticks.ends)
        return below + going, going

    return jax.lax.while_loop(any_left, look, (below, jnp.ones(below.shape, bool)))[0]


def _ancestors(ends: Array, count: int) -> Array:
    """Indices (count,) of particles that hold the draws up to `ends` (N,), which rise to `count`."""
    starts = jnp.zeros(count, jnp.int32).at[ends].add(1, mode="drop", indices_are_sorted=True)
    return jnp.cumsum(starts)


def _resampled(log_weights: ArrayLike, ancestors: Array) -> Resampled:
    scaled, _, _ = normalize(log_weights)
    kept = scaled.at[ancestors].get(mode="promise_in_bounds", wrap_negative_indices=False)
    equal = -jnp.log(jnp.asarray(ancestors.shape[0], kept.dtype))
    return Resampled(ancestors, equal + (kept - jax.lax.stop_gradient(kept)))


__all__ = [
    "Resampled",
    "Resampler",
    "adaptive",
    "effective_sample_size",
    "multinomial",
    "normalize",
    "residual",
    "stratified",
    "systematic",
]
