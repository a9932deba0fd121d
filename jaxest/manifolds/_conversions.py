"""The unit quaternion's other forms: matrices, axes and angles, pairs of vectors."""

import jax.numpy as jnp

from jaxest.manifolds._algebra import cross, dot
from jaxest.manifolds.base import as_array
from jaxest.types import Array, ArrayLike


def normalize(q: ArrayLike) -> Array:
    """Return the quaternion (4,) scaled to length 1, zero becoming no rotation and NaN staying NaN.

    Raises ValueError for another shape.
    """
    q = as_array("q", q, 4)
    length2 = dot(q, q)
    zero = length2 == 0
    return jnp.where(zero, jnp.eye(4, dtype=q.dtype)[0], q) / jnp.sqrt(jnp.where(zero, 1.0, length2))


def to_matrix(q: ArrayLike) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,); raises ValueError for another shape."""
    q = as_array("q", q, 4)
    (w, x, y, z), t = q, 2 * q
    tx, ty, tz = t[1:]
    # Three rows of three: XLA on CPU makes one kernel of it, and ten of nine numbers in a row.
    rows = [
        [1 - ty * y - tz * z, tx * y - tz * w, tx * z + ty * w],
        [tx * y + tz * w, 1 - tx * x - tz * z, ty * z - tx * w],
        [tx * z - ty * w, ty * z + tx * w, 1 - tx * x - ty * y],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def longest_row(outer: Array) -> Array:
    """Return the unit vector q, w >= 0, of a matrix (4, 4) near a multiple of q q^T, from its longest row."""
    w, x, y, z = jnp.diagonal(outer)
    upper = jnp.where(w >= x, outer[0], outer[1])
    lower = jnp.where(y >= z, outer[2], outer[3])
    row = normalize(jnp.where(jnp.maximum(w, x) >= jnp.maximum(y, z), upper, lower))
    return jnp.where(row[0] < 0, -row, row)


def from_matrix(matrix: ArrayLike) -> Array:
    """Return the quaternion of a rotation matrix, equally right at every angle.

    Args:
        matrix: (3, 3) rotation matrix.

    Returns:
        (4,) unit quaternion with w >= 0.

    Raises:
        ValueError: the shape is wrong.

    Source: Shepperd 1978 (Quaternion from rotation matrix): of the four rows of 4 q q^T take the longest.
    """
    (a, b, c), (d, e, f), (g, h, i) = as_array("matrix", matrix, 3, 3)
    rows = [
        1 + a + e + i, h - f, c - g, d - b,
        h - f, 1 + a - e - i, b + d, c + g,
        c - g, b + d, 1 - a + e - i, f + h,
        d - b, c + g, f + h, 1 - a - e + i,
    ]  # fmt: skip
    return longest_row(jnp.stack(rows).reshape(4, 4))


def from_axis_angle(axis: ArrayLike, angle: ArrayLike) -> Array:
    """Return the rotation about an axis.

    Args:
        axis: (3,) unit vector.
        angle: () rad.

    Returns:
        (4,) unit quaternion.

    Raises:
        ValueError: a shape is wrong.
    """
    axis, half = as_array("axis", axis, 3), as_array("angle", angle) / 2
    return jnp.concatenate([jnp.cos(half)[None], jnp.sin(half) * axis])


def from_two_vectors(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the shortest rotation that turns `a` into `b`.

    Args:
        a: (3,) unit vector.
        b: (3,) unit vector.

    Returns:
        (4,) unit quaternion; for opposite vectors half a turn about some axis across them.

    Raises:
        ValueError: a shape is wrong.
    """
    a, b = as_array("a", a, 3), as_array("b", b, 3)
    # |a + b|^2 / 2 is 1 + a.b without its cancellation.
    q = jnp.concatenate([dot(a + b, a + b)[None] / 2, cross(a, b)])
    opposite = dot(q, q) < 16 * float(jnp.finfo(q.dtype).eps) ** 2
    thin = jnp.abs(a[0]) < 0.6
    along = jnp.stack([jnp.where(thin, 1.0, 0.0), jnp.where(thin, 0.0, 1.0), jnp.zeros(())]).astype(a.dtype)
    return normalize(jnp.where(opposite, jnp.concatenate([jnp.zeros_like(q[:1]), cross(a, along)]), q))


__all__ = ["from_axis_angle", "from_matrix", "from_two_vectors", "longest_row", "normalize", "to_matrix"]
