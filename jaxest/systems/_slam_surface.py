"""What a map has beside a link's points: planes, how they move with the unknowns, how often they were read."""

from functools import reduce
from operator import add
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxest.mapping import Layout, Planes, VoxelMap, carried, fit, influence, moments, nearest, squares
from jaxest.systems._slam_tilt import Turned, parted
from jaxest.types import Array


class Surface(NamedTuple):
    """The planes beside n points."""

    planes: Planes
    beside: tuple[Array, Array, Array]
    """x, y and z (k, n) m of the neighbours that make them."""
    across: Array
    """(k, n, u) m per unit, how the neighbours leave their plane along its normal with the u unknowns."""
    read: Array
    """(n,) readings of a plane's neighbours, on average."""
    own: Any
    """(n,) share in them of the link's own points; 0 where the sensors' turns are not estimated."""
    hazy: Any
    """(n,) m2, by how much they are off for what was unknown of the sensors' turns; 0 where those are not estimated."""


def surface(
    layout: Layout,
    chart: VoxelMap,
    x: Array,
    noise: Array,
    scatter: Array,
    uneven: Array,
    count: int,
    turned: Turned | None,
) -> Surface:
    """Find the planes beside points.

    Args:
        layout: the map's.
        chart: the map; its points carry how they move with the unknowns, (3 * count,), and what `parted` parts.
        x: (n, 3) m, points.
        noise: (n, 3) m, deviations of their ranges along their rays.
        scatter: (n,) m, the same in length.
        uneven: () m, by which a surface is none.
        count: number u of unknowns.
        turned: where the sensors' turns are estimated.

    Returns:
        The planes; those that are none are not valid.
    """
    near = nearest(layout, chart, x, 2**0.5 * scatter)  # of the point, and of one that was read once
    px, py, pz = (chart.point[:, i][near.row] for i in range(3))
    read = jnp.where(near.there, chart.total[:, 3][near.row], 1)
    # Of one reading nothing is known of how its voxel's surface lies: what its noise was taken for is given back.
    within = jnp.moveaxis(moments(chart, near.row), -1, 0) + squares(noise).T[:, None] / read[None]
    planes = fit((px, py, pz), near.there, 1 / (uneven**2 + scatter[None] ** 2 / read), within)
    kept = jnp.where(near.there[..., None], carried(chart, near.row), 0)
    moved = kept[..., : 3 * count].reshape(*kept.shape[:2], 3, count)
    across = reduce(add, (planes.normal[None, :, i, None] * moved[:, :, i] for i in range(3)))
    own: Any = 0.0
    hazy: Any = 0.0
    if turned is not None:
        own, hazy = parted(jnp.sum(planes.share[..., None] * kept[..., 3 * count :], axis=0), turned)
    return Surface(planes, (px, py, pz), across, jnp.sum(planes.share * read, axis=0), own, hazy)


def goes(surface: Surface, x: Array) -> Array:
    """Return how the planes beside points x (n, 3) m move along their normals with the unknowns, (n, u)."""
    return jnp.sum(influence(surface.planes, surface.beside, x)[..., None] * surface.across, axis=0)


__all__ = ["Surface", "goes", "surface"]
