"""Unit quaternions, wxyz, Hamilton: the element is (4,), the tangent a rotation vector (3,), rad.

`q` and `-q` are the same rotation everywhere. `R(q) p` maps coordinates of the source frame to the destination's.
"""

import functools

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
from jaxest.manifolds._conversions import (
    from_axis_angle,
    from_matrix,
    from_two_vectors,
    longest_row,
    normalize,
    to_matrix,
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
        (4,) unit quaternion; its derivatives are those of the exact mean.

    Raises:
        ValueError: a shape is wrong.

    Source: the start is the chordal mean (Markley et al. 2007, Averaging quaternions), by squaring the moment matrix;
    the derivative of log(exp(-d) exp(v)) is -left_jacobian_inverse(v), summed over the samples.
    """
    xs = as_array("xs", xs, None, 4)
    return _mean(iterations, xs, normalized(weights, xs))


def _residual(m: Array, xs: Array, weights: Array) -> tuple[Array, Array]:
    """Return the weighted sum (3,) of the differences from `m`, and the differences (N, 3)."""
    vs = jax.vmap(local, (None, 0))(m, xs)
    return jnp.sum(weights[:, None] * vs, axis=0), vs


def _newton(residual: Array, vs: Array, weights: Array) -> Array:
    """Return how far (3,) to move `m` so that a `residual` vanishes: its slope is a sum of inverse Jacobians."""
    bends = weights * jax.vmap(lambda v: coefficient.inverse_jacobian(dot(v, v)))(vs)
    square = jnp.sum(bends[:, None, None] * vs[:, :, None] * vs[:, None, :], axis=0)
    centre = jnp.sum(weights[:, None] * vs, axis=0)
    eye = jnp.eye(3, dtype=vs.dtype)
    return solve3(eye - skew(centre) / 2 + square - jnp.trace(square) * eye, residual)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _mean(iterations: int, xs: Array, weights: Array) -> Array:
    moment = jnp.sum(weights[:, None, None] * xs[:, :, None] * xs[:, None, :], axis=0)
    for _ in range(4):
        moment = matmul(moment, moment)
        trace = jnp.trace(moment)
        moment = moment / jnp.where(trace == 0, 1.0, trace)

    def step(_: int, m: Array) -> Array:
        residual, vs = _residual(m, xs, weights)
        return retract(m, _newton(residual, vs, weights))

    return jax.lax.fori_loop(0, iterations, step, longest_row(moment))


@_mean.defjvp
def _(iterations: int, primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    """Differentiate the equation that the mean solves, not the way to the solution."""
    m = _mean(iterations, *primals)
    (_, vs), (moved, _) = jax.jvp(functools.partial(_residual, m), primals, tangents)
    turn = _newton(moved, vs, primals[1]) / 2
    return m, compose(m, jnp.concatenate([jnp.zeros_like(turn[:1]), turn]))


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
