"""Gaussian beliefs on a manifold, and carrying them through a function."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import block_diag

from jaxest.manifolds._algebra import matmul as product
from jaxest.manifolds.base import Manifold, as_array
from jaxest.types import Array, ArrayLike, PyTree


class Gaussian(NamedTuple):
    """The true element is `retract(mean, error)` with an error of mean zero."""

    mean: PyTree
    """An element of the manifold."""
    covariance: Array
    """(n, n) of the error, in the tangent space at the mean; may be singular."""


def independent(*beliefs: Gaussian) -> Gaussian:
    """Put independent beliefs side by side.

    A noise that enters a function in its own way is one of them: `Gaussian(jnp.zeros(q), Q)` on `Euclidean((q,))`.

    Args:
        *beliefs: any number, on any manifolds.

    Returns:
        The belief about the tuple of their elements, on `product.of((manifold, ...))`; its covariance is block
        diagonal.
    """
    return Gaussian(tuple(b.mean for b in beliefs), block_diag(*(b.covariance for b in beliefs)))


def predict(
    manifold: Manifold,
    belief: Gaussian,
    dynamics: Callable[[PyTree], PyTree],
    noise: ArrayLike | None = None,
    *,
    target: Manifold | None = None,
    jacobian: Callable[[PyTree], ArrayLike] | None = None,
) -> Gaussian:
    """Carry a belief through a function: from one time to the next, from one link to the next.

    Args:
        manifold: where the belief lives, dimension n.
        belief: mean and covariance (n, n).
        dynamics: `x -> y`.
        noise: (k, k) covariance added in the tangent space at y; None adds nothing. Noise that enters otherwise is
            made part of x with `independent`.
        target: where y lives, dimension k; `manifold` if None.
        jacobian: `x -> (k, n)` derivative of y's tangent by x's; by forward differentiation if None.

    Returns:
        The belief about y, its covariance symmetric.

    Raises:
        ValueError: a covariance has another shape.

    Source: Iwao 2025, eqs. 19 and 20; with a joint belief about parent and past (any cross-covariance) instead of two.
    """
    target = manifold if target is None else target
    covariance = as_array("belief.covariance", belief.covariance, manifold.dim, manifold.dim)
    mean = dynamics(belief.mean)
    if jacobian is None:

        def moved(v: Array) -> Array:
            return target.local(mean, dynamics(manifold.retract(belief.mean, v)))

        slope = jax.jacfwd(moved)(jnp.zeros(manifold.dim, covariance.dtype))
    else:
        slope = as_array("jacobian", jacobian(belief.mean), target.dim, manifold.dim)
    carried = sandwich(slope, covariance)
    if noise is not None:
        carried = carried + as_array("noise", noise, target.dim, target.dim)
    return Gaussian(mean, symmetric(carried))


def sandwich(a: Array, p: Array) -> Array:
    """Return `a p a'`."""
    return product(product(a, p), a.T)


def symmetric(p: Array) -> Array:
    """Return the symmetric part of a matrix."""
    return (p + p.T) / 2


__all__ = ["Gaussian", "independent", "predict", "product", "sandwich", "symmetric"]
