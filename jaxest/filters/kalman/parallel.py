"""The same filter and smoother as `linear`, in parallel over time: work log T deep, for long series on many cores.

Joining two stretches multiplies one's covariance by the other's information, so that means lose the digits that the
two have between them; with a prior variance of 1e8 beside a noise of 1e-8 none is left (roots of covariances keep
theirs). Start such a series with the sequential form.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters.kalman._square_root import solve, triangular
from jaxest.filters.kalman.gaussian import product
from jaxest.filters.kalman.linear import Root, Series, backward, corrected, predicted, prepended
from jaxest.types import Array


class _Forward(NamedTuple):
    """What a stretch of steps says: the state after it given the one before, and a likelihood of the one before."""

    gain: Array
    mean: Array
    root: Array
    pull: Array
    """(n,) information vector about the state before."""
    weight: Array
    """(n, n) root of the information matrix."""


class _Backward(NamedTuple):
    """How the state at a stretch's start follows from the one at its end."""

    gain: Array
    mean: Array
    root: Array


def filter_series_parallel(series: Series, start: Root) -> tuple[Root, Array]:
    """Filter a linear-Gaussian series by an associative scan; the same results as `filter_series`.

    Args:
        series: T steps.
        start: the state before the first step.

    Returns:
        The states after each measurement, leaves (T, ...), and the log-densities (T,).

    Source: Yaghoobi, Corenflos, Hassan, Sarkka 2022 (Parallel square-root statistical linear regression), section 4.
    """
    elements = jax.vmap(_element)(series)
    first, _ = corrected(_at(series, 0), predicted(_at(series, 0), start))
    n = start.mean.shape[0]
    none = jnp.zeros((n, n), start.mean.dtype)
    begin = _Forward(none, first.mean, first.root, jnp.zeros_like(first.mean), none)
    elements = jax.tree.map(lambda all_, one: all_.at[0].set(one), elements, begin)
    scanned = jax.lax.associative_scan(jax.vmap(_forward), elements)
    filtered = Root(scanned.mean, scanned.root)
    earlier = jax.tree.map(lambda x: x[:-1], prepended(start, filtered))
    density = jax.vmap(lambda step, before: corrected(step, predicted(step, before))[1])(series, earlier)
    return filtered, density


def smooth_series_parallel(series: Series, start: Root) -> tuple[Root, Array]:
    """Smooth a linear-Gaussian series by associative scans; the same results as `smooth_series`.

    Args:
        series: T steps.
        start: the state before the first step.

    Returns:
        The states given all measurements, leaves (T + 1, ...) with the start first, and the log-densities (T,).

    Source: Yaghoobi, Corenflos, Hassan, Sarkka 2022, section 4.
    """
    filtered, density = filter_series_parallel(series, start)
    everyone = prepended(start, filtered)
    gains, rests = jax.vmap(backward)(series, jax.tree.map(lambda x: x[:-1], everyone))
    last = jax.tree.map(lambda x: x[-1:], everyone)
    links = _Backward(
        jnp.concatenate([gains, jnp.zeros_like(gains[:1])]),
        jnp.concatenate([rests.mean, last.mean]),
        jnp.concatenate([rests.root, last.root]),
    )
    scanned = jax.lax.associative_scan(jax.vmap(_backward), links, reverse=True)
    return Root(scanned.mean, scanned.root), density


def _at(series: Series, index: int) -> Series:
    return jax.tree.map(lambda x: x[index], series)


def _element(step: Series) -> _Forward:
    """One step: the state after it given the one before exactly, and what its measurement says of that one."""
    n = step.transition.shape[0]
    m = step.design.shape[0]
    exact = Root(step.offset, triangular(step.noise))
    across = product(step.design, exact.root)
    top = jnp.concatenate([jnp.eye(m, dtype=across.dtype), across], axis=1)
    bottom = jnp.concatenate([jnp.zeros((n, m), across.dtype), exact.root], axis=1)
    both = triangular(jnp.concatenate([top, bottom]))
    reach = solve(both[:m, :m], product(step.design, step.transition))
    news = solve(both[:m, :m], step.residual - product(step.design, step.offset))
    gain = step.transition - product(both[m:, :m], reach)
    mean = step.offset + product(both[m:, :m], news)
    return _Forward(gain, mean, both[m:, m:], product(reach.T, news), triangular(reach.T))


def _forward(i: _Forward, j: _Forward) -> _Forward:
    """Return stretch i followed by stretch j."""
    n = i.mean.shape[0]
    top = jnp.concatenate([product(i.root.T, j.weight), jnp.eye(n, dtype=i.mean.dtype)], axis=1)
    bottom = jnp.concatenate([j.weight, jnp.zeros((n, n), i.mean.dtype)], axis=1)
    both = triangular(jnp.concatenate([top, bottom]))
    a, b, c = both[:n, :n], both[n:, :n], both[n:, n:]
    spread = solve(a, i.root.T).T  # U_i a'^-1 read from the right: (a^-1 U_i')'
    kept = product(spread, b.T)
    known = i.mean + product(i.root, product(i.root.T, j.pull))
    pulled = j.pull - product(j.weight, product(j.weight.T, i.mean))
    return _Forward(
        product(j.gain, i.gain - product(kept, i.gain)),
        product(j.gain, known - product(kept, known)) + j.mean,
        triangular(jnp.concatenate([product(j.gain, spread), j.root], axis=1)),
        product(i.gain.T, pulled - product(kept.T, pulled)) + i.pull,
        triangular(jnp.concatenate([product(i.gain.T, c), i.weight], axis=1)),
    )


def _backward(later: _Backward, earlier: _Backward) -> _Backward:
    """Return a stretch and the one before it; a reversed scan hands over the later one first."""
    return _Backward(
        product(earlier.gain, later.gain),
        product(earlier.gain, later.mean) + earlier.mean,
        triangular(jnp.concatenate([product(earlier.gain, later.root), earlier.root], axis=1)),
    )


__all__ = ["filter_series_parallel", "smooth_series_parallel"]
