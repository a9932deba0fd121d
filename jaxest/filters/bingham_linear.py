"""Bingham linear filter: the rotation between two frames from pairs of vectors, here rates of two gyros on one link.

A pair obeys a = R(q) b + c, c the relative bias of the two sensors. The likelihood of q is a Bingham density
exp(q' A q) whose A is linear in the pairs' second moments, so the state keeps those, centred about their means: the
relative bias is then integrated out exactly, and noise, its anisotropy and the bias' prior are applied on reading.

Source: Sato 2024, section III-D, with H(a, b) = [[0, -(a-b)'], [(a-b), [(a+b)x]]] in place of eq. 31, whose null vector
is the conjugate; Srivatsan, Xu, Zevallos, Choset 2018.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.filters._bingham_moments import Pair, Params, State, add, init, moments, usable
from jaxest.filters._bingham_pairs import Information, general, isotropic, noise_matrix, pair_matrix, parameter
from jaxest.filters._bingham_spread import spread_of, turning
from jaxest.filters._small import applied, eye, inverse3, largest, product, sandwich, trace, transposed
from jaxest.filters._state import within_range
from jaxest.linalg._eigen4 import eigen4
from jaxest.manifolds import quaternion as quat
from jaxest.types import Array

LEAST = 2.5  # pairs: two directions and the mean take three, less what may have been forgotten


class Estimate(NamedTuple):
    """What the moments say of the rotation."""

    quaternion: Array
    """(4,) wxyz, the mode: a = R(q) b + bias."""
    covariance: Array
    """(3, 3) rad^2 of the mode's error, a rotation vector in the frame of `b` (perturbed on the right)."""
    bias: Array
    """(3,) rad/s, relative: of `a` less that of `b`, in the frame of `a`."""
    residual: Array
    """(3, 3) (rad/s)^2, covariance of a - R b - bias in the data, to be compared with what the noise predicts."""
    parameter: Array
    """(4, 4) A of the Bingham density, its trace 0 (a multiple of the identity means nothing)."""


class Info(NamedTuple):
    """The estimate after a step."""

    quaternion: Array
    """(4,) wxyz, as in `Estimate`."""
    covariance: Array
    """(3, 3) rad^2, as in `Estimate`."""
    bias: Array
    """(3,) rad/s, as in `Estimate`."""
    residual: Array
    """(3, 3) (rad/s)^2, as in `Estimate`."""
    innovation: Array
    """(3,) rad/s, a - R b - bias with the estimate before the step; 0 where there is no pair."""
    log_evidence: Array
    """() log density of the innovation given the past; 0 where there is no pair, and for the first three."""
    valid: Array
    """() bool, whether the rotation is known better than 0.3 rad about every axis."""
    status: Array
    """() int32, `OK`, `NON_FINITE`, or `OUT_OF_RANGE` (state as before)."""


def step(
    params: Params, state: State, measurement: Pair, *, key: Array | None = None, information: Information | None = None
) -> tuple[State, Info]:
    """Take in one pair and read the estimate.

    Args:
        params: noise, prior and forgetting.
        state: as `init` or the previous step returned it.
        measurement: one pair; without either of its readings it adds nothing and nothing is forgotten.
        key: not used.
        information: as for `estimate`, static.

    Returns:
        The next state and the info.

    Raises:
        ValueError: a shape is wrong.

    Source: Sato 2024, eqs. 35 and 36, forgetting once a valid pair.
    """
    dtype = state.mean.dtype
    z, there, status = usable(measurement, dtype)
    before = estimate(params, state, information=information)
    ready = state.weight > LEAST
    innovation, log_evidence = _surprise(params, state, before, z)
    moved = add(state, z, there.astype(dtype), jnp.asarray(params.forgetting, dtype))
    after = estimate(params, moved, information=information)
    known = jnp.max(jnp.diagonal(after.covariance)) < 0.09
    info = Info(
        *after[:4],
        jnp.where(there, innovation, 0),
        jnp.where(there & ready, log_evidence, 0),
        known & (moved.weight > 2),
        status,
    )
    return within_range(state, moved, info)


def estimate(params: Params, state: State, *, information: Information | None = None) -> Estimate:
    """Read the rotation, its covariance and the relative bias from the moments.

    `density`, its eigenvectors, `spread` and `rest` in turn; without `information` an axis behind the moments' is a
    batch.

    The covariance is that of the likelihood of a - R b, not the Bingham's own, which is overconfident by about 4/3
    where Sigma_q = I/4 stands in for the unknown rotation.

    Args:
        params: noise and prior.
        state: the moments.
        information: how noise becomes the inverse of Sigma_H: None for the closed form with the mean variance, or
            `general`; static.

    Returns:
        The estimate; no rotation and a covariance of half a turn squared while there are fewer than three pairs.
    """
    second, a = density(params, state, information=information)
    values, vectors = eigen4(a)
    q = largest(values, vectors)
    covariance = spread(params, state, second, values, vectors, q, information=information)
    bias, residual = rest(params, state, second, quat.to_matrix(q))
    return Estimate(q, covariance, bias, residual, a)


