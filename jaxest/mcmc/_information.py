"""Pieces of the backward information filter: what noises and measurements say, and a step back in time."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.filters.kalman.gaussian import product
from jaxest.mcmc.model import Data, Linear, Model, Prior
from jaxest.types import Array


def noises(model: Model, prior: Prior, variances: Array, steps: int) -> Array:
    """Variances (T, n) of each state's noise; that of the first is its prior's."""
    process = jnp.broadcast_to(variances[None, : model.size], (steps - 1, model.size))
    return jnp.concatenate([prior.variance[None], process])


def precisions(model: Model, prior: Prior, variances: Array, steps: int) -> tuple[Array, Array]:
    """Precisions (T, n, n) of each state's noise, and logarithms (T,) of their determinants."""
    noise = noises(model, prior, variances, steps)
    return jax.vmap(jnp.diag)(1 / noise), -jnp.sum(jnp.log(noise), axis=1)


def carried(a: Array, top: Array) -> Array:
    """Return J' A J (k, k) for J (k, k) with rows `top` (n, k) above those of the identity, which are left out."""
    n = len(top)
    half = product(a[:, :n], top) + jnp.pad(a[:, n:], ((0, 0), (n, 0)))
    return product(top.T, half[:n]) + jnp.pad(half[n:], ((n, 0), (0, 0)))


def eliminate(a: Array, precision: Array, log_det: Array) -> tuple[tuple[Array, Array, Array], Array, Array]:
    """Integrate over a state's noise: root, inverse and link, A at the prediction, and the log of the integral.

    The noise has a precision (n, n), of whose determinant `log_det` is the logarithm.
    """
    n = len(precision)
    root = linalg.cholesky(a[:n, :n] + precision)
    inverse = linalg.solve_triangular(root, jnp.eye(n, dtype=a.dtype))
    link = product(inverse, a[:n])
    log = log_det / 2 - jnp.sum(jnp.log(jnp.diagonal(root)))
    return (root, inverse, link), a - product(link.T, link), log


def measured(model: Model, linear: Linear, data: Data, variances: Array) -> tuple[Array, Array]:
    """A (T, k, k) of each measurement alone, and the logarithm (T,)."""
    t, n = linear.path.shape
    k = n + 1 + model.linear
    at = np.asarray(model.observed)
    r = variances[None, model.size :]
    weight = jnp.where(data.valid, 1 / r, 0)
    away = linear.path[:, at] - data.value
    cross = weight * away
    a = jnp.zeros((t, k, k), linear.path.dtype).at[:, at, at].set(weight)
    a = a.at[:, at, n].set(cross).at[:, n, at].set(cross).at[:, n, n].set(jnp.sum(cross * away, axis=1))
    log = -jnp.sum(jnp.where(data.valid, jnp.log(2 * jnp.pi * r), 0), axis=1) / 2
    return a, log


__all__ = ["carried", "eliminate", "measured", "noises", "precisions"]
