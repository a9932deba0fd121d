"""I1/I0, one minus it, and log(I0 e^-k): accurate to a few eps with their derivatives, from k = 0 to infinity.

`jax.scipy.special` has I0 and I1, but 1 - I1/I0 of them keeps no digits above k = 1e8 (in float32 above 1e4), and the
derivative of its `i0e` is wrong at 0.
"""

import math

import jax
import jax.numpy as jnp
from jax.scipy.special import i0e

from jaxest.types import Array

_SPLIT = 4.0

# 2 k (1 - I1(k)/I0(k)) - 1 for k >= 4 as a Chebyshev series in 8/k - 1, from its values at 64 nodes to 100 digits
# (power series, asymptotic series above k = 70).
_CHEBYSHEV = (
    0.04105765455423353, 0.045256481205528214, 0.004860010250231605, 0.0007104851937182382, 1.02143827908323e-05,
    -5.884136186289292e-05, -2.0867626475778838e-05, 1.2315803339109978e-06, 2.8914415611195005e-06,
    2.498285353921823e-07, -4.0325123763473113e-07, -5.7825399193130144e-08, 6.676731670793898e-08,
    7.622884700952486e-09, -1.274404881596862e-08, -7.108882399908406e-11, 2.522963246179959e-09,
    -4.1472311125358187e-10, -4.487923104222799e-10, 1.9083829200822275e-10, 5.2151758128169176e-11,
    -5.7854258521477704e-11, 4.981605232084359e-12, 1.223710693603654e-11, -5.3634520670460975e-12,
    -1.1212495605249567e-12, 1.7829611781136944e-12, -4.158572505318554e-13, -2.962331404635885e-13,
    2.381118986203602e-13, -2.583803640194624e-14, -5.3524590098797485e-14, 3.265667253281553e-14,
    -8.814634005779154e-16, -8.898846729190316e-15, 4.8563809363475946e-15, 3.486311977394732e-17,
    -1.4588394189455322e-15, 7.985198294589713e-16, -1.0131034401634737e-17, -2.3860914665425956e-16,
    1.4360001744370107e-16, -1.1585360457400014e-17, -3.81853148433771e-17, 2.735917298185759e-17,
    -4.9844967173318905e-18,
)  # fmt: skip


def _terms(dtype: jnp.dtype) -> int:
    """Return how many terms of the series the dtype can see in the value and in its first two derivatives."""
    eps = float(jnp.finfo(dtype).eps)
    return max(j for j, c in enumerate(_CHEBYSHEV) if abs(c) * max(j, 1) ** 2 > eps / 8) + 1


def _near(k: Array) -> tuple[Array, Array]:
    """Return I0(k) and 2 I1(k) / k for |k| <= 4: power series of positive terms."""
    x = k * k / 4
    eps = float(jnp.finfo(k.dtype).eps)
    count = next(j for j in range(40) if (_SPLIT / 2) ** (2 * j) / math.factorial(j) ** 2 < eps / 32)
    i0, i1 = jnp.ones_like(k), jnp.ones_like(k)
    for j in range(count, 0, -1):
        i0, i1 = 1 + x / j**2 * i0, 1 + x / (j * (j + 1)) * i1
    return i0, i1


def _far(k: Array) -> Array:
    """Return 1 - I1(k)/I0(k) for k >= 4."""
    t = _SPLIT / k
    u = 2 * t - 1
    b1 = b2 = jnp.zeros_like(k)
    for c in _CHEBYSHEV[_terms(k.dtype) - 1 : 0 : -1]:
        b1, b2 = c + 2 * u * b1 - b2, b1
    series = _CHEBYSHEV[0] + u * b1 - b2
    return t / (2 * _SPLIT) * (1 + series)


def ratio_and_complement(k: Array) -> tuple[Array, Array]:
    """Return I1(k)/I0(k) and 1 - I1(k)/I0(k), each to a few eps of itself.

    Args:
        k: (...) at least 0, in any floating type; 1 and 0 at infinity.

    Returns:
        Two arrays (...); NaN for negative k. Derivatives of any order are those of the series, accurate too.

    Source: power series (Abramowitz and Stegun 9.6.10) up to k = 4, a Chebyshev series beyond.
    """
    small = k <= _SPLIT
    low, high = jnp.where(small, k, 1.0), jnp.where(small, 2 * _SPLIT, k)
    i0, i1 = _near(low)
    complement = _far(high)
    negative = jnp.where(k < 0, jnp.nan, 0.0).astype(k.dtype)
    ratio = jnp.where(small, low / 2 * i1 / i0, 1 - complement) + negative
    return ratio, jnp.where(small, (i0 - low / 2 * i1) / i0, complement) + negative


def slope(k: Array) -> Array:
    """Return the derivative of I1(k)/I0(k) (...), to some eps of itself also where it is 1e-16."""
    return jax.jvp(lambda k: ratio_and_complement(k)[0], (k,), (jnp.ones_like(k),))[1]


@jax.custom_jvp
def log_i0e(k: Array) -> Array:
    """Return log(I0(k) e^-k).

    Args:
        k: (...) at least 0.

    Returns:
        (...) at most 0; its derivative is I1(k)/I0(k) - 1, which is -1 at 0. NaN for negative k.
    """
    small = k <= _SPLIT
    low = jnp.where(small, k, 1.0)
    value = jnp.where(small, jnp.log(_near(low)[0]) - low, jnp.log(i0e(jnp.where(small, 2 * _SPLIT, k))))
    return jnp.where(k < 0, jnp.nan, value)


@log_i0e.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    return log_i0e(*primals), -ratio_and_complement(*primals)[1] * tangents[0]
