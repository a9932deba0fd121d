"""Smoothing of a model on any manifold: the Rauch-Tung-Striebel smoother, iterated to the most probable path."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters.kalman._square_root import root
from jaxest.filters.kalman.factors import evaluate, joined, whiten
from jaxest.filters.kalman.gaussian import product
from jaxest.filters.kalman.linear import Root, Series, smooth_series
from jaxest.filters.kalman.model import Model, State, clean, factors, filter_step
from jaxest.filters.run import run
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, OUT_OF_RANGE, Array, ArrayLike, PyTree

_BACK = 12  # terms of the derivative's series; each shrinks by the rate at which the iteration converges


class SmoothSeries(Protocol):
    """`smooth_series` or `smooth_series_parallel`."""

    def __call__(self, series: Series, start: Root) -> tuple[Root, Array]:
        """Return the smoothed states (T + 1, ...) and the log-densities (T,)."""
        ...


class History(NamedTuple):
    """The smoothed path: row k belongs to measurement k."""

    mean: PyTree
    """Leaves (T, ...), elements of the manifold."""
    covariance: Array
    """(T, n, n) in the tangent space at each mean."""
    start: PyTree
    """The state before the first measurement."""
    start_covariance: Array
    """(n, n) in the tangent space at `start`."""
    log_likelihood: Array
    """(T,) log-density of each measurement given the earlier ones, in the model linearised at the path; the sum is
    Laplace's approximation of the log-evidence, exact for a linear-Gaussian model."""
    used: Array
    """(T, m) bool, rows that took part: as in the filter, whose gates decide."""
    iterations: Array
    """() int32, linearisations of the path."""
    status: Array
    """(T,) int32, `OK`, `NON_FINITE` (that measurement had such a reading), `OUT_OF_RANGE` (the filter did not take it)
    or `NOT_CONVERGED` (on every row)."""


def smooth(
    model: Model,
    params: PyTree,
    state0: State,
    measurements: PyTree,
    *,
    iterations: int = 10,
    tolerance: ArrayLike | None = None,
    series: SmoothSeries = smooth_series,
) -> History:
    """Estimate a path from all of its measurements.

    The filter gives a first path; the model is linearised along it, the linear problem is solved with square roots,
    and so on: Gauss-Newton on the whole path, hence the most probable one. One iteration is the extended RTS
    smoother, linearised at the filter's estimates; a linear model needs no more. Derivatives are those of the
    converged path, by a series of `_BACK` linear smoothings.

    Args:
        model: what is smoothed; static.
        params: its parameters.
        state0: the state before the first measurement, which is smoothed too; parameters without dynamics may be part
            of it, with a variance as large as ignorance asks for.
        measurements: leaves (T, ...).
        iterations: linearisations of the path at most; static.
        tolerance: () longest last step that counts as converged, in standard deviations of the smoothed state; the
            cube root of the dtype's eps (6e-6, 5e-3) if None.
        series: `smooth_series`, or `smooth_series_parallel` for long series on many cores.

    Returns:
        The smoothed path.

    Raises:
        ValueError: `iterations` below 1.

    Source: Bell 1994 (The iterated Kalman smoother as a Gauss-Newton method), on manifolds.
    """
    if iterations < 1:
        raise ValueError(f"iterations: got {iterations}, expected at least 1")
    _, filtered = run(filter_step(model), params, state0, measurements)
    first = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), state0.mean, filtered.mean)
    nominal = jax.lax.stop_gradient(first)
    measurements = jax.vmap(lambda m: clean(m)[0])(measurements)
    retract = jax.vmap(model.manifold.retract)

    def solved(steps: Array) -> tuple[Root, Array]:
        """Linear smoothing of the deviations from the path `retract(nominal, steps)`, (T + 1, n)."""
        path = retract(nominal, steps)
        start, linear = _linearize(model, params, state0, measurements, filtered.used, path)
        return series(linear, start)

    length = filtered.used.shape[0] + 1
    zero = jnp.zeros((length, model.manifold.dim), state0.covariance.dtype)
    steps, count, settled = zero, jnp.int32(1), jnp.bool_(True)
    if iterations > 1:
        if tolerance is None:
            tolerance = float(jnp.finfo(zero.dtype).eps) ** (1 / 3)
        steps, count, settled = _iterate(model, nominal, solved, zero, iterations, jnp.asarray(tolerance, zero.dtype))
    deviations, density = solved(steps)
    path = retract(retract(nominal, steps), deviations.mean)
    covariance = deviations.covariance
    told = (filtered.status == NON_FINITE) | (filtered.status == OUT_OF_RANGE)
    failed = jnp.where(told, filtered.status, jnp.where(settled, OK, NOT_CONVERGED))
    return History(
        jax.tree.map(lambda x: x[1:], path),
        covariance[1:],
        jax.tree.map(lambda x: x[0], path),
        covariance[0],
        density,
        filtered.used,
        count,
        failed.astype(jnp.int32),
    )


