"""A map of one point a voxel, in arrays of fixed size."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxest.mapping.layout import Layout, cells
from jaxest.types import Array, ArrayLike

FREE = -1
COUNT, MOMENT, CARRIED = 3, 4, 10
"""Where in a row's sums they begin."""
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
# Deviations of a reading at which its voxel is looked for; equals go to the first.
OFFSETS = (0.0, -1.0, 1.0, -2.0, 2.0, -3.0, 3.0)


class VoxelMap(NamedTuple):
    """A map; `layout` is static and goes beside it."""

    table: Array
    """(slots,) int32, the row of each slot, -1 where it is empty."""
    point: Array
    """(M, 3) m, the rows' points."""
    total: Array
    """(M, 10 + d) sums over a row's points: position, count, xx, xy, xz, yy, yz and zz about their mean, what they
    carry."""
    slot: Array
    """(M,) int32, each row's slot."""
    used: Array
    """() int32, rows in use."""
    overflow: Array
    """() int32, points that found no room: no row left, a slot of another place, or outside of the grid."""


def empty(layout: Layout, capacity: int, extra: int = 0, dtype: jnp.dtype | type = jnp.float32) -> VoxelMap:
    """Return a map without points.

    Args:
        layout: `Grid` or `Hashed`.
        capacity: M, voxels at most.
        extra: d, numbers that each point carries.
        dtype: of everything that is no whole number.

    Returns:
        The map.

    Raises:
        ValueError: no capacity.
    """
    if capacity < 1:
        raise ValueError(f"capacity: got {capacity}, expected at least 1")
    return VoxelMap(
        jnp.full(layout.slots, FREE, jnp.int32),
        jnp.zeros((capacity, 3), dtype),
        jnp.zeros((capacity, CARRIED + extra), dtype),
        jnp.full(capacity, layout.slots, jnp.int32),
        jnp.zeros((), jnp.int32),
        jnp.zeros((), jnp.int32),
    )


def insert(
    layout: Layout,
    chart: VoxelMap,
    point: Array,
    valid: Array,
    extra: Array | None = None,
    *,
    filed: Array | None = None,
    noise: Array | None = None,
    most: float = 1000.0,
    central: bool = False,
) -> VoxelMap:
    """Bring points into a map.

    Args:
        layout: the map's.
        chart: the map.
        point: (n, 3) m; any finite number where not valid.
        valid: (n,) bool.
        extra: (n, d) what the points carry, if the map carries anything.
        filed: (n, 3) m, in whose voxels the points count, as `likeliest` finds them; the points themselves if None.
        noise: (n, 3) m, standard deviation of each point along its ray, as a vector: how far points scatter for it is
            not counted to a voxel's moments, so that these are the surface's own. None if they have none.
        most: a voxel's mean moves as if it had seen at most about this many points.
        central: keep the point nearest to the voxel's centre instead of the mean.

    Returns:
        The map. Points that find no room are counted in `overflow` and change nothing else.
    """
    filed = point if filed is None else filed
    count = jnp.ones((point.shape[0], 1), point.dtype)
    rows, after = _rows(layout, chart, filed, valid)
    if central:
        none = jnp.zeros((point.shape[0], CARRIED - MOMENT), point.dtype)
        new = jnp.concatenate([point, count, none] + ([] if extra is None else [extra]), axis=1)
        total = _central(layout, after, point, rows, new)
        mean = total[jnp.minimum(rows, len(total) - 1), :COUNT]
        return after._replace(total=total, point=after.point.at[rows].set(mean, mode="drop"))
    about = _about(layout, chart, after, rows, filed)
    scattered = squares(point - about) - (0 if noise is None else squares(noise))
    new = jnp.concatenate([point, count, scattered] + ([] if extra is None else [extra]), axis=1)
    return _added(after, rows, new, about, most)


def squares(x: Array) -> Array:
    """Return xx, xy, xz, yy, yz and zz (n, 6) of vectors (n, 3)."""
    return jnp.stack([x[:, i] * x[:, j] for i, j in PAIRS], axis=1)


