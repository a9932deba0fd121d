"""Unit quaternions, wxyz, Hamilton: the element is (4,), the tangent a rotation vector (3,), rad.

`q` and `-q` are the same rotation everywhere. `R(q) p` maps coordinates of the source frame to the destination's.
"""

import jax
import jax.numpy as jnp

from jaxest.manifolds import _coefficients as coefficient
from jaxest.manifolds._algebra import (
    cross,
    dot,
    left_jacobian,
    left_jacobian_inverse,
    matmul,
    right_jacobian,
    right_jacobian_inverse,
    skew,
    solve3,
)
from jaxest.manifolds.base import as_array, normalized
from jaxest.types import Array, ArrayLike

dim = 3


def identity(dtype: jnp.dtype | None = None) -> Array:
    """Return the quaternion (4,) of no rotation."""
    return jnp.zeros(4, dtype).at[0].set(1)


def exp(v: ArrayLike) -> Array:
    """Return the rotation by |v| about v.

    Args:
        v: (3,) rotation vector, rad, of any length.

    Returns:
        (4,) unit quaternion; w < 0 beyond half a turn.

    Raises:
        ValueError: the shape is wrong.

    Source: Sola, Deray, Atchuthan 2018 (A micro Lie theory), eq. 134.
    """
    v = as_array("v", v, 3)
    s = dot(v, v)
    return jnp.concatenate([coefficient.cos_half(s)[None], coefficient.sin_half(s) * v])


def log(q: ArrayLike) -> Array:
    """Return the rotation vector of a quaternion, the shorter one of the two.

    Args:
        q: (4,) quaternion; its length and its sign do not matter; zero counts as no rotation.

    Returns:
        (3,) rotation vector, rad, at most pi long. Derivatives are right at 0 and at pi (one-sided there: the vector
        jumps to its opposite).

    Raises:
        ValueError: the shape is wrong.

    Source: v = 2 arctan(|xyz| / |w|) xyz / |xyz| (Sola, Deray, Atchuthan 2018, eq. 133). The arctangent's argument
    is halved three times, which leaves a short polynomial and no branch, smooth in |xyz|^2.
    """
    q = as_array("q", q, 4)
    flipped = jnp.where(q[0] < 0, -q, q)
    w, xyz = flipped[0], flipped[1:]
    n2 = dot(xyz, xyz)
    length2 = w * w + n2
    length = jnp.sqrt(jnp.where(length2 > 0, length2, 1.0))
    half = w + length  # |xyz| / half is tan(t/4) when |xyz| / w is tan(t/2)
    quarter = half + jnp.sqrt(2 * length * half)
    eighth = quarter + jnp.sqrt(quarter * quarter + n2)
    return 16 * coefficient.arctan_ratio(n2 / (eighth * eighth)) / eighth * xyz


def compose(x: ArrayLike, y: ArrayLike) -> Array:
    """Return the Hamilton product, the rotation `y` followed by `x`.

    Args:
        x: (4,) unit quaternion.
        y: (4,) unit quaternion.

    Returns:
        (4,) quaternion, as long as the factors make it (`retract` and `normalize` restore length 1).

    Raises:
        ValueError: a shape is wrong.
    """
    a, b, c, d = as_array("x", x, 4)
    w, i, j, k = as_array("y", y, 4)
    return jnp.stack(
        [
            a * w - b * i - c * j - d * k,
            a * i + b * w + c * k - d * j,
            a * j - b * k + c * w + d * i,
            a * k + b * j - c * i + d * w,
        ]
    )


def inverse(q: ArrayLike) -> Array:
    """Return the conjugate (4,) of a unit quaternion (4,); raises ValueError for another shape."""
    q = as_array("q", q, 4)
    return jnp.concatenate([q[:1], -q[1:]])


def normalize(q: ArrayLike) -> Array:
    """Return the quaternion (4,) scaled to length 1, zero becoming no rotation; raises ValueError for another shape."""
    q = as_array("q", q, 4)
    length2 = dot(q, q)
    some = length2 > 0
    return jnp.where(some, q, identity(q.dtype)) / jnp.sqrt(jnp.where(some, length2, 1.0))


def rotate(q: ArrayLike, p: ArrayLike) -> Array:
    """Rotate a vector.

    Args:
        q: (4,) unit quaternion.
        p: (3,) vector in the source frame.

    Returns:
        (3,) vector in the destination frame.

    Raises:
        ValueError: a shape is wrong.
    """
    q, p = as_array("q", q, 4), as_array("p", p, 3)
    twice = 2 * cross(q[1:], p)
    return p + q[0] * twice + cross(q[1:], twice)


