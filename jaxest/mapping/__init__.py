"""Maps of points that a filter can carry: fixed capacity, pure functions, one scatter an insertion.

`empty(layout, capacity)` makes a map, `insert` brings points in (a running mean in each voxel, or the point nearest to
the voxel's centre), `nearest` finds the neighbours of points over the 125 cells around them and `fit` lays planes
through neighbours. `Grid` lays a known volume out densely; `Hashed` folds unknown space onto a table.

Each point may carry numbers of its own, averaged with it: a SLAM carries how the point would move with the robot.

Not here: files (`jaxest.io.clouds`), poses and filters (`jaxest.systems.slam`).
"""

from jaxest.mapping.layout import Grid, Hashed, Layout
from jaxest.mapping.neighbours import Neighbours, nearest
from jaxest.mapping.planes import Planes, fit, influence
from jaxest.mapping.voxels import (
    VoxelMap,
    carried,
    empty,
    insert,
    likeliest,
    merge,
    moments,
    occupied,
    recarried,
    shift,
    squares,
)

__all__ = [
    "Grid",
    "Hashed",
    "Layout",
    "Neighbours",
    "Planes",
    "VoxelMap",
    "carried",
    "empty",
    "fit",
    "influence",
    "insert",
    "likeliest",
    "merge",
    "moments",
    "nearest",
    "occupied",
    "recarried",
    "shift",
    "squares",
]
