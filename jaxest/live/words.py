"""Pytrees as vectors of 32-bit words: one array in and one out, where each array of a call costs microseconds."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.types import Array, PyTree

WORD = np.dtype(np.uint32)


class Leaf(NamedTuple):
    """Where an array is in a vector of words."""

    shape: tuple[int, ...]
    dtype: np.dtype
    words: slice


class Layout(NamedTuple):
    """How a pytree lies in a vector of words: bits as they are, a boolean in a word of its own."""

    structure: Any
    leaves: tuple[Leaf, ...]
    words: int
    """Length of the vector."""

    def pack(self, tree: PyTree) -> Array:
        """Return the words of a pytree of JAX arrays; for use inside `jit`.

        Args:
            tree: of this layout; cast to its dtypes.

        Returns:
            (words,) uint32.
        """
        found = zip(self.structure.flatten_up_to(tree), self.leaves, strict=True)
        pieces = [_to_words(jnp.asarray(x, leaf.dtype)) for x, leaf in found]
        return jnp.concatenate(pieces) if pieces else jnp.zeros(0, WORD)

    def unpack(self, words: Array) -> PyTree:
        """Return the pytree of JAX arrays that words stand for; for use inside `jit`.

        Args:
            words: (words,) uint32.

        Returns:
            The pytree.
        """
        return jax.tree.unflatten(self.structure, [_from_words(words[leaf.words], leaf) for leaf in self.leaves])

    def write(self, tree: PyTree) -> NDArray[np.uint32]:
        """Return the words of a pytree of NumPy arrays.

        Args:
            tree: of this layout; cast to its dtypes.

        Returns:
            (words,) uint32.

        Raises:
            ValueError: an array of another shape.
        """
        words = np.empty(self.words, WORD)
        for leaf, x in zip(self.leaves, self.structure.flatten_up_to(tree), strict=True):
            if np.shape(x) != leaf.shape:
                name = jax.tree_util.keystr(jax.tree_util.tree_leaves_with_path(tree)[self.leaves.index(leaf)][0])
                raise ValueError(f"{name}: got an array of shape {np.shape(x)}, expected {leaf.shape}")
            piece = words[leaf.words]
            (piece if leaf.dtype == bool else piece.view(leaf.dtype))[:] = np.reshape(x, -1)
        return words

    def read(self, words: NDArray[np.uint32]) -> PyTree:
        """Return the pytree of NumPy arrays that words stand for; views of them, but for booleans.

        Args:
            words: (words,) uint32.

        Returns:
            The pytree.
        """
        return jax.tree.unflatten(self.structure, [_read(words[leaf.words], leaf) for leaf in self.leaves])


def layout(tree: PyTree) -> Layout | None:
    """Return how a pytree lies in words.

    Args:
        tree: arrays or their shapes and dtypes.

    Returns:
        The layout; None where a leaf is neither boolean nor an integer or a real number of 32 or 64 bits.
    """
    found, structure = jax.tree.flatten(tree)
    leaves, at = [], 0
    for x in found:
        if x.dtype != bool and not (jnp.issubdtype(x.dtype, np.number) and x.dtype.itemsize in (4, 8)):
            return None
        if jnp.issubdtype(x.dtype, np.complexfloating):
            return None
        count = math.prod(x.shape) * (1 if x.dtype == bool else x.dtype.itemsize // WORD.itemsize)
        leaves.append(Leaf(x.shape, np.dtype(x.dtype), slice(at, at := at + count)))
    return Layout(structure, tuple(leaves), at)


def _to_words(x: Array) -> Array:
    x = jnp.ravel(x)
    return x.astype(WORD) if x.dtype == bool else jax.lax.bitcast_convert_type(x, WORD).ravel()


def _from_words(words: Array, leaf: Leaf) -> Array:
    if leaf.dtype == bool:
        return (words != 0).reshape(leaf.shape)
    shape = leaf.shape if leaf.dtype.itemsize == WORD.itemsize else (*leaf.shape, 2)
    return jax.lax.bitcast_convert_type(words.reshape(shape), leaf.dtype)


def _read(words: NDArray[np.uint32], leaf: Leaf) -> NDArray[Any]:
    return (words != 0 if leaf.dtype == bool else words.view(leaf.dtype)).reshape(leaf.shape)


__all__ = ["Layout", "Leaf", "layout"]
