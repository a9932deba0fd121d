"""Plans of where guided particles go, and draws from the Gaussians that they hold."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters.particle import _cholesky
from jaxest.filters.particle import _gauss_newton as gauss_newton
from jaxest.filters.particle._gauss_newton import Prior
from jaxest.filters.particle.proposal import Rows
from jaxest.filters.particle.transition import Transition
from jaxest.manifolds.base import Manifold
from jaxest.types import Array, PyTree


class Plan(NamedTuple):
    """Where particles will be sent, made before it is decided which of them go on."""

    centre: PyTree
    """Leaves (N, ...), where the tangent spaces are taken."""
    mode: Array
    """(d, N) of the Gaussians, in the basis."""
    factor: Array
    """(d, d + 1, N) of their information, in the basis."""
    basis: Array | None
    """(d, d), orthonormal, directions in columns; those come first of which the measurement says most."""
    wide: Array | None
    """(d,) bool, the last directions: along these particles spread so far that the measurement bends on the way."""
    prior: Prior
    """The Gaussians without the measurement."""
    first: Array
    """() bool, whether the law of the first state is used."""


def normals(key: Array, like: Array) -> Array:
    """Standard normals (d, N) in pairs of opposite signs."""
    size, count = like.shape
    z = jax.random.normal(key, (size, (count + 1) // 2), like.dtype)
    return jnp.concatenate([z, -z], axis=1)[:, :count]


def straight(plan: Plan, white: Array) -> tuple[Array, Array]:
    """Noise (N, d) from each particle's Gaussian, and its log-density (N,)."""
    return (plan.mode + _cholesky.solve(plan.factor, white)).T, log_normal(plan.factor, white)


def bent(
    manifold: Manifold,
    rows: Rows,
    given: tuple[PyTree, PyTree, PyTree],
    plan: Plan,
    basis: Array,
    wide: Array,
    white: Array,
) -> tuple[Array, Array]:
    """Noise (N, d) and its log-density (N,): wide directions first, the others given these."""
    drawn = plan.mode + _cholesky.solve(plan.factor, jnp.where(wide[:, None], white, 0))
    at = jnp.matmul(basis, drawn, precision=jax.lax.Precision.HIGHEST)
    equations, *_ = gauss_newton.linearized(manifold, rows, given, at, plan.prior)
    factor = gauss_newton.factorized(equations, basis, plan.prior)
    found = _cholesky.conditional(factor, white, drawn, wide)
    both = jnp.where(wide[:, None, None], plan.factor, factor)
    noise = jnp.matmul(basis, found, precision=jax.lax.Precision.HIGHEST)
    return noise.T, log_normal(both, white)


def log_normal(factor: Array, z: Array) -> Array:
    """Log-density (N,) of a Gaussian with that factor, where its standard normals are z (d, N)."""
    numbers = jnp.arange(z.shape[0])
    constant = z.shape[0] * jnp.log(2 * jnp.pi).astype(z.dtype) / 2
    return jnp.sum(jnp.log(factor[numbers, numbers]) - z * z / 2, axis=0) - constant


def mixed(transition: Transition, share: float, params: PyTree, measurement: PyTree, noise: Array, key: Array) -> Array:
    """Replace a share of the noise (N, d) by draws from the transition."""
    choice, draw = jax.random.split(jax.random.fold_in(key, 1))
    plain = transition.draw(params, measurement, draw, noise.shape[0])
    chosen = jax.random.uniform(choice, (noise.shape[0], 1), noise.dtype) < share
    return jnp.where(chosen, plain, noise)
