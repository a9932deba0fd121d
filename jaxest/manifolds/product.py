"""Products: states put together from manifolds, as a tree (`of`) or as many of one kind (`Power`)."""

import dataclasses
import itertools
from typing import Any

import jax
import jax.numpy as jnp

from jaxest.manifolds.base import Manifold, as_array
from jaxest.types import Array, ArrayLike, PyTree


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Product:
    """A tree of manifolds; an element is the same tree of their elements, a tangent vector all theirs in one (dim,).

    Built by `of`. It is static: hashable, and a leafless pytree.
    """

    parts: tuple[Manifold, ...]
    """The manifolds, in the order of the tree's leaves, which is the order of the tangent vector."""
    structure: Any
    """The tree they came in (a `PyTreeDef`)."""

    @property
    def dim(self) -> int:
        """Length of a tangent vector."""
        return sum(part.dim for part in self.parts)

    def split(self, v: ArrayLike) -> PyTree:
        """Return the tangent vector (dim,) as a tree of the parts' tangent vectors; raises ValueError for a shape."""
        return jax.tree.unflatten(self.structure, self._pieces(v))

    def join(self, tree: PyTree) -> Array:
        """Return the tangent vector (dim,) of a tree of the parts' tangent vectors, the inverse of `split`."""
        return jnp.concatenate(self._elements("tree", tree))

    def retract(self, x: PyTree, v: ArrayLike) -> PyTree:
        """Return the element at the tangent vector `v` (dim,) from `x`; raises ValueError for another structure."""
        return self._build(lambda part, x, v: part.retract(x, v), self._elements("x", x), self._pieces(v))

    def local(self, x: PyTree, y: PyTree) -> Array:
        """Return the tangent vector (dim,) from `x` to `y`; raises ValueError for another structure."""
        pairs = zip(self.parts, self._elements("x", x), self._elements("y", y), strict=True)
        return jnp.concatenate([part.local(a, b) for part, a, b in pairs])

    def mean(self, xs: PyTree, weights: ArrayLike | None = None) -> PyTree:
        """Return the mean of every part; leaves of `xs` (N, ...), weights (N,) of any scale; raises ValueError."""
        return self._build(lambda part, xs: part.mean(xs, weights), self._elements("xs", xs))

    def interpolate(self, x: PyTree, y: PyTree, t: ArrayLike) -> PyTree:
        """Return the element at the fraction `t` () of the way from `x` to `y`; raises ValueError for a structure."""
        return self._build(lambda part, a, b: part.interpolate(a, b, t), self._elements("x", x), self._elements("y", y))

    def _build(self, method: Any, *elements: list[Any]) -> PyTree:
        return jax.tree.unflatten(self.structure, [method(*row) for row in zip(self.parts, *elements, strict=True)])

    def _pieces(self, v: ArrayLike) -> list[Array]:
        v = as_array("v", v, self.dim)
        ends = list(itertools.accumulate(part.dim for part in self.parts))
        return [v[end - part.dim : end] for part, end in zip(self.parts, ends, strict=True)]

    def _elements(self, name: str, tree: PyTree) -> list[Any]:
        try:
            return self.structure.flatten_up_to(tree)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{name}: expected the tree {self.structure}; {error}") from None


def of(tree: PyTree) -> Product:
    """Return the product of a tree of manifolds.

    Args:
        tree: NamedTuple, tuple, list or dict (nested at will) whose leaves are manifolds: the modules `circle`,
            `quaternion`, `so3`, `se3`, or objects such as `Euclidean((3,))`, `Power(circle, 7)`, another product.

    Returns:
        The product manifold.

    Raises:
        ValueError: a leaf is no manifold.
    """
    parts, structure = jax.tree.flatten(tree, is_leaf=_is_manifold)
    for part in parts:
        if not _is_manifold(part):
            raise ValueError(f"tree: has the leaf {part!r}, expected a manifold (quaternion, Euclidean((3,)), ...)")
    return Product(tuple(parts), structure)


def _is_manifold(x: Any) -> bool:
    return all(hasattr(x, name) for name in ("dim", "retract", "local", "mean", "interpolate"))


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Power:
    """Several copies of one manifold, stacked along the first axis: `Power(circle, 7)` is the torus of seven joints."""

    base: Manifold
    """The manifold."""
    count: int
    """How many."""

    @property
    def dim(self) -> int:
        """Length of a tangent vector, one copy's after the other's."""
        return self.count * self.base.dim

    def retract(self, x: PyTree, v: ArrayLike) -> PyTree:
        """Return the element at the tangent vector `v` (dim,) from `x` (count, ...); raises ValueError for a shape."""
        return jax.vmap(self.base.retract)(x, as_array("v", v, self.dim).reshape(self.count, self.base.dim))

    def local(self, x: PyTree, y: PyTree) -> Array:
        """Return the tangent vector (dim,) from `x` (count, ...) to `y`; raises ValueError for another shape."""
        return jax.vmap(self.base.local)(x, y).reshape(self.dim)

    def mean(self, xs: PyTree, weights: ArrayLike | None = None) -> PyTree:
        """Return the mean of every copy; leaves of `xs` (N, count, ...), weights (N,) of any scale."""
        return jax.vmap(self.base.mean, in_axes=(1, None))(xs, weights)

    def interpolate(self, x: PyTree, y: PyTree, t: ArrayLike) -> PyTree:
        """Return the element at the fraction `t` () of the way from `x` to `y`."""
        return jax.vmap(self.base.interpolate, in_axes=(0, 0, None))(x, y, t)


__all__ = ["Power", "Product", "of"]
