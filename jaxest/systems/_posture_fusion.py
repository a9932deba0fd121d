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
    heading_doubt: Array
    """(n, n) rad^2, the same without what loose joints seem to say."""


class Prior(NamedTuple):
    """What is known before a sample."""

    heading: Array
    """(n, n) rad^2, covariance of the headings."""
    doubt: Array
    """(n, n) rad^2, the same without what loose joints seemed to say."""
    joint: Array
    """() rad^2, variance of the joints."""
    gone: Array
    """(k,) rad, how far the joints already are from the centre of that."""


def fuse(design: Array, noise: Array, error: Array, prior: Prior, share: Array, loose: Array) -> Fused:
    """Solve `error = design move + up heading_move + noise` for joints of which little is known before.

    The errors of the IMUs' tilts are alike for many samples. What headings learn from one sample therefore counts only
    by the `share` of its information that is new; the joints, which are estimated anew at every sample, get all of it.

    Args:
        design: (n, 3, k) how the IMUs' frames turn with the joints, rad in the earth frame.
        noise: (n, 3, 3) rad^2, covariance of each IMU's orientation in its own earth frame, headings aside.
        error: (n, 3) rad, of each orientation, in the earth frame.
        prior: of headings and joints.
        share: () part of this sample's information that is new.
        loose: (n, m) 1 where an IMU is carried by a group of joints that could turn it any way. What such joints seem
            to say of headings at one moment moves these, and leaves their doubt as it is.

    Returns:
        The solution; the joints' covariance is that of the doubt.
    """
    n = design.shape[0]
    weight = jax.vmap(jnp.linalg.inv)(noise)
    news, asked = _told(design, weight, error, prior.gone, prior.joint)
    eye = jnp.eye(n, dtype=design.dtype)
    # Headings by the covariance form: their prior may be singular (one of them is the zero).
    moved = share * (prior.heading @ asked)[:, None]
    gained = jnp.linalg.solve(eye + share * prior.heading @ news, jnp.concatenate([prior.heading, moved], 1))
    after, turn = gained[:, :-1], gained[:, -1]
    after = (after + after.T) / 2
    left = error - jnp.zeros_like(error).at[:, 2].set(turn)
    move, covariance = _joints(design, noise, left, after, prior)
    if loose.shape[1] == 0:
        return Fused(move, covariance, turn, after, after)
    free = jnp.kron(loose, jnp.eye(3, dtype=design.dtype)).reshape(n, 3, -1)
    gone = jnp.concatenate([prior.gone, jnp.zeros(free.shape[2], design.dtype)])
    sure, _ = _told(jnp.concatenate([design, free], axis=2), weight, error, gone, prior.joint)
    doubt = jnp.linalg.solve(eye + share * prior.doubt @ sure, prior.doubt)
    doubt = (doubt + doubt.T) / 2
    _, covariance = _joints(design, noise, left, doubt, prior)
    return Fused(move, covariance, turn, after, doubt)


def _told(design: Array, weight: Array, error: Array, gone: Array, prior: Array) -> tuple[Array, Array]:
    """Information (n, n) on headings, and where it pulls them (n,): what the joints cannot follow.

    The joints' prior takes part in how they follow but tells nothing, for it begins anew at every sample.
    """
    n, _, k = design.shape
    eye = jnp.eye(n, dtype=design.dtype)
    asked = jnp.concatenate([jnp.zeros((n, 3, n), design.dtype).at[:, 2, :].set(eye), error[:, :, None]], axis=2)
    information = _sum(design, weight, design) + jnp.eye(k, dtype=design.dtype) / prior
    pull = _sum(design, weight, asked)
    follow = _solve(information, pull.at[:, n].add(-gone / prior))
    left = asked - jnp.einsum("nik,km->nim", design, follow, precision=jax.lax.Precision.HIGHEST)
    told = _sum(left[:, :, :n], weight, left)
    return told[:, :n], told[:, n]


def _joints(design: Array, noise: Array, left: Array, heading: Array, prior: Prior) -> tuple[Array, Array]:
    """Move (k,) of the joints and its covariance; headings' uncertainty is noise common to the earth's vertical."""
    n, _, k = design.shape
    whole = jnp.zeros((n, 3, n, 3), design.dtype).at[:, 2, :, 2].set(heading)
    whole = whole + jnp.zeros((n, 3, n, 3), design.dtype).at[jnp.arange(n), :, jnp.arange(n), :].set(noise)
    flat = design.reshape(3 * n, k)
    white = _solve(whole.reshape(3 * n, 3 * n), jnp.concatenate([flat, left.reshape(3 * n, 1)], axis=1))
    eye = jnp.eye(k, dtype=design.dtype)
    pull = flat.T @ white[:, k] - prior.gone / prior.joint
    solved = _solve(flat.T @ white[:, :k] + eye / prior.joint, jnp.concatenate([eye, pull[:, None]], 1))
    covariance = solved[:, :k]
    return solved[:, k], (covariance + covariance.T) / 2


def _sum(a: Array, weight: Array, b: Array) -> Array:
    half = jnp.einsum("nij,njk->nik", weight, b, precision=jax.lax.Precision.HIGHEST)
    return jnp.einsum("nij,nik->jk", a, half, precision=jax.lax.Precision.HIGHEST)


def _solve(a: Array, b: Array) -> Array:
    """Solve a symmetric positive system, scaled to a unit diagonal for the digits of float32."""
    scale = 1 / jnp.sqrt(jnp.diagonal(a))
    factor = jnp.linalg.cholesky(a * scale[:, None] * scale[None, :])
    found: Any = scale[:, None] * jax.scipy.linalg.cho_solve((factor, True), scale[:, None] * b)
    return found