def _about(layout: Layout, before: VoxelMap, after: VoxelMap, rows: Array, filed: Array) -> Array:
    """Return about which points (n, 3) moments are taken, for all of a row the same: its mean, or its cell's centre."""
    at = jnp.minimum(rows, len(after.point) - 1)
    centre = (jnp.floor(filed / layout.voxel) + 0.5) * layout.voxel
    return jnp.where(before.total[at, COUNT, None] > 0, before.point[at], centre)


def _added(chart: VoxelMap, rows: Array, new: Array, about: Array, most: float = jnp.inf) -> VoxelMap:
    """Add sums (n, 10 + d), moments taken about points (n, 3), to rows, and take these about the new means."""
    total, at = chart.total.at[rows].add(new, mode="drop"), jnp.minimum(rows, len(chart.total) - 1)
    # Rows that several points share get the same from each: set, not multiplied.
    found = total[at]
    count = found[:, COUNT, None]
    mean = found[:, :COUNT] / jnp.where(count > 0, count, 1)
    share = jnp.where(count > 2 * most, 0.5, 1.0).astype(found.dtype)
    total = total.at[rows].set(share * found, mode="drop")
    # Written behind the rest: put into the rows, each number of a row would choose whether it is one of these.
    moment = share * (found[:, MOMENT:CARRIED] - count * squares(mean - about))
    total = total.at[rows, MOMENT:CARRIED].set(moment, mode="drop")
    return chart._replace(total=total, point=chart.point.at[rows].set(mean, mode="drop"))


def likeliest(layout: Layout, chart: VoxelMap, point: Array, ray: Array, scatter: Array) -> Array:
    """Say which voxel a reading of a surface belongs to: of those along its ray, one that was read often and is near.

    Points of one wall fall on both sides of a voxel's border when they scatter. Averaged on each side, the wall would
    have two layers, each off by the truncation of its noise, and a reading would be compared with the one it fell to.

    Args:
        layout: the map's.
        chart: the map.
        point: (n, 3) m, readings.
        ray: (n, 3) unit, along which they scatter.
        scatter: (n,) m, by how much.

    Returns:
        (n, 3) m, points in those voxels: the readings themselves where none is likelier.
    """
    steps = jnp.asarray(OFFSETS, point.dtype)[:, None, None]
    along = point[None] + steps * (scatter[:, None] * ray)[None]
    x, y, z = (along[..., i] for i in range(3))
    slot = layout.slot(cells(layout, (x, y, z)))
    row = jnp.where(slot < layout.slots, chart.table[jnp.minimum(slot, layout.slots - 1)], FREE)
    read = jnp.where(row >= 0, chart.total[jnp.maximum(row, 0), 3], 0)
    score = jnp.maximum(read, 0.5) * jnp.exp(-(steps[..., 0] ** 2) / 2)
    best = jnp.argmax(score, axis=0)
    return jnp.take_along_axis(along, best[None, :, None], axis=0)[0]


def _rows(layout: Layout, chart: VoxelMap, point: Array, valid: Array) -> tuple[Array, VoxelMap]:
    """Find or make the row of each point; M where there is none. The first point to claim a slot makes its row."""
    capacity, count = chart.point.shape[0], point.shape[0]
    slot = layout.slot(cells(layout, (point[:, 0], point[:, 1], point[:, 2])))
    placed = valid & (slot < layout.slots)
    at = jnp.minimum(slot, layout.slots - 1)
    row = chart.table[at]
    fresh = placed & (row == FREE)
    mine = jnp.arange(count, dtype=jnp.int32)
    claim = chart.table.at[jnp.where(fresh, slot, layout.slots)].set(-2 - mine, mode="drop")
    claimed = claim[at]
    first = fresh & (claimed == -2 - mine)
    made = chart.used + jnp.cumsum(first.astype(jnp.int32)) - 1
    made = jnp.where(made < capacity, made, FREE)
    table = claim.at[jnp.where(first, slot, layout.slots)].set(made, mode="drop")
    row = table[at]
    there = placed & (row >= 0)
    # A slot of another place: its point, or the one that has just claimed it, is far off.
    old = jnp.minimum(row, capacity - 1)
    seen = chart.total[old, 3] > 0
    holder = jnp.where(fresh[:, None], point[jnp.where(fresh, -2 - claimed, 0)], chart.point[old])
    away = jnp.max(jnp.abs(holder - point), axis=1) > 2.5 * layout.voxel
    there = there & ~((seen | fresh) & away)
    rows = jnp.where(there, row, capacity)
    owned = chart.slot.at[jnp.where(first & there, row, capacity)].set(slot, mode="drop")
    used = jnp.minimum(chart.used + jnp.sum(first, dtype=jnp.int32), capacity)
    lost = jnp.sum(valid & ~there, dtype=jnp.int32)
    return rows, chart._replace(table=table, slot=owned, used=used, overflow=chart.overflow + lost)


