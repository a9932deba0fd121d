"""From the mean resultant length of a von Mises distribution back to its concentration."""

import jax
import jax.numpy as jnp

from jaxest.distributions._bessel import ratio_and_complement, slope
from jaxest.types import Array


@jax.custom_jvp
@jax.jit
def invert(r: Array, b: Array) -> Array:
    """Return k of r = I1/I0 and b = 1 - r, of which the smaller one is trusted."""
    inside = (r > 0) & (b > 0)
    r_, b_ = jnp.where(inside, r, 0.5), jnp.where(inside, b, 0.5)
    low = r_ * (2 + r_ * r_ * (1 + 5 / 6 * r_ * r_))
    middle = -0.4 + 1.39 * r_ + 0.43 / b_
    high = 1 / (r_ * b_ * (2 + b_))
    start = jnp.where(r_ < 0.53, low, jnp.where(r_ < 0.85, middle, high))

    def newton(_: int, k: Array) -> Array:
        """Solve 1 / (1 - I1/I0) = 1 / b, which is almost linear in k."""
        ratio, complement = ratio_and_complement(k)
        missing = jnp.where(r_ < b_, r_ - ratio, complement - b_)
        step = missing * complement / (b_ * slope(k))
        return jnp.maximum(k + step, k / 8)

    k = jax.lax.fori_loop(0, 5, newton, start)
    edge = jnp.where((r == 0) & (b > 0), 0.0, jnp.where((b == 0) & (r > 0), jnp.inf, jnp.nan))
    return jnp.where(inside, k, edge.astype(k.dtype))


@invert.defjvp
def _(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    """Differentiate the equation; r and b move against each other, so half their difference counts."""
    k = invert(*primals)
    finite = jnp.isfinite(k)
    rise = slope(jnp.where(finite, k, 1.0))
    return k, jnp.where(finite, (tangents[0] - tangents[1]) / (2 * rise), 0.0)
