"""Orientation of one IMU from the whole recording: the error-state filter's model, smoothed.

Forward, the filter of `ekf` runs in blocks of samples and decides on rest, weights and masks. Backward, what it has
learned by the end (bias, scale, field, inclination) is carried to every block by the square-root Rauch-Tung-Striebel
smoother of the deviations from its path. Between blocks the path is the integrated one, shifted by the deviations at
its two ends: they stand still in the earth frame, so a straight line between them is right to second order.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters.attitude import ekf, motion
from jaxest.filters.attitude.ekf_state import Memory, opened
from jaxest.filters.attitude.motion import MANIFOLD, Track
from jaxest.filters.imu import Imu, usable
from jaxest.filters.kalman import Root, Series, smooth_series
from jaxest.filters.kalman._square_root import root
from jaxest.filters.kalman.factors import evaluate, joined, validity, whiten
from jaxest.types import Array


class _Node(NamedTuple):
    """What the backward pass needs of a block."""

    samples: Track
    """leaves (block, ...): the path as it was integrated from the correction before."""
    elapsed: Array
    """(block,) share of the block's time that has passed at each sample."""
    ahead: Track
    """before the correction"""
    state: Memory
    """after it"""
    known: Array
    """() bool, whether there was an orientation before the block"""
    valid: Array
    """(block,) bool"""
    headed: Array
    """(block,) bool"""
    status: Array
    """(block,) int32"""
    series: Series


def smooth(params: ekf.Params, state0: ekf.State, measurements: Imu, *, block: int = 8) -> ekf.Info:
    """Estimate the orientation at every sample from all samples.

    Args:
        params: as of `ekf.step`.
        state0: the state before the first sample, `ekf.init(params)`.
        measurements: leaves (T, ...).
        block: samples between corrections, static; about `params.interval` long, which itself is not used.

    Returns:
        The infos, leaves (T, ...), as the filter gives them, of the smoothed estimate. Before a vector sensor's first
        sample they are not valid, as in the filter.

    Raises:
        ValueError: `block` is below 1, or a shape is wrong.

    Source: Rauch, Tung, Striebel 1965 on deviations; Park, Kailath 1996 (square roots). Linear about the filter's
    path, once: its last estimate differs from the filter's by what the filter's own linearisation left.
    """
    if block < 1:
        raise ValueError(f"block: got {block}, expected at least 1")
    return _smooth(block, params, state0, measurements)


@partial(jax.jit, static_argnums=0)
def _smooth(block: int, params: ekf.Params, state0: ekf.State, measurements: Imu) -> ekf.Info:
    dtype = state0.numbers.dtype
    params = jax.tree.map(lambda x: jnp.asarray(x, dtype), params)
    length = jnp.shape(measurements.dt)[0]
    blocks = jax.tree.map(lambda x: _cut(x, block), _padded(measurements, -length % block))
    _, nodes = jax.lax.scan(partial(_forward, params), state0, blocks)
    start = Root(jnp.zeros(MANIFOLD.dim, dtype), root(state0.covariance))
    deviations, _ = smooth_series(nodes.series, start)
    seen = measurements.magnetometer is not None
    info = jax.vmap(partial(_between, params, seen=seen))(
        nodes, jax.tree.map(lambda x: x[:-1], deviations), jax.tree.map(lambda x: x[1:], deviations)
    )
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:length], info)


def _padded(measurements: Imu, missing: int) -> Imu:
    """Append samples that take no time and hold nothing."""

    def pad(x: Any) -> Any:
        return jnp.concatenate([jnp.asarray(x), jnp.zeros((missing, *jnp.shape(x)[1:]), jnp.asarray(x).dtype)])

    return jax.tree.map(pad, measurements)


def _cut(x: Array, block: int) -> Array:
    return x.reshape(-1, block, *x.shape[1:])


def _forward(params: ekf.Params, before: ekf.State, samples: Imu) -> tuple[ekf.State, _Node]:
    """Filter one block, and write down the linear model of the deviations from what the filter found."""

    def move(state: ekf.State, measurement: Imu) -> tuple[ekf.State, Any]:
        sample = usable(measurement, state.numbers.dtype)
        state = ekf.advance(params, state, sample)
        memory = opened(state)
        kept = memory.track, memory.since.time, memory.initialized, memory.heading_initialized, sample.status
        return state._replace(index=state.index + 1), kept

    ahead, (path, time, valid, headed, status) = jax.lax.scan(move, before, samples)
    moved, initialized = opened(ahead), opened(before).initialized
    belief = ekf.predicted(params, moved, ahead.covariance)
    corrected = ekf.correct(params, ahead)
    corrected = jax.tree.map(lambda a, b: jnp.where(moved.initialized, a, b), corrected, ahead)
    after = opened(corrected)
    transition = motion.carry(moved.track.scale, moved.since)
    fresh = jnp.maximum(jnp.diagonal(ahead.covariance) - jnp.diagonal(before.covariance), 0)
    noise = [transition * _deviation(fresh)[None, :], jnp.diag(_deviation(ekf.process_noise(params, moved)))]
    factors, _, _ = ekf.news(params, moved, belief)
    values, slopes = evaluate(MANIFOLD, factors, after.track, jnp.zeros(MANIFOLD.dim, after.unit.dtype))
    keeps = [validity(f, v) & moved.initialized for f, v in zip(factors, values, strict=True)]
    rows = joined([whiten(*each) for each in zip(factors, values, slopes, keeps, strict=True)])
    series = Series(
        transition,
        MANIFOLD.local(after.track, moved.track),
        jnp.concatenate(noise, axis=1),
        rows.design,
        rows.residual,
        rows.constant,
    )
    total = jnp.where(moved.since.time > 0, moved.since.time, 1)
    share = jnp.where(moved.since.time > 0, time / total, 1)
    return corrected, _Node(path, share, moved.track, after, initialized, valid, headed, status, series)


def _deviation(variance: Array) -> Array:
    """Square roots; what does not vary has none, and no slope either."""
    there = variance > 0
    return jnp.where(there, jnp.sqrt(jnp.where(there, variance, 1)), 0)


def _between(params: ekf.Params, node: _Node, begin: Root, end: Root, *, seen: bool) -> ekf.Info:
    """Infos of a block's samples."""
    ending = MANIFOLD.retract(node.state.track, end.mean)
    last = MANIFOLD.local(node.ahead, ending)
    first = jnp.where(node.known, begin.mean, last)

    def one(track: Track, share: Array, valid: Array, headed: Array, status: Array) -> ekf.Info:
        moved = MANIFOLD.retract(track, first + share * (last - first))
        moved = moved._replace(bias=ending.bias, scale=ending.scale, field=ending.field)
        memory = node.state._replace(track=moved, initialized=valid, heading_initialized=headed)
        spread = end.covariance[:8], end.covariance[8:]
        info = ekf.describe(params, memory, spread, valid & headed if seen else valid, seen=seen)
        return info._replace(status=jnp.maximum(status, info.status))

    return jax.vmap(one)(node.samples, node.elapsed, node.valid, node.headed, node.status)


__all__ = ["smooth"]