def density(params: Params, state: State, *, information: Information | None = None) -> tuple[Array, Array]:
    """Return the second moments and A of the Bingham density, of no rotation while there are too few pairs."""
    dtype = state.mean.dtype
    noise_a, noise_b = (jnp.asarray(x, dtype) for x in params[:2])
    second = moments(params, state)
    a = parameter(second, None if information is None else information(noise_a, noise_b), trace(noise_a + noise_b))
    first = np.diag([1.0, 0.0, 0.0, 0.0]).reshape((4, 4) + (1,) * state.weight.ndim)
    return second, jnp.where((state.weight > LEAST)[None, None], a, jnp.asarray(first, dtype))


def spread(
    params: Params, state: State, second: Array, values: Array, vectors: Array, q: Array, *,
    information: Information | None = None,
) -> Array:  # fmt: skip
    """Return the covariance (3, 3) of the mode `q`, from the eigenvalues and vectors of `density`."""
    dtype = state.mean.dtype
    noise_a, noise_b = (jnp.asarray(x, dtype) for x in params[:2])
    some = state.weight > LEAST
    total = trace(noise_a + noise_b)
    # What the product of the readings' noise may pretend, to two standard deviations, is no information.
    margin = (
        12 * jnp.sqrt(jnp.where(some, state.weight, 1) * trace(noise_a) * trace(noise_b))
        / jnp.where(total > 0, 3 * total, 1)
    )  # fmt: skip
    if information is None:
        gap = jnp.where(some[None], jnp.max(values, axis=0)[None] - values, 0)
        return spread_of(gap * 3 / 8, vectors, q, margin)
    # The product of two independent readings has no noise of its own on average, unlike the square of one.
    r = quat.to_matrix(q)
    clean = product(r.T, second[:3, 3:])
    noise = noise_a + sandwich(r, noise_b)
    precision = turning((clean + clean.T) / 2, sandwich(r.T, inverse3(noise)))
    wide = jnp.zeros((4, 4), dtype).at[1:, 1:].set(jnp.where(some, precision, 0))
    return spread_of(*eigen4(wide), jnp.eye(4, dtype=dtype)[0], margin)


def rest(params: Params, state: State, second: Array, r: Array) -> tuple[Array, Array]:
    """Return the relative bias (3,) and the residuals' covariance (3, 3) for the rotation matrix `r`."""
    level = trace(jnp.asarray(params.covariance_a) + jnp.asarray(params.covariance_b)).astype(second.dtype) / 3
    centre = state.mean[:3] - applied(r, state.mean[3:])
    variance = jnp.asarray(params.bias, second.dtype) ** 2 * state.weight
    bias = centre * (variance / jnp.where(variance > 0, variance + level, 1))[None]
    crossed = product(second[:3, 3:], transposed(r))
    left = second[:3, :3] - crossed - transposed(crossed) + sandwich(r, second[3:, 3:])
    free = jnp.where(state.weight > 2, state.weight - 2, 1)  # six numbers are fitted to three equations a pair
    # What differences of long sums lose to rounding must not look like sensors without noise.
    lost = 16 * float(jnp.finfo(second.dtype).eps) * (trace(second) + trace(second[3:, 3:]))
    real = (trace(left) > 3 * lost)[None, None]
    left = jnp.where(real, (left + transposed(left)) / 2, lost[None, None] * eye(3, lost))
    return bias, left / free[None, None]


def _surprise(params: Params, state: State, before: Estimate, z: Array) -> tuple[Array, Array]:
    """Innovation of a pair and the log of its Gaussian predictive density."""
    dtype = z.dtype
    r = quat.to_matrix(before.quaternion)
    innovation = z[:3] - jnp.sum(r * z[None, 3:], axis=1) - before.bias
    noise_a, noise_b = (jnp.asarray(x, dtype) for x in params[:2])
    noise = noise_a + sandwich(r, noise_b)
    away = z[3:] - state.mean[3:]
    turned = product(r, jnp.cross(away[None, :], jnp.eye(3, dtype=dtype)).T)  # R [b x], about the mean
    level = jnp.trace(noise) / 3
    prior = jnp.asarray(params.bias, dtype) ** 2
    left = prior * level / (prior * state.weight + level)  # variance of the relative bias that is left
    spread = noise + sandwich(turned, before.covariance) + left * jnp.eye(3, dtype=dtype)
    inverse = inverse3(spread)
    square = jnp.sum(innovation[:, None] * inverse * innovation[None, :])
    det = jnp.sum(spread[0] * jnp.cross(spread[1], spread[2]))
    safe = jnp.where(det > 0, det, 1)
    return innovation, -(square + jnp.log(safe) + 3 * math.log(2 * math.pi)) / 2


__all__ = [
    "Estimate",
    "Info",
    "Information",
    "Pair",
    "Params",
    "State",
    "add",
    "density",
    "estimate",
    "general",
    "init",
    "isotropic",
    "moments",
    "noise_matrix",
    "pair_matrix",
    "parameter",
    "rest",
    "spread",
    "step",
    "usable",
]
