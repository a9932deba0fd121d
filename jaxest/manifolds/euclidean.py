"""Flat parts of a state: velocities, biases, gains."""

import dataclasses
import math

import jax
import jax.numpy as jnp

from jaxest.manifolds.base import as_array, normalized
from jaxest.types import Array, ArrayLike


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Euclidean:
    """Arrays of one shape with addition; `Euclidean((3,))` is space, `Euclidean()` a number."""

    shape: tuple[int, ...] = ()
    """Shape of an element."""

    @property
    def dim(self) -> int:
        """Length of a tangent vector, the number of entries."""
        return math.prod(self.shape)

    def retract(self, x: ArrayLike, v: ArrayLike) -> Array:
        """Return `x + v` for an element `x` and a tangent vector `v` (dim,); raises ValueError for another shape."""
        return as_array("x", x, *self.shape) + as_array("v", v, self.dim).reshape(self.shape)

    def local(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return `y - x` as a tangent vector (dim,); raises ValueError for another shape."""
        return (as_array("y", y, *self.shape) - as_array("x", x, *self.shape)).reshape(self.dim)

    def mean(self, xs: ArrayLike, weights: ArrayLike | None = None) -> Array:
        """Return the weighted mean of elements (N, ...), weights (N,) of any scale; raises ValueError for a shape."""
        xs = as_array("xs", xs, None, *self.shape)
        return jnp.sum(normalized(weights, xs).reshape(-1, *(1 for _ in self.shape)) * xs, axis=0)

    def interpolate(self, x: ArrayLike, y: ArrayLike, t: ArrayLike) -> Array:
        """Return the element at the fraction `t` () of the way from `x` to `y`; raises ValueError for a shape."""
        return self.retract(x, t * self.local(x, y))


__all__ = ["Euclidean"]
