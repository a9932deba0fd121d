"""Plans of where guided particles go, and draws from the Gaussians that they hold."""

from collections.abc import Callable
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

GROUP = 64  # particles, or up to twice as many, whose Gaussians are looked at together


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
    scattered: Array
    """() bool, whether draws are weighed against many Gaussians together."""


def normals(key: Array, like: Array) -> Array:
    """Standard normals (d, N) in pairs of opposite signs."""
    size, count = like.shape
    z = jax.random.normal(key, (size, (count + 1) // 2), like.dtype)
    return jnp.concatenate([z, -z], axis=1)[:, :count]


def straight(plan: Plan, white: Array) -> tuple[Array, Array]:
    """Noise (N, d) from each particle's Gaussian, and its log-density (N,)."""
    return (plan.mode + _cholesky.solve(plan.factor, white)).T, log_normal(plan.factor, white)


def turned(plan: Plan, basis: Array, white: Array) -> tuple[Array, Array]:
    """Noise (N, d) from each particle's Gaussian in a basis, and its log-density (N,)."""
    noise, drawn = straight(plan, white)
    return jnp.matmul(noise, basis.T, precision=jax.lax.Precision.HIGHEST), drawn


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


def together(manifold: Manifold, plan: Plan, moved: PyTree, log_weights: Array) -> Array:
    """Log-density (N,) of states that were drawn from all Gaussians by turns, each state from its own.

    Whatever state one Gaussian leads to, the others' share in its density is counted: a state that many searches found
    weighs no more than one that a single search found. Among groups of particles, which sets a limit to the pairs.

    Args:
        manifold: where the state lives.
        plan: of the particles, straight Gaussians.
        moved: leaves (N, ...), one state from each.
        log_weights: (N,) of the Gaussians.

    Returns:
        The log-densities; without bias in every group, if states that went round weigh nothing.

    Source: Veach and Guibas 1995 (the balance heuristic); Elvira, Martino, Luengo, Bugallo 2015 (Efficient multiple
    importance sampling estimators) for the groups.
    """
    count = log_weights.shape[0]
    groups = next(n for n in range(max(count // GROUP, 1), 0, -1) if count % n == 0)

    def cut(x: Array) -> Array:  # the neighbours of a particle, often of its ancestor, are in other groups
        return x.reshape(count // groups, groups, *x.shape[1:])

    def of_group(centre: PyTree, mode: Array, factor: Array, moved: PyTree, share: Array) -> Array:
        def one(x: PyTree) -> Array:
            way = jax.vmap(manifold.local, (0, None))(centre, x).T
            if plan.basis is not None:
                way = jnp.matmul(plan.basis.T, way, precision=jax.lax.Precision.HIGHEST)
            return jax.nn.logsumexp(share + log_normal(factor, _cholesky.whiten(factor, way - mode)))

        return jax.vmap(one)(moved) - jax.nn.logsumexp(share)

    centre, moved = jax.tree.map(cut, (plan.centre, moved))
    mode, factor = (cut(jnp.moveaxis(x, -1, 0)) for x in (plan.mode, plan.factor))
    given = (centre, jnp.moveaxis(mode, 0, -1), jnp.moveaxis(factor, 0, -1), moved, cut(log_weights))
    return jax.vmap(of_group, (1, 0, 0, 1, 1), 1)(*given).reshape(count)


def seldom(so: Array, function: Callable[..., Array], operands: PyTree, otherwise: Array) -> Array:
    """A branch that a batch skips too where none of its items takes it, as loops do and branches do not.

    What it computes hangs on the loop's counter by a barrier: XLA moves out of a loop what does not change in it, and
    would compute it always.
    """

    def once(i: Array, now: Array) -> Array:
        given, _ = jax.lax.optimization_barrier((operands, i))
        return function(*given).astype(now.dtype)

    found: Array = jax.lax.fori_loop(0, so.astype(jnp.int32), once, otherwise)
    return found


def mixed(transition: Transition, share: float, params: PyTree, measurement: PyTree, noise: Array, key: Array) -> Array:
    """Replace a share of the noise (N, d) by draws from the transition."""
    choice, draw = jax.random.split(jax.random.fold_in(key, 1))
    plain = transition.draw(params, measurement, draw, noise.shape[0])
    chosen = jax.random.uniform(choice, (noise.shape[0], 1), noise.dtype) < share
    return jnp.where(chosen, plain, noise)