def _central(layout: Layout, chart: VoxelMap, point: Array, rows: Array, new: Array) -> Array:
    capacity = chart.point.shape[0]

    def off(x: Array) -> Array:
        return jnp.sum((x - (jnp.floor(x / layout.voxel) + 0.5) * layout.voxel) ** 2, axis=-1)

    now = jnp.where(chart.total[:, 3] > 0, off(chart.point), jnp.inf)
    mine = off(point)
    best = now.at[rows].min(mine, mode="drop")
    wins = mine <= best[jnp.minimum(rows, capacity - 1)]
    wins = wins & (mine < now[jnp.minimum(rows, capacity - 1)])
    return chart.total.at[jnp.where(wins, rows, capacity)].set(new, mode="drop")


def occupied(chart: VoxelMap) -> Array:
    """Return which rows hold a point, (M,) bool."""
    return jnp.arange(chart.point.shape[0]) < chart.used


def carried(chart: VoxelMap, rows: Array | None = None) -> Array:
    """Return the mean of what the points of rows (...,) carry, (..., d), of all rows if None; 0 where none is."""
    total = chart.total if rows is None else chart.total[rows]
    return _mean(total, CARRIED, total.shape[-1])


def moments(chart: VoxelMap, rows: Array) -> Array:
    """Return how the points of rows (...,) scatter about their mean: xx, xy, xz, yy, yz and zz (..., 6) m2."""
    # One column at a time: a gather of whole rows would bring what they carry, again.
    count = chart.total[:, COUNT][rows]
    count = jnp.where(count > 0, count, 1)
    return jnp.stack([chart.total[:, i][rows] / count for i in range(MOMENT, CARRIED)], axis=-1)


def recarried(chart: VoxelMap, mean: Array) -> VoxelMap:
    """Let the points of all rows carry other numbers first, on average (M, c)."""
    end = CARRIED + mean.shape[1]
    total = chart.total.at[:, CARRIED:end].set(mean * chart.total[:, COUNT, None])
    return chart._replace(total=total)


def _mean(total: Array, begin: int, end: int) -> Array:
    count = total[..., COUNT, None]
    return total[..., begin:end] / jnp.where(count > 0, count, 1)


def shift(chart: VoxelMap, moved: ArrayLike) -> VoxelMap:
    """Move every point by (M, 3) m, where the map's frame bends; each stays in its slot."""
    moved = jnp.asarray(moved, chart.point.dtype)
    moved = jnp.where(occupied(chart)[:, None], moved, 0)
    total = chart.total.at[:, :3].add(moved * chart.total[:, 3:4])
    return chart._replace(point=chart.point + moved, total=total)


def merge(layout: Layout, one: VoxelMap, other: VoxelMap) -> VoxelMap:
    """Bring another map of the same frame and layout into a map; each voxel's points count as many as they were.

    Args:
        layout: of both.
        one: the map that receives.
        other: the map that gives, any capacity, carrying as much.

    Returns:
        The merged map.
    """
    rows, after = _rows(layout, one, other.point, occupied(other))
    about = _about(layout, one, after, rows, other.point)
    apart = squares(other.point - about) * other.total[:, COUNT, None]
    return _added(after, rows, other.total.at[:, MOMENT:CARRIED].add(apart), about)


__all__ = [
    "FREE",
    "VoxelMap",
    "carried",
    "empty",
    "insert",
    "likeliest",
    "merge",
    "moments",
    "occupied",
    "recarried",
    "shift",
    "squares",
]
