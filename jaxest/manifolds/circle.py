"""Angles: the element is one angle (), rad, in [-pi, pi); the tangent is (1,). Many angles: `product.Power`."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.manifolds.base import as_array, normalized
from jaxest.types import Array, ArrayLike

dim = 1

_TWO_PI_REST = 2.4492935982947064e-16  # 2 pi minus its float64


def wrap(angle: ArrayLike) -> Array:
    """Bring angles into [-pi, pi), pi being the dtype's own.

    An angle that lies there already is returned unchanged, so small ones lose nothing; the derivative is 1.

    Args:
        angle: (...) rad.

    Returns:
        (...) rad.

    Source: Sato 2023, fig. 3, ((x + pi) mod 2 pi) - pi, which alone would cost small angles their digits.
    """
    return _wrap(as_array("angle", angle, *jnp.shape(angle)))


@jax.custom_jvp
def _wrap(angle: Array) -> Array:
    pi, turn = (np.asarray(x, angle.dtype)[()] for x in (math.pi, 2 * math.pi))
    # The rest keeps a joint that goes round and round from drifting by 1.7e-7 rad a turn in float32.
    rest = 2 * math.pi - float(turn) + _TWO_PI_REST
    count = jnp.floor((angle + pi) / turn)
    wrapped = (angle - count * turn) - count * rest
    wrapped = jnp.where((wrapped < -pi) | (wrapped >= pi), -pi, wrapped)
    return jnp.where((angle >= -pi) & (angle < pi), angle, wrapped)


@_wrap.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    return _wrap(*primals), tangents[0]


def identity(dtype: jnp.dtype | None = None) -> Array:
    """Return the angle 0, ()."""
    return jnp.zeros((), dtype)


def exp(v: ArrayLike) -> Array:
    """Return the angle () of a tangent vector (1,), rad; raises ValueError for another shape."""
    return wrap(as_array("v", v, 1)[0])


def log(x: ArrayLike) -> Array:
    """Return the tangent vector (1,) of an angle (), rad; raises ValueError for another shape."""
    return wrap(as_array("x", x))[None]


def compose(x: ArrayLike, y: ArrayLike) -> Array:
    """Return the sum of two angles (), wrapped; raises ValueError for another shape."""
    return wrap(as_array("x", x) + as_array("y", y))


def inverse(x: ArrayLike) -> Array:
    """Return the opposite angle (); raises ValueError for another shape."""
    return wrap(-as_array("x", x))


def adjoint(x: ArrayLike) -> Array:
    """Return the adjoint (1, 1), which is 1: angles commute; raises ValueError for another shape."""
    return jnp.ones((1, 1), as_array("x", x).dtype)


def left_jacobian(v: ArrayLike) -> Array:
    """Return the Jacobian of exp (1, 1), which is 1; raises ValueError for another shape."""
    return jnp.ones((1, 1), as_array("v", v, 1).dtype)


left_jacobian_inverse = left_jacobian
right_jacobian = left_jacobian
right_jacobian_inverse = left_jacobian


def retract(x: ArrayLike, v: ArrayLike) -> Array:
    """Return the angle () at `v` (1,) from the angle `x` (), rad; raises ValueError for another shape."""
    return compose(x, as_array("v", v, 1)[0])


def local(x: ArrayLike, y: ArrayLike) -> Array:
    """Return the way (1,) from the angle `x` () to `y` (), within half a turn; raises ValueError for another shape."""
    return wrap(as_array("y", y) - as_array("x", x))[None]


def interpolate(x: ArrayLike, y: ArrayLike, t: ArrayLike) -> Array:
    """Return the angle () at the fraction `t` () of the short way from `x` () to `y` ()."""
    return retract(x, t * local(x, y))


def mean(xs: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the intrinsic mean: the angle from which the weighted differences sum to zero.

    Args:
        xs: (N,) angles, rad.
        weights: (N,), any scale; all equal if None.

    Returns:
        () angle, rad: the local minimum of the weighted squared distance next to `mean_direction`. Its gradient is
        the normalized weights, finite everywhere.

    Raises:
        ValueError: a shape is wrong.
    """
    xs = as_array("xs", xs, None)
    weights = normalized(weights, xs)
    start = jax.lax.stop_gradient(mean_direction(xs, weights))
    # The circle is flat: one step is exact, and the next ones matter only if a sample changes sides.
    for _ in range(3):
        start = wrap(start + jnp.sum(weights * wrap(xs - start)))
    return start


def mean_direction(xs: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the direction of the weighted mean of the unit vectors (the extrinsic mean).

    Args:
        xs: (N,) angles, rad.
        weights: (N,), any scale; all equal if None.

    Returns:
        () angle, rad; 0 where the vectors cancel exactly.

    Raises:
        ValueError: a shape is wrong.

    Source: Sato 2023, eq. 5, with the weighted means that the print lost.
    """
    xs = as_array("xs", xs, None)
    weights = normalized(weights, xs)
    sine, cosine = jnp.sum(weights * jnp.sin(xs)), jnp.sum(weights * jnp.cos(xs))
    cancelled = (sine == 0) & (cosine == 0)
    return wrap(jnp.arctan2(sine, jnp.where(cancelled, 1.0, cosine)))


__all__ = [
    "adjoint",
    "compose",
    "dim",
    "exp",
    "identity",
    "interpolate",
    "inverse",
    "left_jacobian",
    "left_jacobian_inverse",
    "local",
    "log",
    "mean",
    "mean_direction",
    "retract",
    "right_jacobian",
    "right_jacobian_inverse",
    "wrap",
]
