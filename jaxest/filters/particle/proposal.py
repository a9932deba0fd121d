"""Where particles are sent: by the transition alone, or by a look at the measurement first.

Whatever the way, the weights are exact: likelihood times transition density over the density that was drawn from.
Draws are constants to differentiation, and the weights carry the derivative of likelihood and transition density at
fixed particles. The gradient of a filter's log-likelihood is therefore an estimate of the score by Fisher's identity,
and not that of one frozen set of random numbers, which resampling would make wrong by orders of magnitude.

Source: Scibior and Wood 2021 (Differentiable particle filtering without modifying the forward pass).
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from jaxest.derivatives import settled
from jaxest.filters.particle import _cholesky
from jaxest.filters.particle._flat import flat
from jaxest.filters.particle.transition import Transition, log_density
from jaxest.manifolds.base import Manifold
from jaxest.types import Array, PyTree

LogLikelihood = Callable[[PyTree, PyTree, PyTree], Array]
"""`(params, x, measurement) -> ()`, exactly 0 for a sensor that is missing."""
Rows = Callable[[PyTree, PyTree, PyTree], tuple[Array, Array]]
"""`(params, x, measurement) -> (m,), (m, d)`: residuals r with log-likelihood about -|r|^2 / 2, and their derivatives
in the tangent space at x; zeros where missing."""


class Proposal(Protocol):
    """Sends all particles on."""

    def __call__(self, params: PyTree, particles: PyTree, measurement: PyTree, key: Array) -> tuple[PyTree, Array]:
        """Return the new particles, leaves (N, ...), and the logarithms (N,) of their weights' factors."""
        ...


def bootstrap(manifold: Manifold, transition: Transition, log_likelihood: LogLikelihood) -> Proposal:
    """Draw from the transition and weigh by the likelihood.

    Args:
        manifold: where the state lives, dimension d.
        transition: how it moves; `precision` is not asked for.
        log_likelihood: `(params, x, measurement) -> ()`.

    Returns:
        The proposal.

    Source: Sato 2023, eqs. 18 and 19.
    """
    return partial(_bootstrap, manifold, transition, log_likelihood)


def guided(
    manifold: Manifold,
    transition: Transition,
    log_likelihood: LogLikelihood,
    rows: Rows,
    *,
    iterations: int = 2,
    defensive: float = 0.0,
) -> Proposal:
    """Draw each particle from a Gaussian about its own most probable next state, found by Gauss-Newton.

    The Gaussian lives in the tangent space at the transition's mean, with information `Q^-1 + J'J`. A residual that is
    not finite leaves that particle the transition's own Gaussian.

    Where the measurement fits several states within reach of the transition's noise (a position alone, say), each
    particle goes to one of them; weights are exact, but states that no particle visits are missed, in the evidence
    too, and nothing shows it. A defensive share is the remedy: no weight then exceeds likelihood / share.

    Args:
        manifold: where the state lives, dimension d.
        transition: how it moves.
        log_likelihood: `(params, x, measurement) -> ()`, exact, for the weights.
        rows: `(params, x, measurement) -> (m,), (m, d)`, linearised, for the proposal; `differentiated` makes them
            from the residuals alone.
        iterations: Gauss-Newton steps, static. One is enough where the measurement is close to linear over the
            transition's noise.
        defensive: share of the particles that are drawn from the transition instead, static; all are weighed against
            the mixture. Costs about that share of the effective sample size where there is one mode.

    Returns:
        The proposal.

    Raises:
        ValueError: `iterations` below 1, or `defensive` outside [0, 1).

    Source: the mixture is that of Hesterberg 1995 (Weighted average importance sampling and defensive mixture
    distributions).
    """
    if iterations < 1:
        raise ValueError(f"iterations: got {iterations}, expected at least 1")
    if not 0 <= defensive < 1:
        raise ValueError(f"defensive: got {defensive}, expected a share from 0 to below 1")
    return partial(_guided, manifold, transition, log_likelihood, rows, iterations, float(defensive))