def to_matrix(q: ArrayLike) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,); raises ValueError for another shape."""
    q = as_array("q", q, 4)
    (w, x, y, z), t = q, 2 * q
    tx, ty, tz = t[1:]
    rows = [
        1 - ty * y - tz * z, tx * y - tz * w, tx * z + ty * w,
        tx * y + tz * w, 1 - tx * x - tz * z, ty * z - tx * w,
        tx * z - ty * w, ty * z + tx * w, 1 - tx * x - ty * y,
    ]  # fmt: skip
    return jnp.stack(rows).reshape(3, 3)


def _longest_row(outer: Array) -> Array:
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
    return _longest_row(jnp.stack(rows).reshape(4, 4))


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


def adjoint(x: ArrayLike) -> Array:
    """Return the adjoint (3, 3), the rotation matrix of `x` (4,); raises ValueError for another shape."""
    return to_matrix(x)


def retract(x: ArrayLike, v: ArrayLike) -> Array:
    """Return `x exp(v)`, scaled to length 1 so that a filter's state stays a rotation.

    Args:
        x: (4,) unit quaternion.
        v: (3,) rotation vector in the source frame of `x`, rad.

    Returns:
        (4,) unit quaternion.

    Raises:
        ValueError: a shape is wrong.
    """
    return normalize(compose(x, exp(v)))


def local(x: ArrayLike, y: ArrayLike) -> Array:
    """Return the rotation vector (3,), rad, that takes `x` (4,) to `y` (4,) from the right, at most pi long."""
    return log(compose(inverse(x), y))


def interpolate(x: ArrayLike, y: ArrayLike, t: ArrayLike) -> Array:
    """Return the rotation at a fraction of the short way from one to another (slerp).

    Args:
        x: (4,) unit quaternion.
        y: (4,) unit quaternion.
        t: () fraction; 0 gives `x`, 1 gives `y` (or `-y`).

    Returns:
        (4,) unit quaternion.

    Raises:
        ValueError: a shape is wrong.
    """
    return retract(x, t * local(x, y))


def mean(xs: ArrayLike, weights: ArrayLike | None = None, *, iterations: int = 4) -> Array:
    """Return the weighted Frechet (Karcher) mean: the rotation from which the weighted `local` sum to zero.

    Args:
        xs: (N, 4) unit quaternions, of either sign.
        weights: (N,), any scale; all equal if None.
        iterations: Newton steps, static; 4 reach float64 precision for samples within a quarter turn of their mean.

    Returns:
        (4,) unit quaternion; first and second derivatives are those of the exact mean.

    Raises:
        ValueError: a shape is wrong.

    Source: the start is the chordal mean (Markley et al. 2007, Averaging quaternions), by squaring the moment matrix;
    the derivative of log(exp(-d) exp(v)) is -left_jacobian_inverse(v), summed over the samples.
    """
    xs = as_array("xs", xs, None, 4)
    weights = normalized(weights, xs)
    moment = jnp.sum(weights[:, None, None] * xs[:, :, None] * xs[:, None, :], axis=0)
    for _ in range(4):
        moment = matmul(moment, moment)
        trace = jnp.trace(moment)
        moment = moment / jnp.where(trace == 0, 1.0, trace)

    def newton(_: int, m: Array) -> Array:
        vs = jax.vmap(local, (None, 0))(m, xs)
        bends = weights * jax.vmap(lambda v: coefficient.inverse_jacobian(dot(v, v)))(vs)
        residual = jnp.sum(weights[:, None] * vs, axis=0)
        square = jnp.sum(bends[:, None, None] * vs[:, :, None] * vs[:, None, :], axis=0)
        eye = jnp.eye(3, dtype=xs.dtype)
        return retract(m, solve3(eye - skew(residual) / 2 + square - jnp.trace(square) * eye, residual))

    # A Newton step forgets the derivative of where it started, so none has to flow through the start.
    return jax.lax.fori_loop(0, iterations, newton, jax.lax.stop_gradient(_longest_row(moment)))


__all__ = [
    "adjoint",
    "compose",
    "dim",
    "exp",
    "from_axis_angle",
    "from_matrix",
    "from_two_vectors",
    "identity",
    "interpolate",
    "inverse",
    "left_jacobian",
    "left_jacobian_inverse",
    "local",
    "log",
    "mean",
    "normalize",
    "retract",
    "right_jacobian",
    "right_jacobian_inverse",
    "rotate",
    "to_matrix",
]