def _linearize(
    model: Model, params: PyTree, state0: State, measurements: PyTree, used: Array, path: PyTree
) -> tuple[Root, Series]:
    """The model along a path (T + 1, ...), in deviations from it."""
    manifold = model.manifold
    zero = jnp.zeros(manifold.dim, state0.covariance.dtype)

    def prior(v: Array) -> tuple[Array, Array]:
        x = jax.tree.map(lambda leaf: leaf[0], path)
        error = manifold.local(state0.mean, manifold.retract(x, v))
        return error, error

    slope, error = jax.jacfwd(prior, has_aux=True)(zero)
    back = linalg.inverse(slope)
    start = Root(-product(back, error), product(back, root(state0.covariance)))

    def step(before: PyTree, after: PyTree, measurement: PyTree, keep: Array) -> Series:
        def jump(both: Array) -> tuple[Array, Array]:
            moved = model.dynamics(params, manifold.retract(before, both[0]), measurement)
            error = manifold.local(moved, manifold.retract(after, both[1]))
            return error, error

        slope, error = jax.jacfwd(jump, has_aux=True)(jnp.stack([zero, zero]))
        back = linalg.inverse(slope[:, 1])
        noise = jnp.asarray(model.process_noise(params, before, measurement), zero.dtype)
        every = factors(model, params, measurement)
        values, slopes = evaluate(manifold, every, after, zero)
        ends = [sum(v.shape[0] for v in values[: i + 1]) for i in range(len(values))]
        keeps = [keep[end - v.shape[0] : end] for v, end in zip(values, ends, strict=True)]
        rows = joined([whiten(*each) for each in zip(every, values, slopes, keeps, strict=True)])
        return Series(
            -product(back, slope[:, 0]),
            -product(back, error),
            product(back, root(noise)),
            rows.design,
            rows.residual,
            rows.constant,
        )

    earlier, later = (jax.tree.map(lambda x, cut=cut: x[cut], path) for cut in (slice(None, -1), slice(1, None)))
    return start, jax.vmap(step)(earlier, later, measurements, used)


def _iterate(
    model: Model,
    nominal: PyTree,
    solved: Callable[[Array], tuple[Root, Array]],
    zero: Array,
    iterations: int,
    tolerance: Array,
) -> tuple[Array, Array, Array]:
    """Find the path along which the last linearisation is made, as deviations (T + 1, n) from the nominal one."""
    retract, local = jax.vmap(model.manifold.retract), jax.vmap(model.manifold.local)

    def moved(steps: Array) -> tuple[Array, Array]:
        found, _ = solved(steps)
        length = jnp.sqrt(jnp.sum(found.root**2, axis=-1))
        stretch = jnp.max(jnp.abs(found.mean) / jnp.where(length > 0, length, 1))
        return local(nominal, retract(retract(nominal, steps), found.mean)), stretch

    def solve(_: Any, zero: Array) -> tuple[Array, tuple[Array, Array]]:
        def body(carry: Any) -> Any:
            steps, count, _ = carry
            steps, stretch = moved(steps)
            return steps, count + 1, stretch <= tolerance

        def going(carry: Any) -> Array:
            return (carry[1] < iterations) & ~carry[2]

        steps, count, settled = jax.lax.while_loop(going, body, (zero, jnp.int32(1), jnp.bool_(False)))
        # A whole number has no tangent that custom_root can handle.
        return steps, (count.astype(zero.dtype), settled.astype(zero.dtype))

    def tangent(g: Callable[[Array], Array], y: Array) -> Array:
        # g is the iteration's derivative minus the identity; the iteration contracts, so its inverse is a series.
        return jax.lax.fori_loop(0, _BACK, lambda _, u: g(u) + u - y, -y)

    steps, (count, settled) = jax.lax.custom_root(lambda s: moved(s)[0] - s, zero, solve, tangent, has_aux=True)
    return steps, count.astype(jnp.int32), settled > 0


__all__ = ["History", "SmoothSeries", "smooth"]
