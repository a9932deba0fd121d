"""Where a cell of space has its slot in a table of fixed size."""

import dataclasses
import math
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.types import Array, InputError


class Layout(Protocol):
    """Static: a voxel size and a rule from cells to slots."""

    @property
    def voxel(self) -> float:
        """Edge of a cell, m."""
        ...

    @property
    def slots(self) -> int:
        """Length of the table."""
        ...

    def slot(self, cell: tuple[Array, Array, Array]) -> Array:
        """Return the slots of cells given by three int32 arrays; `slots` where a cell has none."""
        ...


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Grid:
    """A dense grid over a known volume; points outside have no slot and are counted."""

    voxel: float
    """m."""
    lower: tuple[float, float, float]
    """m, corner of the volume."""
    shape: tuple[int, int, int]
    """Cells along each axis."""

    @property
    def slots(self) -> int:
        """Length of the table."""
        return math.prod(self.shape)

    def slot(self, cell: tuple[Array, Array, Array]) -> Array:
        """Return slots, `slots` outside the volume."""
        first = [math.floor(x / self.voxel) for x in self.lower]
        at = [c - f for c, f in zip(cell, first, strict=True)]
        inside = jnp.ones(at[0].shape, bool)
        for a, n in zip(at, self.shape, strict=True):
            inside = inside & (a >= 0) & (a < n)
        flat = (at[0] * self.shape[1] + at[1]) * self.shape[2] + at[2]
        return jnp.where(inside, flat, self.slots)


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Hashed:
    """Unknown space folded onto a table: cells whose numbers are equal modulo `shape` share a slot.

    Within any box of that many cells none collide, so that a neighbourhood is always whole; a cell whose slot belongs
    to another place is not stored and counted as overflow.
    """

    voxel: float
    """m."""
    shape: tuple[int, int, int] = (64, 64, 32)
    """Powers of two: 12.8 x 12.8 x 6.4 m at 0.2 m."""

    def __post_init__(self) -> None:
        """Refuse a shape that does not fold by its bits."""
        if any(n < 8 or n & (n - 1) for n in self.shape):
            raise InputError(f"shape: {self.shape}, expected powers of two, 8 or more")

    @property
    def slots(self) -> int:
        """Length of the table."""
        return math.prod(self.shape)

    def slot(self, cell: tuple[Array, Array, Array]) -> Array:
        """Return slots."""
        x, y, z = (c & (n - 1) for c, n in zip(cell, self.shape, strict=True))
        return (x * self.shape[1] + y) * self.shape[2] + z


def grid(lower: np.ndarray, upper: np.ndarray, voxel: float = 0.2) -> Grid:
    """Return the dense grid that covers a box (3,) to (3,) m, a cell wider on each side."""
    low = np.floor(np.asarray(lower) / voxel).astype(int) - 1
    shape = np.ceil(np.asarray(upper) / voxel).astype(int) + 1 - low
    if np.any(shape < 1):
        raise InputError(f"upper: {upper}, expected beyond lower, {lower}")
    a, b, c = (float(x) for x in low * voxel + voxel / 2)
    nx, ny, nz = (int(n) for n in shape)
    return Grid(voxel, (a, b, c), (nx, ny, nz))


def cells(layout: Layout, x: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """Return the cells (int32) of coordinates in m."""
    a, b, c = (jnp.floor(v / layout.voxel).astype(jnp.int32) for v in x)
    return a, b, c


__all__ = ["Grid", "Hashed", "Layout", "cells", "grid"]
