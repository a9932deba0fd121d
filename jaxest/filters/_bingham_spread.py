"""Covariances of a rotation from what vectors tell of it."""

import math

import jax.numpy as jnp

from jaxest.filters._small import transposed, written_out
from jaxest.types import Array


def spread_of(precision: Array, vectors: Array, q: Array, margin: Array) -> Array:
    """Return the covariance (3, 3) from precisions (4,) of turns in the directions of unit quaternions (4, 4).

    An axis behind is a batch.
    """
    prior = 3 / math.pi**2  # nothing known is about half a turn
    variance = 1 / (jnp.maximum(precision - margin[None], 0) + prior)
    w, x, y, z = q
    # Rows of the vector part of conj(q) v.
    back = jnp.stack([-x, w, z, -y, -y, -z, w, x, -z, y, -x, w]).reshape((3, 4, *w.shape))
    axes = written_out(back, vectors)
    return written_out(axes * variance[None, :], transposed(axes))


def turning(second: Array, weight: Array) -> Array:
    """Return the sum of [b x]' W [b x] from the sum `second` of b b', both (3, 3) symmetric."""

    def own(i: int) -> Array:
        j, k = (i + 1) % 3, (i + 2) % 3
        return second[j, j] * weight[k, k] + second[k, k] * weight[j, j] - 2 * second[j, k] * weight[j, k]

    def off(i: int, j: int) -> Array:
        k = 3 - i - j
        return (
            second[i, k] * weight[j, k] + second[j, k] * weight[i, k]
            - second[i, j] * weight[k, k] - second[k, k] * weight[i, j]
        )  # fmt: skip

    x, y, z = own(0), own(1), own(2)
    a, b, c = off(0, 1), off(0, 2), off(1, 2)
    return jnp.stack([x, a, b, a, y, c, b, c, z]).reshape(3, 3)


__all__ = ["spread_of", "turning"]
