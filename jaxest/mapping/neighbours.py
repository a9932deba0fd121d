"""Nearest neighbours over the cells around a point."""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.mapping.layout import Layout, cells
from jaxest.mapping.voxels import VoxelMap
from jaxest.types import Array

INDEX = 127  # bits of a distance that make room for the candidate's number
MOST = 2000.0  # readings of a voxel that count
FAR = 0x7FFFFFFF


class Neighbours(NamedTuple):
    """The k nearest map points of n points, nearest first."""

    row: Array
    """(k, n) int32, their rows of the map; 0 where there is none."""
    there: Array
    """(k, n) bool, which of them exist."""


def nearest(
    layout: Layout,
    chart: VoxelMap,
    point: Array,
    scatter: Array | None = None,
    *,
    k: int = 5,
    cap: float = 0.5,
    reach: int = 2,
) -> Neighbours:
    """Find the nearest points of a map.

    Distances are ranked to a part in 65,000: nearer ties may change places.

    Args:
        layout: the map's.
        chart: the map.
        point: (n, 3) m.
        scatter: (n,) m, or None: how far each point may be from where it seems. Neighbours are then ranked by how
            likely they are to be of the same surface, not by distance alone: one that was read often comes before one
            that was read once, which may be there by its own error, and by the point's.
        k: neighbours.
        cap: m, farther ones do not count. Exact up to `reach` cells' width; beyond that some may be missed.
        reach: cells looked at on each side: 1 makes 27, 2 makes 125.

    Returns:
        The neighbours.

    Raises:
        ValueError: another reach.
    """
    if reach not in (1, 2):
        raise ValueError(f"reach: got {reach}, expected 1 or 2 cells")
    side = np.arange(-reach, reach + 1)
    offsets = np.array(list(itertools.product(side, side, side)), np.int32)
    x, y, z = (point[:, i] for i in range(3))
    a, b, c = cells(layout, (x, y, z))
    o = jnp.asarray(offsets)
    slot = layout.slot((a[None] + o[:, 0, None], b[None] + o[:, 1, None], c[None] + o[:, 2, None]))
    row = jnp.where(slot < layout.slots, chart.table[jnp.minimum(slot, layout.slots - 1)], -1)
    at = jnp.maximum(row, 0)
    squared = sum((chart.point[:, i][at] - v[None]) ** 2 for i, v in enumerate((x, y, z)))
    there = (row >= 0) & (squared < cap * cap)
    if scatter is not None:
        rare = 2 * jnp.log(MOST / jnp.clip(chart.total[:, 3], 1, MOST))
        squared = squared + scatter[None] ** 2 * rare[at]
    squared = jnp.where(there, squared, jnp.inf).astype(jnp.float32)
    # Without the barrier XLA gathers anew in each of the k passes.
    at, squared = jax.lax.optimization_barrier((at, jax.lax.stop_gradient(squared)))
    return _smallest(at, squared, k)


def _smallest(row: Array, squared: Array, k: int) -> Neighbours:
    """Keep the k smallest of each column by k passes of minima, for small k quicker than sorting.

    Positive floats are ordered as their bits are; the last bits give way to the candidate's number, so that one
    minimum finds both.
    """
    number = jnp.arange(row.shape[0], dtype=jnp.int32)[:, None]
    key = (jax.lax.bitcast_convert_type(squared, jnp.int32) & ~INDEX) | number
    found = []
    for _ in range(k):
        least = jnp.min(key, axis=0)
        found.append(least)
        key = jnp.where(key == least[None], jnp.int32(FAR), key)
    chosen = jnp.stack(found)
    infinite = jax.lax.bitcast_convert_type(jnp.float32(jnp.inf), jnp.int32)
    there = chosen < infinite
    picked = jnp.take_along_axis(row, jnp.where(there, chosen & INDEX, 0), axis=0)
    return Neighbours(jnp.where(there, picked, 0), there)


__all__ = ["Neighbours", "nearest"]
