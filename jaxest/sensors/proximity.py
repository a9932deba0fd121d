"""Ranging sensors with several zones, as they sit on a robot's links: where they look from, and where to.

Unlike the other sensors here, a range is compared with a map and not with a pose alone; `jaxest.systems.slam` does it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.types import InputError

MINIMUM, MAXIMUM = 0.05, 4.0  # m
FIELD_DEG = 45.0


class Proximity(NamedTuple):
    """One sensor: host-side, static in an estimator."""

    frame: str
    """The body or `site:NAME` it is fixed to."""
    position: NDArray[np.float64]
    """(3,) m, where its rays start, in that frame."""
    directions: NDArray[np.float64]
    """(Z, 3) unit vectors of the zones, in that frame."""
    minimum: float = MINIMUM
    """m; shorter readings do not count."""
    maximum: float = MAXIMUM
    """m; longer readings do not count."""


def zones(rows: int = 8, columns: int = 8, field_deg: float = FIELD_DEG) -> NDArray[np.float64]:
    """Return the zones' directions of a sensor that looks along x, its columns along y and its rows along z.

    Args:
        rows: zones upwards.
        columns: zones sideways.
        field_deg: angle of the whole field of view, either way.

    Returns:
        (rows * columns, 3) unit vectors through the middle of each zone, row after row.

    Raises:
        InputError: no zone, or a field of view that is not between 0 and 180 degrees.
    """
    if min(rows, columns) < 1 or not 0 < field_deg < 180:
        raise InputError(f"zones: {rows} x {columns} over {field_deg:g} deg, expected at least 1 x 1 over 0 to 180")
    up, side = (np.deg2rad(field_deg) * ((np.arange(n) + 0.5) / n - 0.5) for n in (rows, columns))
    z, y = np.meshgrid(np.tan(up), np.tan(side), indexing="ij")
    found = np.stack([np.ones(z.size), y.ravel(), z.ravel()], axis=1)
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def ring(
    frame: str,
    along: float,
    *,
    radius: float = 0.05,
    count: int = 8,
    rows: int = 8,
    columns: int = 8,
    field_deg: float = FIELD_DEG,
    minimum: float = MINIMUM,
    maximum: float = MAXIMUM,
) -> tuple[Proximity, ...]:
    """Put sensors in a ring about a link's x axis, looking outwards.

    Args:
        frame: the link.
        along: m, where on its x axis.
        radius: m.
        count: sensors in the ring.
        rows: zones of each along the link.
        columns: zones of each around it.
        field_deg: angle of a sensor's whole field of view.
        minimum: m.
        maximum: m.

    Returns:
        The sensors, 8 of 8 x 8 zones by default, as VL53L5CX are. Source: Iwao 2025, section III.
    """
    looking = zones(columns, rows, field_deg)[:, [2, 1, 0]]  # along z of the ring's own frame, its rows along x
    looking = np.stack([looking[:, 1], looking[:, 2], looking[:, 0]], axis=1)
    found = []
    for angle in 2 * np.pi * np.arange(count) / count:
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])  # about x; the first looks along y
        placed = np.array([along, radius * c, radius * s])
        found.append(Proximity(frame, placed, looking @ turn.T, minimum, maximum))
    return tuple(found)


def tilted(sensors: Sequence[Proximity], angles: ArrayLike, axes: ArrayLike) -> tuple[Proximity, ...]:
    """Turn each sensor about where it sits, as a careless assembly does.

    Args:
        sensors: S sensors.
        angles: (S,) rad.
        axes: (S, 3) unit vectors in the sensors' frames.

    Returns:
        The same sensors, looking elsewhere.
    """
    found = []
    for one, angle, axis in zip(sensors, np.asarray(angles), np.asarray(axes), strict=True):
        k, d = axis, one.directions
        along = np.outer(d @ k, k)
        turned = d * np.cos(angle) + np.cross(k, d) * np.sin(angle) + along * (1 - np.cos(angle))
        found.append(one._replace(directions=turned))
    return tuple(found)


def rays(sensors: Sequence[Proximity]) -> int:
    """Return the number of zones of all sensors together, the length of a reading."""
    return sum(len(one.directions) for one in sensors)


__all__ = ["FIELD_DEG", "MAXIMUM", "MINIMUM", "Proximity", "rays", "ring", "tilted", "zones"]
