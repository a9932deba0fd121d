"""Scalar functions of the squared rotation angle s = t^2, right to a few eps with their derivatives.

Every one is smooth in s, also at 0: a Taylor polynomial below `SWITCH`, the closed form above. The closed forms lose
eps/t^2 in value and more in each derivative, and a polynomial of two terms that is switched at a small angle loses as
much on its other side. So the polynomial, of as many terms as the dtype can see, serves up to half a turn: no term
there is large against the sum, and no switch falls between two rotations that `log` can return.
"""

import math
from collections.abc import Callable

import jax.numpy as jnp

from jaxest.types import Array

SWITCH = 10.0  # just above pi^2
_SPARE = 3  # terms beyond those the value needs: each derivative needs about one more


def _taylor(coefficient: Callable[[int], float]) -> tuple[float, ...]:
    return tuple(coefficient(j) for j in range(32))


_COS_HALF = _taylor(lambda j: (-1) ** j / (4**j * math.factorial(2 * j)))
_SIN_HALF = _taylor(lambda j: (-1) ** j / (2 * 4**j * math.factorial(2 * j + 1)))
_ONE_MINUS_COS = _taylor(lambda j: (-1) ** j / math.factorial(2 * j + 2))
_T_MINUS_SIN = _taylor(lambda j: (-1) ** j / math.factorial(2 * j + 3))
_SIN_MINUS_T_COS_HALF = _taylor(lambda j: (-1) ** j * (2 * j + 2) / (4**j * math.factorial(2 * j + 3)))
_ARCTAN = _taylor(lambda j: (-1) ** j / (2 * j + 1))


def _polynomial(s: Array, taylor: tuple[float, ...], largest: float) -> Array:
    """Evaluate a Taylor series at 0 <= s <= largest with the terms that the dtype of s can see."""
    visible = float(jnp.finfo(s.dtype).eps) / 8 * abs(taylor[0])
    count = next(j for j, c in enumerate(taylor) if abs(c) * largest**j < visible) + _SPARE
    value = jnp.full_like(s, taylor[count - 1])
    for coefficient in reversed(taylor[: count - 1]):
        value = value * s + coefficient
    return value


def _split(s: Array) -> tuple[Array, Array, Array]:
    """Return (s is small, s where small else 0, t where large else a harmless angle)."""
    small = s < SWITCH
    return small, jnp.where(small, s, 0.0), jnp.sqrt(jnp.where(small, SWITCH, s))


def cos_half(s: Array) -> Array:
    """cos(t/2)."""
    small, near, t = _split(s)
    return jnp.where(small, _polynomial(near, _COS_HALF, SWITCH), jnp.cos(t / 2))


def sin_half(s: Array) -> Array:
    """sin(t/2) / t, 1/2 at 0."""
    small, near, t = _split(s)
    return jnp.where(small, _polynomial(near, _SIN_HALF, SWITCH), jnp.sin(t / 2) / t)


def one_minus_cos(s: Array) -> Array:
    """(1 - cos t) / t^2, 1/2 at 0."""
    small, near, t = _split(s)
    return jnp.where(small, _polynomial(near, _ONE_MINUS_COS, SWITCH), 2 * (jnp.sin(t / 2) / t) ** 2)


def t_minus_sin(s: Array) -> Array:
    """(t - sin t) / t^3, 1/6 at 0."""
    small, near, t = _split(s)
    return jnp.where(small, _polynomial(near, _T_MINUS_SIN, SWITCH), (t - jnp.sin(t)) / t**3)


def inverse_jacobian(s: Array) -> Array:
    """(1 - (t/2) cot(t/2)) / t^2, 1/12 at 0; finite beyond a half turn up to the pole at a full one."""
    small, near, t = _split(s)
    series = _polynomial(near, _SIN_MINUS_T_COS_HALF, SWITCH) / (8 * _polynomial(near, _SIN_HALF, SWITCH))
    return jnp.where(small, series, (1 - t / 2 * jnp.cos(t / 2) / jnp.sin(t / 2)) / t**2)


def arctan_ratio(r: Array) -> Array:
    """arctan(y) / y of r = y^2, for y up to tan(pi/16), where `quaternion.log` needs it."""
    return _polynomial(r, _ARCTAN, math.tan(math.pi / 16) ** 2)


__all__ = ["SWITCH", "arctan_ratio", "cos_half", "inverse_jacobian", "one_minus_cos", "sin_half", "t_minus_sin"]
