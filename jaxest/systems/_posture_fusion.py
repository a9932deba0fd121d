"""The linear algebra of `posture`: joints and headings from the IMUs' orientations."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.types import Array


class Fused(NamedTuple):
    """What one linear solution gives."""

    move: Array
    """(k,) of the joints."""
    covariance: Array
    """(k, k) of the joints' errors."""
    heading_move: Array
    """(n,) rad, of the headings."""
    heading_covariance: Array
    """(n, n) rad^2, to be carried on."""


def fuse(design: Array, noise: Array, error: Array, heading: Array, prior: Array, gone: Array, share: Array) -> Fused:
    """Solve `error = design move + up heading_move + noise` for joints of which little is known before.

    The errors of the IMUs' tilts are alike for many samples. What headings learn from one sample therefore counts only
    by the `share` of its information that is new; the joints, which are estimated anew at every sample, get all of it.

    Args:
        design: (n, 3, k) how the IMUs' frames turn with the joints, rad in the earth frame.
        noise: (n, 3, 3) rad^2, covariance of each IMU's orientation in its own earth frame, headings aside.
        error: (n, 3) rad, of each orientation, in the earth frame.
        heading: (n, n) rad^2, covariance of the headings before.
        prior: () rad^2, variance of the joints before.
        gone: (k,) rad, how far the joints already are from the prior's centre.
        share: () part of this sample's information that is new.

    Returns:
        The solution.
    """
    n, _, k = design.shape
    dtype = design.dtype
    eye = jnp.eye(n, dtype=dtype)
    up = jnp.zeros((n, 3, n), dtype).at[:, 2, :].set(eye)
    weight = jax.vmap(jnp.linalg.inv)(noise)
    stacked = jnp.concatenate([design, up], axis=2)
    information = _sum(stacked, weight, stacked)
    pull = _sum(stacked, weight, error[:, :, None])[:, 0]
    joints = information[:k, :k] + jnp.eye(k, dtype=dtype) / prior
    across = information[:k, k:]
    lone = pull[:k] - gone / prior
    inner = _solve(joints, jnp.concatenate([across, lone[:, None]], axis=1))
    news = information[k:, k:] - across.T @ inner[:, :-1]
    asked = pull[k:] - across.T @ inner[:, -1]
    # Headings by the covariance form: their prior may be singular (one of them is the zero).
    gained = jnp.linalg.solve(
        eye + share * heading @ news, jnp.concatenate([heading, share * (heading @ asked)[:, None]], 1)
    )
    after, turn = gained[:, :-1], gained[:, -1]
    after = (after + after.T) / 2
    # The joints see the headings' uncertainty as noise common to the earth's vertical.
    whole = jnp.zeros((n, 3, n, 3), dtype).at[:, 2, :, 2].set(after)
    whole = whole + jnp.zeros((n, 3, n, 3), dtype).at[jnp.arange(n), :, jnp.arange(n), :].set(noise)
    flat, left = design.reshape(3 * n, k), (error - jnp.zeros_like(error).at[:, 2].set(turn)).reshape(3 * n)
    white = _solve(whole.reshape(3 * n, 3 * n), jnp.concatenate([flat, left[:, None]], axis=1))
    final = flat.T @ white[:, :k] + jnp.eye(k, dtype=dtype) / prior
    solved = _solve(
        final, jnp.concatenate([jnp.eye(k, dtype=dtype), (flat.T @ white[:, k] - gone / prior)[:, None]], 1)
    )
    covariance = solved[:, :k]
    return Fused(solved[:, k], (covariance + covariance.T) / 2, turn, after)


def _sum(a: Array, weight: Array, b: Array) -> Array:
    half = jnp.einsum("nij,njk->nik", weight, b, precision=jax.lax.Precision.HIGHEST)
    return jnp.einsum("nij,nik->jk", a, half, precision=jax.lax.Precision.HIGHEST)


def _solve(a: Array, b: Array) -> Array:
    """Solve a symmetric positive system, scaled to a unit diagonal for the digits of float32."""
    scale = 1 / jnp.sqrt(jnp.diagonal(a))
    factor = jnp.linalg.cholesky(a * scale[:, None] * scale[None, :])
    found: Any = scale[:, None] * jax.scipy.linalg.cho_solve((factor, True), scale[:, None] * b)
    return found
