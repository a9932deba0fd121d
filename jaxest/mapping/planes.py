"""Planes through a few points each, in closed form."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxest.types import Array

FLAT = 1e-9  # m, as thin as a plane can be


class Planes(NamedTuple):
    """Planes through neighbours."""

    center: Array
    """(n, 3) m, the centroid."""
    normal: Array
    """(n, 3) unit, either way; any unit vector where not valid."""
    thickness: Array
    """(n,) m, root mean square distance of the neighbours, and what they are the mean of, from the plane."""
    spread: Array
    """(n,) m, root mean square extent of the neighbours along the plane's shorter way: small where they lie on a
    line."""
    valid: Array
    """(n,) bool, enough neighbours that do not lie on a line."""
    share: Array
    """(k, n) of each neighbour in the centroid; sums to 1 where there is any."""
    moment: tuple[Array, ...]
    """xx, xy, xz, yy, yz and zz (n,) m2 of the neighbours about the centroid, without what is within them."""


def fit(
    points: tuple[Array, Array, Array],
    there: Array,
    weight: Array | None = None,
    within: Array | None = None,
    *,
    least: int = 3,
    line: float = 0.03,
) -> Planes:
    """Lay a plane through the k neighbours of each of n points, about their centroid.

    Args:
        points: x, y and z (k, n) m; finite everywhere.
        there: (k, n) bool, which neighbours exist.
        weight: (k, n) by how much each counts, positive; all alike if None.
        within: (6, k, n) m2, xx, xy, xz, yy, yz and zz of what each neighbour is the mean of, about it: the plane is
            that of all. None if each is one point.
        least: neighbours that a plane needs.
        line: m, a smaller `spread` makes a line of it.

    Returns:
        The planes.

    Source: Iwao 2025, eq. 7; about the centroid, so that planes through the origin are like others. Eigenvalues of the
    3 x 3 covariance by the trigonometric formula, the normal as the largest cross product of two rows of A - lambda I.
    """
    x, y, z = points
    count = jnp.sum(there, axis=0)
    share = jnp.where(there, 1 if weight is None else weight, 0).astype(x.dtype)
    share = share / jnp.where(count > 0, jnp.sum(share, axis=0), 1)[None]

    def mean(v: Array) -> Array:
        return jnp.sum(share * jnp.where(there, v, 0), axis=0)

    center = (mean(x), mean(y), mean(z))
    dx, dy, dz = (v - c[None] for v, c in zip(points, center, strict=True))
    pairs = (dx * dx, dx * dy, dx * dz, dy * dy, dy * dz, dz * dz)
    between = tuple(mean(p) for p in pairs)
    a = between if within is None else tuple(b + mean(within[i]) for i, b in enumerate(between))
    low, _ = eigenvalues(a)
    normal = eigenvector(a, low)
    trace, determinant = _across(between, normal)
    narrow = (trace - jnp.sqrt(jnp.maximum(trace**2 - 4 * determinant, FLAT**4))) / 2
    # The root of an exact 0 has no derivative. A floor, for `where` would ask twice for the sign of what is left of
    # rounding, and XLA, which may compute it twice, may answer twice.
    thickness, spread = (jnp.sqrt(jnp.maximum(v, FLAT**2)) for v in (low, narrow))
    valid = (count >= least) & (spread > line)
    return Planes(jnp.stack(center, -1), normal, thickness, spread, valid, share, between)


def _times(moment: tuple[Array, ...], v: Array) -> Array:
    """Return A v (n, 3) of symmetric A."""
    xx, xy, xz, yy, yz, zz = moment
    a, b, c = (v[:, i] for i in range(3))
    return jnp.stack([xx * a + xy * b + xz * c, xy * a + yy * b + yz * c, xz * a + yz * b + zz * c], axis=1)


def _across(moment: tuple[Array, ...], normal: Array) -> tuple[Array, Array]:
    """Return trace and determinant (n,) of symmetric A within the plane across a normal (n, 3)."""
    xx, xy, xz, yy, yz, zz = moment
    out = _times(moment, normal)
    along = jnp.sum(normal * out, axis=1)
    trace = xx + yy + zz - along
    squares = xx**2 + yy**2 + zz**2 + 2 * (xy**2 + xz**2 + yz**2) - 2 * jnp.sum(out**2, axis=1) + along**2
    return trace, (trace**2 - squares) / 2


def influence(planes: Planes, points: tuple[Array, Array, Array], x: Array) -> Array:
    """Return by how much a plane at x goes along when one of its neighbours leaves it sideways.

    Where all neighbours turn about an axis, so does the plane: the sum over neighbours of influence and motion is the
    motion of the plane beside x, where that of their centroid would leave out the turn. What neighbours are the mean of
    is taken to turn as they do.

    Args:
        planes: n planes.
        points: x, y and z (k, n) m of their neighbours, as `fit` had them.
        x: (n, 3) m, where each plane is asked for.

    Returns:
        (k, n), sums to 1; plain shares where a plane is not valid.
    """
    n, away = planes.normal, x - planes.center
    away = away - jnp.sum(n * away, axis=1, keepdims=True) * n
    # Within the plane the moment A is 2 x 2: its inverse is (trace - A) / determinant, by Cayley and Hamilton.
    trace, determinant = _across(planes.moment, n)
    turned = trace[:, None] * away - _times(planes.moment, away)
    slope = jnp.where(planes.valid[:, None], turned / jnp.where(planes.valid, determinant, 1)[:, None], 0)
    lever = sum(slope[None, :, i] * (points[i] - planes.center[None, :, i]) for i in range(3))
    return planes.share * (1 + lever)


def eigenvalues(a: tuple[Array, ...]) -> tuple[Array, Array]:
    """Return the smallest and the middle eigenvalue of symmetric 3 x 3 (xx, xy, xz, yy, yz, zz)."""
    xx, xy, xz, yy, yz, zz = a
    q = (xx + yy + zz) / 3
    off = xy * xy + xz * xz + yz * yz
    p2 = ((xx - q) ** 2 + (yy - q) ** 2 + (zz - q) ** 2 + 2 * off) / 6
    some = p2 > 0
    p = jnp.sqrt(jnp.where(some, p2, 1))
    bx, by, bz = (xx - q) / p, (yy - q) / p, (zz - q) / p
    xy, xz, yz = xy / p, xz / p, yz / p
    det = bx * (by * bz - yz * yz) - xy * (xy * bz - yz * xz) + xz * (xy * yz - by * xz)
    # Just inside 1 the arc cosine still has a finite derivative.
    edge = 1 - 4 * float(jnp.finfo(q.dtype).eps)
    angle = jnp.arccos(jnp.clip(det / 2, -edge, edge)) / 3
    p = jnp.where(some, p, 0)
    high = q + 2 * p * jnp.cos(angle)
    low = q + 2 * p * jnp.cos(angle + 2 * jnp.pi / 3)
    return low, 3 * q - high - low


def eigenvector(a: tuple[Array, ...], value: Array) -> Array:
    """Return the unit eigenvectors (n, 3) of a simple eigenvalue; z where there is none."""
    xx, xy, xz, yy, yz, zz = a
    rows = ((xx - value, xy, xz), (xy, yy - value, yz), (xz, yz, zz - value))
    best: tuple[Array, ...] = (value, value, value)
    length = jnp.full_like(value, -1)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        (a1, a2, a3), (b1, b2, b3) = rows[i], rows[j]
        found = (a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1)
        size = found[0] ** 2 + found[1] ** 2 + found[2] ** 2
        more = size > length
        best = tuple(jnp.where(more, f, b) for f, b in zip(found, best, strict=True))
        length = jnp.where(more, size, length)
    some = length > 0
    root = jnp.sqrt(jnp.where(some, length, 1))
    parts = [jnp.where(some, c / root, 1.0 if k == 2 else 0.0) for k, c in enumerate(best)]
    return jnp.stack(parts, -1)


__all__ = ["Planes", "eigenvalues", "eigenvector", "fit", "influence"]
