"""Residuals of all windows of a recording, and what they sum to."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters._small import largest, outer
from jaxest.linalg._eigen4 import eigen4
from jaxest.manifolds import quaternion as quat
from jaxest.manifolds._algebra import skew
from jaxest.systems import _onsite_window as win
from jaxest.types import Array

SIZE = 15
"""Unknowns: position, turn, bias of gyro A, difference of gyro biases, difference of accelerometer biases."""


class Unknowns(NamedTuple):
    """What is solved for."""

    position: Array
    quaternion: Array
    bias: Array
    difference: Array
    offset: Array


def start(windows: win.Window, ready: Array) -> tuple[Unknowns, Array]:
    """Return the rotation by the q-method, position by least squares, and the noise of the rates' difference."""
    count = jnp.maximum(jnp.sum(ready), 1)
    a, p = (jnp.where(ready[:, None] > 0, side.rate, 0) for side in (windows.a, windows.p))
    a0, p0 = jnp.sum(a, axis=0) / count, jnp.sum(p, axis=0) / count
    left, right = ((x - m[None]) * ready[:, None] for x, m in ((a, a0), (p, p0)))
    q = largest(*eigen4(_davenport(left.T @ right)))
    difference = a0 - quat.to_matrix(q) @ p0
    zero = jnp.zeros(3, a.dtype)
    state = Unknowns(zero, q, difference / 2, difference, zero)
    spread, _ = noise(windows, ready, state, jnp.zeros((3, 3), a.dtype))
    return state, spread


def _davenport(m: Array) -> Array:
    """Return the (4, 4) whose first eigenvector turns vectors p towards a, for m = sum a p' (3, 3).

    Source: Davenport 1968 (A vector approach to the algebra of rotations).
    """
    across = jnp.stack([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    around = m + m.T - jnp.trace(m) * jnp.eye(3, dtype=m.dtype)
    return jnp.block([[jnp.trace(m)[None, None], across[None]], [across[:, None], around]])


def noise(windows: win.Window, ready: Array, state: Unknowns, spread: Array) -> tuple[Array, Array]:
    """Return the covariance of the rates' difference and variance of the forces', as of single samples."""

    def one(window: win.Window, there: Array) -> tuple[Array, Array]:
        rate, force = residual(window, state, spread)
        return there * outer(rate, rate), there * jnp.sum(force * force) / 3

    rate, force = (jnp.sum(x, axis=0) for x in jax.vmap(one)(windows, ready))
    total = jnp.maximum(jnp.sum(ready * windows.gain), jnp.finfo(spread.dtype).tiny)
    floor = jnp.finfo(spread.dtype).eps
    return rate / total + floor * jnp.eye(3, dtype=spread.dtype), force / total + floor


def residual(window: win.Window, state: Unknowns, spread: Array) -> tuple[Array, Array]:
    """Return what is left of the rates' and of the forces' differences, (3,) each."""
    r = quat.to_matrix(state.quaternion)
    bias_p = r.T @ (state.bias - state.difference)
    o = win.regressor(window, r, state.bias, bias_p, spread)
    rate = window.a.rate - r @ window.p.rate - state.difference
    return rate, r @ window.p.force - window.a.force - o @ state.position - state.offset


def moved(state: Unknowns, d: Array) -> Unknowns:
    """Add a step (SIZE,) to the unknowns."""
    return Unknowns(
        state.position + d[:3], quat.retract(state.quaternion, d[3:6]), state.bias + d[6:9],
        state.difference + d[9:12], state.offset + d[12:],
    )  # fmt: skip


def normal(
    windows: win.Window, ready: Array, state: Unknowns, spread: Array, weights: Any, gyro: Array, acc: Array
) -> tuple[Array, Array, Array]:
    """Return Hessian, gradient, and score of every window."""
    dtype = ready.dtype
    scale = jnp.concatenate([jnp.broadcast_to(weights[0], 3), jnp.broadcast_to(weights[1], 3)])

    def both(window: win.Window, d: Array) -> Array:
        return jnp.concatenate(residual(window, moved(state, d), spread))

    def one(window: win.Window, there: Array) -> tuple[Array, Array]:
        zero = jnp.zeros(SIZE, dtype)
        e, slope = both(window, zero), jax.jacfwd(partial(both, window))(zero)
        # The derivatives' noise adds to the regressor's square on average, and to nothing else.
        noisy = weights[1] * win.turning_noise(spread * window.steep / 4)
        weighted = scale[:, None] * slope
        h = slope.T @ weighted - jnp.zeros((SIZE, SIZE), dtype).at[:3, :3].set(noisy)
        score = weighted.T @ e - zero.at[:3].set(noisy @ state.position)
        return there * h, there * score

    h, score = jax.vmap(one)(windows, ready)
    known = precision(gyro, acc, dtype)
    at = jnp.concatenate([jnp.zeros(6, dtype), state.bias, state.difference, state.offset])
    return jnp.sum(h, axis=0) + known, jnp.sum(score, axis=0) + known @ at, score


def bent(windows: win.Window, ready: Array, state: Unknowns, spread: Array, weights: Any) -> Array:
    """Return what the entries of the matrices by which four sensors are off do to the gradient, (SIZE, 36)."""
    dtype = ready.dtype
    scale = jnp.concatenate([jnp.broadcast_to(weights[0], 3), jnp.broadcast_to(weights[1], 3)])

    def one(window: win.Window, there: Array) -> Array:
        def at(d: Array, off: Array) -> Array:
            return jnp.concatenate(residual(win.bent(window, off.reshape(4, 3, 3)), moved(state, d), spread))

        slope, by = jax.jacfwd(at, (0, 1))(jnp.zeros(SIZE, dtype), jnp.zeros(36, dtype))
        found: Array = there * (slope.T @ (scale[:, None] * by))
        return found

    return jnp.sum(jax.vmap(one)(windows, ready), axis=0)


def turned(bent: Array) -> Array:
    """Return what turns of two sensors do, (SIZE, 6), from what entries of their matrices do, (SIZE, 18)."""
    # A turn d makes v to v + d x v.
    entries = jnp.stack([skew(axis).reshape(9) for axis in jnp.eye(3, dtype=bent.dtype)], axis=1)
    return jnp.concatenate([bent[:, :9] @ entries, bent[:, 9:] @ entries], axis=1)


def precision(gyro: Array, acc: Array, dtype: Any) -> Array:
    """Return the precision (SIZE, SIZE) of the prior: b_A and b_P = R'(b_A - c) each have the gyros'."""
    eye, none = jnp.eye(3, dtype=dtype), jnp.zeros((3, 3), dtype)
    gyros = jnp.block([[2 * eye, -eye], [-eye, eye]]) / gyro**2
    precision = jnp.zeros((SIZE, SIZE), dtype).at[6:12, 6:12].set(gyros)
    return precision.at[12:, 12:].set(eye / (2 * acc**2) + none)


__all__ = ["SIZE", "Unknowns", "bent", "moved", "noise", "normal", "precision", "residual", "start", "turned"]
