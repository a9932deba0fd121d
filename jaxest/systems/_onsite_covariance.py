"""What the live estimator `onsite` does not know: noise, and what sensors' axes and biases may be off."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.filters import bingham_linear, rls
from jaxest.filters._small import applied, eye, inverse3, outer, product, sandwich, trace, transposed
from jaxest.manifolds._algebra import skew
from jaxest.systems._onsite_state import Memory, Params
from jaxest.types import Array

NEAR = (0.005, math.radians(0.1))
"""m and rad: two standard deviations, the root of the trace, below which a pose is known. Source: Sato 2024, IV-B."""


class Turned(NamedTuple):
    """The rotation and what is not known of it, in P."""

    matrix: Array
    """(3, 3)"""
    noise: Array
    """(3, 3) rad^2"""
    askew: Array
    """(3, 3) rad^2, what crooked axes of the gyros leave."""


def askew(params: Params, turn: bingham_linear.State) -> Array:
    """Return the covariance (3, 3) that gyros with crooked axes leave of the rotation.

    If R'w_A = w_P + D w_P with independent entries of D, the rotation turns by (tr S I - S)^-1 sum of w x D w, S the
    rates' second moment: the covariance of that sum is tr(S^2) I - S^2 times the variance of an entry. However little
    the link turns about two axes, p and q of S about them, what is left about the third is (p^2 + q^2) / (p + q)^2 of
    an entry's variance, a half to one: `little` only keeps the quotient from 0 / 0, and makes it one there.
    """
    s = _rates(turn)
    size = trace(s)
    one = eye(3, size)
    square, moved = product(s, s), size[None, None] * one - s
    little = 3e-3 * size
    back = inverse3(moved + little[None, None] * one)
    spread = (trace(square) + little * little)[None, None] * one - square + (2 * little)[None, None] * moved
    entry = 2 * jnp.asarray(params.gyroscope_axes, s.dtype) ** 2  # of the difference of two
    return entry[None, None] * sandwich(back, spread)


def _rates(turn: bingham_linear.State) -> Array:
    """Covariance (3, 3) of P's rates up to now."""
    return turn.scatter[3:, 3:] / jnp.where(turn.weight > 0, turn.weight, 1)[None, None]


def whole(params: Params, turned: Turned, place: rls.Info, memory: Memory, noisy: Array) -> tuple[Array, Array]:
    """Return whether the pose is known to 5 mm and 0.1 deg, and its covariance; axes behind are batches.

    Args:
        params: the system's.
        turned: the rotation.
        place: the position.
        memory: sums up to now.
        noisy: (3, 3) as `rls.Observation` has it, of the newest window.

    Returns:
        () bool, and (6, 6) of rotation vector (in P, on the right) and position: rad, m.
    """
    inverse = place.formal / place.variance[None, None]  # of the sum of O'O, less what noise adds to it
    # Sum of O'[R f_P x]; a turn d of P on the right moves R f_P by -[R f_P x] R d.
    force = [memory.lever[:, 4 * k : 4 * k + 4] for k in range(3)]
    crossed = jnp.stack(
        [force[1][:, 2] - force[2][:, 1], force[2][:, 0] - force[0][:, 2], force[0][:, 1] - force[1][:, 0]], axis=1
    )
    # It turns half of the regressor, too: by D = [R d x] / 2 in the words of `_stretched`.
    half = skew(applied(_spread(memory), place.estimate) / 2)
    moved = -product(inverse, product(crossed + half, turned.matrix))
    turning = turned.noise + turned.askew
    # Each step used the rotation of its time, whose error then was larger: twice the variance of the last.
    placing = _placed(place, memory, noisy) + sandwich(moved, turning + turned.noise)
    # A turned accelerometer moves its own force: A's is R f_P - O r, and O'[O r x] sums to [r x] S for O = [w' x].
    acc = jnp.asarray(params.accelerometer_turn, inverse.dtype)
    of_a = crossed - product(skew(place.estimate), _spread(memory))
    felt = (acc * acc)[None, None] * (product(crossed, transposed(crossed)) + product(of_a, transposed(of_a)))
    placing = placing + _stretched(params, place, memory, inverse) + sandwich(inverse, felt)
    cross = product(turning, transposed(moved))
    covariance = jnp.concatenate(
        [jnp.concatenate([turning, cross], axis=1), jnp.concatenate([transposed(cross), placing], axis=1)]
    )  # fmt: skip
    near = (4 * trace(placing) < NEAR[0] ** 2) & (4 * trace(turning) < NEAR[1] ** 2)
    return near, covariance


