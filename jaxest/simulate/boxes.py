"""Rays among boxes in JAX: what a ranging sensor meets in a room of the kind that `simulate.rooms` draws."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxest.types import Array


class Boxes(NamedTuple):
    """A box-shaped room and boxes in it, all aligned with the world."""

    lower: Any
    """(3,) m, a corner of the free space."""
    upper: Any
    """(3,) m, the opposite one."""
    centers: Any
    """(B, 3) m, of boxes in it."""
    halves: Any
    """(B, 3) m, half their sizes."""


def distance(boxes: Boxes, origin: Array, direction: Array) -> Array:
    """Return how far rays go.

    Args:
        boxes: the room.
        origin: (n, 3) m, inside the room.
        direction: (n, 3) unit vectors.

    Returns:
        (n,) m to the first surface.
    """
    dtype = origin.dtype
    tiny = jnp.asarray(1e-9, dtype)
    safe = jnp.where(jnp.abs(direction) < tiny, tiny, direction)
    low, high = jnp.asarray(boxes.lower, dtype)[None], jnp.asarray(boxes.upper, dtype)[None]
    wall = jnp.min(jnp.maximum((low - origin) / safe, (high - origin) / safe), axis=1)
    center, half = jnp.asarray(boxes.centers, dtype)[None], jnp.asarray(boxes.halves, dtype)[None]
    if center.shape[1] == 0:
        return wall
    one = (center - half - origin[:, None]) / safe[:, None]
    other = (center + half - origin[:, None]) / safe[:, None]
    enters = jnp.max(jnp.minimum(one, other), axis=2)
    leaves = jnp.min(jnp.maximum(one, other), axis=2)
    met = jnp.where((enters > 0) & (enters <= leaves), enters, jnp.inf)
    return jnp.minimum(wall, jnp.min(met, axis=1))


def surface(boxes: Boxes, point: Array) -> Array:
    """Return how far points (n, 3) m are from the nearest surface, (n,) m."""
    dtype = point.dtype
    low, high = jnp.asarray(boxes.lower, dtype)[None], jnp.asarray(boxes.upper, dtype)[None]
    wall = _to_box((low + high) / 2, (high - low) / 2, point)
    center, half = jnp.asarray(boxes.centers, dtype), jnp.asarray(boxes.halves, dtype)
    for c, h in zip(center, half, strict=True):
        wall = jnp.minimum(wall, _to_box(c[None], h[None], point))
    return wall


def _to_box(center: Array, half: Array, point: Array) -> Array:
    """Distance to a box's surface, from inside or outside."""
    out = jnp.abs(point - center) - half
    outside = jnp.sqrt(jnp.sum(jnp.maximum(out, 0) ** 2, axis=1))
    return jnp.where(jnp.max(out, axis=1) > 0, outside, -jnp.max(out, axis=1))


__all__ = ["Boxes", "distance", "surface"]
