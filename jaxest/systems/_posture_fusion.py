"""The linear algebra of `posture`: joints and headings from the IMUs' orientations."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest import linalg
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
    weight = jax.vmap(linalg.inverse)(noise)
    news, asked = _told(design, weight, error, prior.gone, prior.joint)
    after, turn = _headings(prior.heading, news, asked, share)
    left = error - jnp.zeros_like(error).at[:, 2].set(turn)
    move, covariance = _joints(design, noise, left, after, prior)
    if loose.shape[1] == 0:
        return Fused(move, covariance, turn, after, after)
    free = jnp.kron(loose, jnp.eye(3, dtype=design.dtype)).reshape(*design.shape[:2], -1)
    gone = jnp.concatenate([prior.gone, jnp.zeros(free.shape[2], design.dtype)])
    sure, _ = _told(jnp.concatenate([design, free], axis=2), weight, error, gone, prior.joint)
    doubt, _ = _headings(prior.doubt, sure, asked, share)
    _, covariance = _joints(design, noise, left, doubt, prior)
    return Fused(move, covariance, turn, after, doubt)


def joints(design: Array, noise: Array, error: Array, prior: Prior) -> Fused:
    """Solve for joints alone, where the orientations' headings are those of the earth: `fuse` with headings known."""
    n, _, k = design.shape
    weight = jax.vmap(linalg.inverse)(noise)
    eye = jnp.eye(k, dtype=design.dtype)
    pull = _sum(design, weight, error[:, :, None])[:, 0] - prior.gone / prior.joint
    information = _sum(design, weight, design) + eye / prior.joint
    solved = _solve(information, jnp.concatenate([eye, pull[:, None]], 1))
    covariance = solved[:, :k]
    still = jnp.zeros(n, design.dtype)
    return Fused(solved[:, k], (covariance + covariance.T) / 2, still, prior.heading, prior.doubt)


def _headings(before: Array, news: Array, asked: Array, share: Array) -> tuple[Array, Array]:
    """Covariance (n, n) of headings after information, and their move (n,).

    By the covariance form, for the one before may be singular (before any has begun), and Joseph's, for it stays
    positive by itself: what is common to all headings is known ten thousand times less well than their differences.
    """
    n = asked.shape[0]
    eye = jnp.eye(n, dtype=before.dtype)
    right = jnp.concatenate([before, share * (before @ asked)[:, None]], axis=1)
    solved = linalg.solve(eye + share * before @ news, right)
    gain, turn = share * solved[:, :n], solved[:, n]
    keep = eye - gain @ news
    after = keep @ before @ keep.T + gain @ news @ gain.T / jnp.where(share > 0, share, 1)
    return (after + after.T) / 2, turn


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
    factor = linalg.cholesky(a * scale[:, None] * scale[None, :])
    return scale[:, None] * linalg.cho_solve(factor, scale[:, None] * b)
