"""What a manifold and a group must offer, and the two checks that all of them share."""

from typing import Any, Protocol

import jax.numpy as jnp

from jaxest.types import Array, ArrayLike, PyTree


class Manifold(Protocol):
    """A space of elements `x` (a pytree) with tangent vectors `v` of shape (dim,); a module or an object.

    For every `v` within half a turn `local(x, retract(x, v))` is `v`. Perturbations are on the right: on a group
    `retract(x, v)` is `compose(x, exp(v))`.
    """

    @property
    def dim(self) -> int:
        """Length of a tangent vector."""
        ...

    @property
    def retract(self) -> Any:
        """`(x, v) -> y`: go from `x` along the tangent vector `v` (dim,)."""
        ...

    @property
    def local(self) -> Any:
        """`(x, y) -> v`: the tangent vector (dim,) at `x` that leads to `y`."""
        ...

    @property
    def mean(self) -> Any:
        """`(xs, weights=None) -> m`: the point where the weighted sum of `local(m, xs)` vanishes; leaves (N, ...)."""
        ...

    @property
    def interpolate(self) -> Any:
        """`(x, y, t) -> z`: the point at the fraction `t` of the way from `x` to `y`, at constant speed."""
        ...


class Group(Manifold, Protocol):
    """A manifold whose elements compose; Jacobians are those of `exp`.

    `exp(v + d)` is `compose(exp(left_jacobian(v) d), exp(v))` and `compose(exp(v), exp(right_jacobian(v) d))` to
    first order in `d`. `compose(x, exp(v))` is `compose(exp(adjoint(x) v), x)`.
    """

    @property
    def identity(self) -> Any:
        """`(dtype=None) -> x`."""
        ...

    @property
    def exp(self) -> Any:
        """`v -> x`."""
        ...

    @property
    def log(self) -> Any:
        """`x -> v`, within half a turn."""
        ...

    @property
    def compose(self) -> Any:
        """`(x, y) -> z`."""
        ...

    @property
    def inverse(self) -> Any:
        """`x -> y`."""
        ...

    @property
    def adjoint(self) -> Any:
        """`x -> (dim, dim)`."""
        ...

    @property
    def left_jacobian(self) -> Any:
        """`v -> (dim, dim)`."""
        ...

    @property
    def left_jacobian_inverse(self) -> Any:
        """`v -> (dim, dim)`."""
        ...

    @property
    def right_jacobian(self) -> Any:
        """`v -> (dim, dim)`."""
        ...

    @property
    def right_jacobian_inverse(self) -> Any:
        """`v -> (dim, dim)`."""
        ...


def as_array(name: str, value: ArrayLike, *shape: int | None) -> Array:
    """Return `value` as a floating array and check its shape while tracing.

    Args:
        name: what the caller calls it.
        value: anything array-like.
        *shape: the expected shape; None stands for any length.

    Returns:
        The array, in its own floating type; integers become the default one.

    Raises:
        ValueError: the shape is another.
    """
    array = jnp.asarray(value)
    if array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        expected = "(" + ", ".join("N" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"
        raise ValueError(f"{name}: has shape {array.shape}, expected {expected} (vmap adds batch axes)")
    return array if jnp.issubdtype(array.dtype, jnp.floating) else array.astype(jnp.result_type(float))


def normalized(weights: ArrayLike | None, sample: Array) -> Array:
    """Return weights that sum to one, for the samples along the first axis of `sample`.

    Args:
        weights: (N,), any scale; None gives every sample the same.
        sample: (N, ...) array, whose dtype the weights take.

    Returns:
        (N,) weights. All zero weights stay zero.

    Raises:
        ValueError: the number of weights is not N.
    """
    count = sample.shape[0]
    if weights is None:
        return jnp.full((count,), 1.0 / count, sample.dtype)
    given = as_array("weights", weights, count).astype(sample.dtype)
    total = jnp.sum(given)
    return given / jnp.where(total == 0, 1.0, total)


__all__ = ["Group", "Manifold", "PyTree", "as_array", "normalized"]