def _spread(memory: Memory) -> Array:
    """S (3, 3), second moments of the rates' derivatives: O'O of O = [w' x] sums to tr(S) I - S."""
    information = memory.position.information
    half = trace(information) / 2
    return half[None, None] * eye(3, half) - information


def _placed(place: rls.Info, memory: Memory, noisy: Array) -> Array:
    """Covariance (3, 3) of the position that noise leaves.

    Overlapping windows repeat each other: over many, their noise is that of single samples. Blocks of windows tell by
    how much the residuals' slow part exceeds that; their mean ratio is used, for single variances are uncertain. The
    derivatives' noise is quick and leaves no such slow part: its share of the residuals does not count.
    """
    quick = jnp.sum(noisy * outer(place.estimate, place.estimate), axis=(0, 1))
    single = memory.gain * memory.density
    share = jnp.clip(1 - quick / (3 * place.variance), 0.1, 1) / jnp.where(single > 0, single, 1)
    ratio = jnp.sum(memory.position.information * place.covariance, axis=(0, 1)) / (3 * place.variance * share)
    return place.formal * (share * jnp.maximum(ratio, 1))[None, None]


def _stretched(params: Params, place: rls.Info, memory: Memory, inverse: Array) -> Array:
    """Covariance (3, 3) that crooked axes and accelerometers' biases leave of the position, less the rotation's share.

    Both forces are near R f_P: they differ by D R f_P + c, D and c of two accelerometers' errors. The regressor O errs
    by the mean D of two gyros. Where the turns' change matters more than their centripetal part, O is [w' x] and
    O'[D w' x] sums to tr(D S) I - D S: times the position r that is a vector whose covariance for independent entries
    of D follows. What O has of [w x]^2 errs by twice as much.
    """
    gyro, acc, bias = (
        jnp.asarray(x, inverse.dtype)
        for x in (params.gyroscope_axes, params.accelerometer_axes, params.accelerometer_bias)
    )
    r, s = place.estimate, _spread(memory)
    sr, square = applied(s, r), product(s, s)
    # D has entries of variance 1: E[tr(D S)^2] = tr(S^2), E[tr(D S) (D S r)'] = (S S r)', E[D S r (D S r)'] = |S r|^2.
    mixed = outer(applied(square, r), r)
    length = jnp.sum(sr * sr, axis=0)
    own = trace(square)[None, None] * outer(r, r) - mixed - transposed(mixed) + length[None, None] * eye(3, length)
    lever = memory.lever
    of_bias = np.asarray([0, 0, 0, 1] * 3).reshape((1, 12) + (1,) * acc.ndim) > 0
    felt = product(lever * jnp.where(of_bias, (bias * bias)[None, None], (acc * acc)[None, None]), transposed(lever))
    twice = 1 + _centripetal(memory)
    return sandwich(inverse, (twice * twice * gyro * gyro / 2)[None, None] * own + 2 * felt)


def _centripetal(memory: Memory) -> Array:
    """Share () of the sum of O'O that is the squares' rather than the derivatives', for Gaussian rates."""
    turn = memory.rotation
    s = _rates(turn)
    steps = turn.weight / jnp.where(memory.density > 0, memory.density, 1)
    # The trace of [w x]^4 is 2 |w|^4.
    fourth = 2 * steps * (trace(s) ** 2 + 2 * jnp.sum(s * s, axis=(0, 1)))
    total = trace(memory.position.information)
    return jnp.clip(fourth / jnp.where(total > 0, total, 1), 0, 1)


__all__ = ["NEAR", "Turned", "askew", "whole"]
