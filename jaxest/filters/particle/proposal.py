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
from jaxest.filters.particle.transition import Transition, log_density
from jaxest.manifolds.base import Manifold
from jaxest.types import Array, PyTree

LogLikelihood = Callable[[PyTree, PyTree, PyTree], Array]
"""`(params, x, measurement) -> ()`, exactly 0 for a sensor that is missing."""
Rows = Callable[[PyTree, PyTree, PyTree], tuple[Array, Array]]
"""`(params, x, measurement) -> (m,), (m, d)`: residuals r with log-likelihood about -|r|^2 / 2, and their derivatives
in the tangent space at x; zeros where missing."""


class Proposal(Protocol):
    """Sends all particles on.

    One that also has `look` and `send`, as `Guided` has them, is asked before it is chosen who goes on.
    """

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
    mean = each(transition.mean)(fixed, particles, seen)
    noise = transition.draw(fixed, seen, key, count)
    moved = jax.lax.stop_gradient(jax.vmap(manifold.retract)(mean, noise))
    density = partial(densities, manifold, transition)
    weight = each(log_likelihood)(params, moved, measurement)
    return moved, weight + _silent(density, params, particles, moved, noise, measurement)


def densities(manifold: Manifold, transition: Transition, *arguments: Any) -> Array:
    """Transition log-densities (N,) of (params, particles, moved, noise, measurement)."""
    return jax.vmap(partial(log_density, manifold, transition), (None, 0, 0, 0, None))(*arguments)


def each(function: Callable) -> Callable:
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


__all__ = ["LogLikelihood", "Proposal", "Rows", "bootstrap", "densities", "differentiated", "each"]