def differentiated(manifold: Manifold, residual: Callable[[PyTree, PyTree, PyTree], Array]) -> Rows:
    """Return residuals with their derivatives by forward differentiation.

    Args:
        manifold: where the state lives, dimension d.
        residual: `(params, x, measurement) -> (m,)` with unit noise; 0 where missing, whatever x is.

    Returns:
        `(params, x, measurement) -> (m,), (m, d)`.
    """

    def rows(params: PyTree, x: PyTree, measurement: PyTree) -> tuple[Array, Array]:
        def moved(v: Array) -> tuple[Array, Array]:
            value = residual(params, manifold.retract(x, v), measurement)
            return value, value

        dtype = jnp.result_type(*jax.tree.leaves(x))
        jacobian, value = jax.jacfwd(moved, has_aux=True)(jnp.zeros(manifold.dim, dtype))
        return value, jacobian

    return rows


def _bootstrap(
    manifold: Manifold,
    transition: Transition,
    log_likelihood: LogLikelihood,
    params: PyTree,
    particles: PyTree,
    measurement: PyTree,
    key: Array,
) -> tuple[PyTree, Array]:
    fixed, seen, particles = jax.lax.stop_gradient((params, measurement, particles))
    count = jax.tree.leaves(particles)[0].shape[0]
    mean = _each(transition.mean)(fixed, particles, seen)
    noise = transition.draw(fixed, seen, key, count)
    moved = jax.lax.stop_gradient(jax.vmap(manifold.retract)(mean, noise))
    density = partial(_densities, manifold, transition)
    weight = _each(log_likelihood)(params, moved, measurement)
    return moved, weight + _silent(density, params, particles, moved, noise, measurement)


def _guided(
    manifold: Manifold,
    transition: Transition,
    log_likelihood: LogLikelihood,
    rows: Rows,
    iterations: int,
    defensive: float,
    params: PyTree,
    particles: PyTree,
    measurement: PyTree,
    key: Array,
) -> tuple[PyTree, Array]:
    fixed, seen, particles = jax.lax.stop_gradient((params, measurement, particles))
    mean = _each(transition.mean)(fixed, particles, seen)
    factor = _posterior(manifold, transition.precision(fixed, seen), rows, iterations, (fixed, mean, seen))
    noise, drawn = _draw(factor, key)
    if defensive:
        noise = _mixed(transition, defensive, fixed, seen, noise, key)
    noise = jax.lax.stop_gradient(noise)
    moved = jax.lax.stop_gradient(jax.vmap(manifold.retract)(mean, noise))
    density = _densities(manifold, transition, params, particles, moved, noise, measurement)
    if defensive:
        guided = jnp.log1p(-defensive) + _log_normal(factor, _cholesky.whiten(factor, noise.T))
        drawn = jnp.logaddexp(guided, jnp.log(defensive) + density)
    weight = _each(log_likelihood)(params, moved, measurement)
    return moved, weight + density - jax.lax.stop_gradient(drawn)


def _posterior(
    manifold: Manifold, precision: Array, rows: Rows, iterations: int, given: tuple[PyTree, PyTree, PyTree]
) -> Array:
    """Factor (d, d + 1, N) of each particle's Gaussian, after Gauss-Newton from its transition's mean."""
    leaf = jax.tree.leaves(given[1])[0]
    size, count = manifold.dim, leaf.shape[0]
    precision = jnp.asarray(precision, leaf.dtype)
    if precision.shape not in ((size,), (size, size)):
        raise ValueError(f"precision: has shape {precision.shape}, expected ({size},) or ({size}, {size})")
    diagonal = precision.ndim == 1
    # No pivot of Q^-1 + J'J is smaller: rounding must not make it so where J'J is large and of low rank.
    floor = precision if diagonal else 1 / jnp.diagonal(jnp.linalg.inv(precision))
    prior = jnp.diag(precision) if diagonal else precision

    def linearized(at: Array) -> Array:
        return _cholesky.factorize(_equations(manifold, rows, given, at, prior), floor)

    def improved(_: int, at: Array) -> Array:
        factor = linearized(at)
        return _cholesky.solve(factor, factor[:, -1])

    start = jnp.zeros((size, count), leaf.dtype)
    return linearized(jax.lax.fori_loop(0, iterations - 1, improved, start))


