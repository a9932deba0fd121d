"""Particle filters that know the data to come, with or without a path that must survive.

`twist.backward`, `next_only` and `nothing` make the guided, the fully adapted and the bootstrap filter: one algorithm,
whose weights are exact for each. Particles are drawn towards what the twist says of the next state; they are resampled
where their effective sample size has fallen. `at_once` draws whole paths from the linear model given the data, so that
the dynamics of all times and particles are one batch, and never resamples; it suits models that are nearly linear along
the path, where it is many times faster.

Source: Andrieu, Doucet and Holenstein 2010 (conditional SMC); Lindsten, Jordan and Schoen 2014 (ancestor sampling).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters.kalman.gaussian import product
from jaxest.filters.resampling import effective_sample_size, multinomial, normalize
from jaxest.mcmc.model import Data, Linear, Model, Unknown, linear_steps, log_weight, next_states, normals
from jaxest.mcmc.twist import Twist, draw, flow, log_evidence
from jaxest.types import Array, PyTree


class Particles(NamedTuple):
    """What a filter leaves behind."""

    path: Array
    """(T, n) one path, drawn by the weights."""
    log_evidence: Array
    """() estimate of log p(y | theta, variances); unbiased before the logarithm, unless a path was given."""
    ess: Array
    """(T,) effective sample size of the weights before each resampling."""
    log_weight: Array
    """() of the chosen path; for `at_once`, its density over that in the linear model."""


def run(
    model: Model,
    params: PyTree,
    data: Data,
    linear: Linear,
    twist: Twist,
    unknown: Unknown,
    *,
    key: Array,
    count: int,
    path: Array | None = None,
    threshold: float = 0.5,
    ancestors: bool = False,
) -> Particles:
    """Run a particle filter through the series, one time after the other.

    Args:
        model: the model.
        params: its parameters.
        data: the series.
        linear: fixes the coordinates; and the path along which the twist was made.
        twist: what is known of the data to come.
        unknown: theta and variances.
        key: random key.
        count: N, number of particles; static.
        path: (T, n) that must survive as the first particle; an ordinary filter if None.
        threshold: share of N below which the effective sample size causes resampling; static.
        ancestors: whether the given path's past is drawn anew at each resampling; static.

    Returns:
        A path and what became of the weights.

    Raises:
        ValueError: the twist is not whole.
    """
    steps, n = linear.path.shape
    keys = jax.random.split(key, 3)
    normal = normals(keys[0], steps, count, n)
    kept = None if path is None else path - linear.path
    shift = unknown.theta - linear.centre
    body = _Body(model, params, data, linear, unknown, threshold, ancestors)
    x = _propose(twist, 0, jnp.broadcast_to(linear.offset[0], (count, n)), shift, normal[0])
    x = x if kept is None else x.at[0].set(kept[0])
    if twist.link is not None and twist.ahead is None:
        raise ValueError("twist: got one without `ahead`, expected a whole one: `twist.backward(..., whole=True)`")
    at_first = None if twist.ahead is None else twist.ahead[0]
    first = _quadratic(at_first, twist.ahead_log[0], linear.offset[0][None], shift)[0]
    log = jnp.full(count, -jnp.log(jnp.asarray(count, x.dtype)))
    by_time = twist._replace(evidence=jnp.zeros(steps), evidence_log=jnp.zeros(steps))
    xs = (
        jax.tree.map(lambda leaf: leaf[:-1], by_time),
        jax.tree.map(lambda leaf: leaf[1:], by_time),
        jax.tree.map(lambda leaf: leaf[:-1], (data.value, data.valid, linear.path)),
        (linear.path[1:], normal[1:], jax.random.split(keys[1], steps - 1), data.inputs),
        jnp.zeros((steps - 1, n), x.dtype) if kept is None else kept[1:],
    )
    (x_end, log), (xs_before, parents, ess, gains) = jax.lax.scan(
        lambda carry, now: _advance(body, kept is not None, carry, now), (x, log), xs
    )
    last = jax.tree.map(lambda leaf: leaf[-1], by_time)
    log = log + _log_data(model, unknown, data.value[-1], data.valid[-1], x_end + linear.path[-1][None])
    log = log - _quadratic(last.here, last.here_log, x_end, shift)
    log, gain, _ = normalize(log)
    index = jax.random.categorical(keys[2], log)
    chosen = _trace(x_end, xs_before, parents, index) + linear.path
    ess = jnp.concatenate([ess, effective_sample_size(log)[None]])
    return Particles(chosen, first + jnp.sum(gains) + gain, ess, log[index])


class _Body(NamedTuple):
    model: Model
    params: PyTree
    data: Data
    linear: Linear
    unknown: Unknown
    threshold: float
    ancestors: bool


def _advance(body: _Body, given: bool, carry: Any, now: Any) -> Any:
    """Weigh by what is to come, resample where needed, and draw the next states."""
    x, log = carry
    twist, later, (value, valid, path), (ahead_path, normal, key, inputs), kept = now
    unknown, count = body.unknown, x.shape[0]
    shift = unknown.theta - body.linear.centre
    here = x + path[None]
    ahead = jax.vmap(lambda x: body.model.transition(body.params, unknown.theta, x, inputs))(here) - ahead_path[None]
    # The weights are those of the twisted target; without the twist they are the filter's own.
    plain = log + _log_data(body.model, unknown, value, valid, here)
    plain = plain - _quadratic(twist.here, twist.here_log, x, shift)
    weight = plain + _quadratic(later.ahead, later.ahead_log, ahead, shift)
    scaled, gain, _ = normalize(weight)
    ess = effective_sample_size(scaled)
    few = ess < body.threshold * count
    key_choice, key_past = jax.random.split(key)
    fresh = multinomial(key_choice, scaled, count - 1 if given else count).ancestors
    if given:
        own = jnp.zeros((), fresh.dtype)
        if body.ancestors:
            away = kept[None] - ahead
            of_future = -jnp.sum(away * away / unknown.variances[None, : x.shape[1]], axis=1) / 2
            own = jax.random.categorical(key_past, plain + of_future).astype(fresh.dtype)
        fresh = jnp.concatenate([own[None], fresh])
    parents = jnp.where(few, fresh, jnp.arange(count, dtype=fresh.dtype))
    equal = jnp.full_like(scaled, -jnp.log(jnp.asarray(count, x.dtype)))
    moved = _propose(later, None, ahead[parents], shift, normal)
    moved = moved.at[0].set(kept) if given else moved
    return (moved, jnp.where(few, equal, scaled)), (x, parents, ess, gain)


def _log_data(model: Model, unknown: Unknown, value: Array, valid: Array, x: Array) -> Array:
    """Return log densities (N,) of a measurement (m,) given states (N, n)."""
    r = unknown.variances[model.size :]
    away = value[None] - x[:, jnp.asarray(model.observed)]
    terms = -(away * away / r[None] + jnp.log(2 * jnp.pi * r)[None]) / 2
    return jnp.sum(jnp.where(valid[None], terms, 0), axis=1)


def _z(x: Array, shift: Array) -> Array:
    one = jnp.ones((x.shape[0], 1), x.dtype)
    return jnp.concatenate([x, one, jnp.broadcast_to(shift, (x.shape[0], len(shift)))], axis=1)


def _quadratic(a: Array | None, log: Array, x: Array, shift: Array) -> Array:
    if a is None:
        return jnp.broadcast_to(log, (x.shape[0],))
    z = _z(x, shift)
    return log - jnp.sum(product(z, a) * z, axis=1) / 2


def _propose(twist: Twist, row: int | None, ahead: Array, shift: Array, normal: Array) -> Array:
    """Draw states (N, n) around their predictions (N, n)."""
    at = twist if row is None else jax.tree.map(lambda leaf: leaf[row], (twist.root, twist.inverse, twist.link))
    root, inverse, link = at[:3]
    if link is None:
        return ahead + normal * jnp.diagonal(inverse)[None]
    white = normal - product(_z(ahead, shift), link.T)
    return ahead + linalg.solve_triangular(root, white.T, transposed=True).T


def _trace(last: Array, before: Array, parents: Array, index: Array) -> Array:
    """Follow a particle back to its beginning, (T, n)."""

    def back(index: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        x, parents = now
        index = parents[index]
        return index, x[index]

    path = jax.lax.scan(back, index.astype(parents.dtype), (before, parents), reverse=True)[1]
    return jnp.concatenate([path, last[index][None]])


def at_once(
    model: Model,
    params: PyTree,
    data: Data,
    linear: Linear,
    twist: Twist,
    unknown: Unknown,
    *,
    key: Array,
    count: int,
    path: Array | None = None,
    block: int = 1,
    corrected: bool = False,
) -> Particles:
    """Draw whole paths from the linear model given the data, and weigh them; arguments as in `run`.

    Without a path to keep, half of the paths mirror the others, which cancels odd terms of the logarithms of the
    weights.

    Args:
        model: the model.
        params: its parameters.
        data: the series.
        linear: the linear model.
        twist: of `twist.backward`, for these variances.
        unknown: theta and variances.
        key: random key.
        count: N; static.
        path: (T, n) that must survive, or None.
        block: paths whose steps are computed together, a divisor of N; static. With some chains one is enough to keep
            a processor busy, and more do not fit its cache.
        corrected: whether paths are drawn once more from the same numbers, the linear model's steps moved by what they
            missed at the first; takes most of the error of the linear model out of the
            weights, at twice the dynamics. Only without a path to keep; static.

    Returns:
        A path and what became of the weights; the effective sample size is the same at all times.

    Raises:
        ValueError: `corrected` with a path to keep, whose numbers are not known.
    """
    if corrected and path is not None:
        raise ValueError("corrected: expected no path to keep")
    steps, n = linear.path.shape
    key_normal, key_choice = jax.random.split(key)
    fresh = count if path is not None else (count + 1) // 2
    normal = normals(key_normal, fresh, steps, n)
    normal = normal if path is not None else jnp.concatenate([normal, -normal])[:count]
    given = flow(twist, linear, unknown.theta)
    paths = draw(given, linear, normal)
    paths = paths if path is None else paths.at[0].set(path)

    def steps_of(path: Array) -> Array:
        return next_states(model, params, unknown.theta, data, path)

    def weigh(paths: Array) -> tuple[Array, Array]:
        blocks = paths.reshape(-1, block if count % block == 0 else 1, steps, n)
        ahead = jax.lax.map(jax.vmap(steps_of), blocks).reshape(count, steps - 1, n)
        error = ahead - jax.vmap(partial(linear_steps, linear, unknown.theta))(paths)
        return error, jax.vmap(partial(log_weight, model, data, linear, unknown))(paths, error)

    error, weights = weigh(paths)
    if corrected:
        # Each state is still its normal numbers, scaled, plus what earlier numbers say: the density is known.
        paths = draw(given, linear, normal, error)
        apart = jnp.einsum("tji,tjk,Ntk->Nti", twist.root[1:], given.left[1:], error)
        moved = -jnp.sum((normal[:, 1:] + apart / 2) * apart, axis=(1, 2))
        weights = moved + weigh(paths)[1]
    log, total, _ = normalize(weights)
    index = jax.random.categorical(key_choice, log)
    size = jnp.asarray(count, total.dtype)
    evidence = log_evidence(twist, linear, unknown.theta) + total - jnp.log(size)
    ess = jnp.broadcast_to(effective_sample_size(log), (steps,))
    return Particles(paths[index], evidence, ess, weights[index])


__all__ = ["Particles", "at_once", "run"]
