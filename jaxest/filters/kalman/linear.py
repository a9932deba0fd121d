"""Linear-Gaussian series with square roots: filter and Rauch-Tung-Striebel smoother, one step after the other.

Square roots resolve variances 1e16 apart in one float64 state (a prior of 1e8 beside a noise of 1e-8), where a
covariance has no digit left; nothing is inverted but roots, and every root may belong to a singular covariance.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters.kalman._square_root import solve, triangular
from jaxest.filters.kalman.gaussian import product
from jaxest.types import Array


class Series(NamedTuple):
    """T steps `x[k] = transition x[k-1] + offset + noise e`, then `residual - design x` with unit noise."""

    transition: Array
    """(T, n, n)"""
    offset: Array
    """(T, n)"""
    noise: Array
    """(T, n, q) root of the process noise: any matrix N with `N N'` = its covariance."""
    design: Array
    """(T, m, n) measurement matrix, divided by the root of the measurement noise; zero rows where masked."""
    residual: Array
    """(T, m) measurement minus its offset, likewise."""
    constant: Array
    """(T,) -(log det R + m log 2 pi) / 2 of the rows that exist; see `whitened`."""


class Root(NamedTuple):
    """Means and roots of covariances."""

    mean: Array
    """(..., n)"""
    root: Array
    """(..., n, n) L, lower triangular; the covariance is `L L'`."""

    @property
    def covariance(self) -> Array:
        """(..., n, n)."""
        return product(self.root, jnp.swapaxes(self.root, -1, -2))


def whitened(design: Array, value: Array, noise: Array, valid: Array) -> tuple[Array, Array, Array]:
    """Return `design`, `residual`, `constant` of a `Series` step from a measurement as it is written down.

    Args:
        design: (m, n) H of `value = H x + error`.
        value: (m,); any finite number where masked.
        noise: (m, m) covariance of the error, positive definite.
        valid: (m,) bool.

    Returns:
        (m, n), (m,) and ().
    """
    noise = jnp.where(valid[:, None] & valid[None, :], noise, jnp.eye(len(valid), dtype=noise.dtype))
    lower = linalg.cholesky(noise)
    rows = solve(lower, jnp.where(valid[:, None], jnp.concatenate([value[:, None], design], axis=1), 0))
    count = jnp.sum(valid).astype(noise.dtype)
    constant = -jnp.sum(jnp.log(jnp.diagonal(lower))) - count * jnp.log(2 * jnp.pi).astype(noise.dtype) / 2
    return rows[:, 1:], rows[:, 0], constant


def predicted(step: Series, before: Root) -> Root:
    """Return the state before a step's measurement."""
    wide = jnp.concatenate([product(step.transition, before.root), step.noise], axis=1)
    return Root(product(step.transition, before.mean) + step.offset, triangular(wide))


def corrected(step: Series, ahead: Root) -> tuple[Root, Array]:
    """Return the state after a step's measurement, and the measurement's log-density."""
    m, n = step.design.shape
    across = product(step.design, ahead.root)
    top = jnp.concatenate([jnp.eye(m, dtype=across.dtype), across], axis=1)
    bottom = jnp.concatenate([jnp.zeros((n, m), across.dtype), ahead.root], axis=1)
    both = triangular(jnp.concatenate([top, bottom]))
    news = solve(both[:m, :m], step.residual - product(step.design, ahead.mean))
    density = step.constant - jnp.sum(news * news) / 2 - jnp.sum(jnp.log(jnp.abs(jnp.diagonal(both)[:m])))
    return Root(ahead.mean + product(both[m:, :m], news), both[m:, m:]), density


def backward(step: Series, before: Root) -> tuple[Array, Root]:
    """Return how a state follows from the next one: `before = gain next + offset + noise`, as gain and (offset, root).

    Source: Park, Kailath 1996 (Square-root RTS smoothing algorithms).
    """
    n = step.transition.shape[0]
    top = jnp.concatenate([product(step.transition, before.root), step.noise], axis=1)
    bottom = jnp.concatenate([before.root, jnp.zeros(step.noise.shape, top.dtype)], axis=1)
    both = triangular(jnp.concatenate([top, bottom]))
    gain = solve(both[:n, :n], both[n:, :n].T, transposed=True).T
    ahead = product(step.transition, before.mean) + step.offset
    return gain, Root(before.mean - product(gain, ahead), both[n:, n:])


def filter_series(series: Series, start: Root) -> tuple[Root, Array]:
    """Filter a linear-Gaussian series.

    Args:
        series: T steps.
        start: the state before the first step.

    Returns:
        The states after each measurement, leaves (T, ...), and the log-densities (T,), whose sum is the log-evidence.

    Source: Kailath, Sayed, Hassibi 2000 (Linear estimation), section 12.3 (array algorithms).
    """

    def advance(before: Root, step: Series) -> tuple[Root, tuple[Root, Array]]:
        after, density = corrected(step, predicted(step, before))
        return after, (after, density)

    return jax.lax.scan(advance, start, series)[1]


def smooth_series(series: Series, start: Root) -> tuple[Root, Array]:
    """Smooth a linear-Gaussian series.

    Args:
        series: T steps.
        start: the state before the first step.

    Returns:
        The states given all measurements, leaves (T + 1, ...) with the start first, and the log-densities (T,).
    """
    filtered, density = filter_series(series, start)
    everyone = prepended(start, filtered)
    earlier = jax.tree.map(lambda x: x[:-1], everyone)
    last = jax.tree.map(lambda x: x[-1], everyone)
    gains, rests = jax.vmap(backward)(series, earlier)

    def retreat(after: Root, link: tuple[Array, Root]) -> tuple[Root, Root]:
        gain, rest = link
        wide = jnp.concatenate([product(gain, after.root), rest.root], axis=1)
        now = Root(product(gain, after.mean) + rest.mean, triangular(wide))
        return now, now

    smoothed = jax.lax.scan(retreat, last, (gains, rests), reverse=True)[1]
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), smoothed, last), density


def prepended(first: Root, rest: Root) -> Root:
    """Return `first` and then `rest` (T, ...) along one axis (T + 1, ...)."""
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest)


__all__ = [
    "Root",
    "Series",
    "backward",
    "corrected",
    "filter_series",
    "predicted",
    "prepended",
    "smooth_series",
    "whitened",
]