def _draw(factor: Array, key: Array) -> tuple[Array, Array]:
    """Noise (N, d) from each particle's Gaussian, and its log-density (N,)."""
    z = jax.random.normal(key, (factor.shape[0], factor.shape[2]), factor.dtype)
    return _cholesky.solve(factor, factor[:, -1] + z).T, _log_normal(factor, z)


def _log_normal(factor: Array, z: Array) -> Array:
    """Log-density (N,) of a Gaussian with that factor, where its standard normals are z (d, N)."""
    rows = jnp.arange(z.shape[0])
    constant = z.shape[0] * jnp.log(2 * jnp.pi).astype(z.dtype) / 2
    return jnp.sum(jnp.log(factor[rows, rows]) - z * z / 2, axis=0) - constant


def _mixed(
    transition: Transition, share: float, params: PyTree, measurement: PyTree, noise: Array, key: Array
) -> Array:
    """Replace a share of the noise (N, d) by draws from the transition."""
    choice, draw = jax.random.split(jax.random.fold_in(key, 1))
    plain = transition.draw(params, measurement, draw, noise.shape[0])
    chosen = jax.random.uniform(choice, (noise.shape[0], 1), noise.dtype) < share
    return jnp.where(chosen, plain, noise)


def _equations(manifold: Manifold, rows: Rows, given: tuple[PyTree, PyTree, PyTree], at: Array, prior: Array) -> Array:
    """Equations (d, d + 1, N) of the Gauss-Newton step from the noise `at` (d, N), prior included."""

    def one(params: PyTree, mean: PyTree, measurement: PyTree, v: Array) -> tuple[Array, Array]:
        x = manifold.retract(mean, v)
        value, jacobian = rows(params, x, measurement)
        if not flat(manifold):
            turn = jax.jacfwd(lambda v: manifold.local(x, manifold.retract(mean, v)))(v)
            jacobian = jnp.matmul(jacobian, turn, precision=jax.lax.Precision.HIGHEST)
        return value, jacobian

    value, jacobian = jax.vmap(one, (None, 0, None, 1), out_axes=-1)(*given, at)
    if jacobian.shape != (value.shape[0], *at.shape):
        raise ValueError(f"rows: got shapes {value.shape[:-1]} and {jacobian.shape[:-1]}, expected (m,) and (m, d)")
    equations = _cholesky.normal_equations(value, jacobian, at, prior)
    alone = jnp.concatenate([prior, jnp.zeros_like(prior[:, :1])], axis=1)[:, :, None]
    finite = jnp.all(jnp.isfinite(equations), axis=(0, 1), keepdims=True)
    return jnp.where(finite, equations, alone)


def _densities(manifold: Manifold, transition: Transition, *arguments: Any) -> Array:
    """Transition log-densities (N,) of (params, particles, moved, noise, measurement)."""
    return jax.vmap(partial(log_density, manifold, transition), (None, 0, 0, 0, None))(*arguments)


def _each(function: Callable) -> Callable:
    """The function for all particles: `(params, x, measurement)` with x batched."""
    return jax.vmap(function, (None, 0, None))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _silent(function: Callable[..., Array], *arguments: Any) -> Array:
    """Return zero with the derivative of `function(*arguments)`, which is not computed where none is asked for."""
    shape = jax.eval_shape(function, *arguments)
    # Batched where an argument is: a constant would have no batch axis for the derivative to share.
    touched = [jnp.where(False, jnp.sum(x), 0).astype(shape.dtype) for x in jax.tree.leaves(arguments)]
    return settled(jnp.zeros(shape.shape, shape.dtype) + sum(touched))


@_silent.defjvp
def _(function: Callable[..., Array], primals: Any, tangents: Any) -> tuple[Array, Array]:
    _, slope = jax.jvp(function, primals, tangents)
    return _silent(function, *primals), settled(slope)


__all__ = ["LogLikelihood", "Proposal", "Rows", "bootstrap", "differentiated", "guided"]
