"""Symmetric 4 x 4 matrices of quaternions."""

from jaxest.linalg._eigen4 import eigen4 as eigh
from jaxest.manifolds._algebra import matmul as product
from jaxest.types import Array


def inner(v: Array, matrix: Array) -> Array:
    """Return v^T matrix v."""
    return product(v.T, product(matrix, v))


def outer(v: Array, values: Array) -> Array:
    """Return v diag(values) v^T."""
    return product(v * values[None, :], v.T)


__all__ = ["eigh", "inner", "outer", "product"]
