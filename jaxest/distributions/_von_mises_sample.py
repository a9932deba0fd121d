"""Exact rejection for the von Mises distribution, by the tangent of the half angle."""

import functools
import math

import jax
import jax.numpy as jnp

from jaxest.distributions import _rejection
from jaxest.distributions._rejection import Draws
from jaxest.types import Array


@functools.partial(jax.jit, static_argnums=(2, 3))
def drawn_about_zero(key: Array, concentration: Array, whole: tuple[int, ...], rounds: int) -> Draws:
    """Return angles about 0."""
    count, dtype = math.prod(whole), concentration.dtype
    k = jnp.broadcast_to(concentration, whole if concentration.ndim else (count,)).reshape(-1)
    b = 1 + 1 / (jnp.sqrt(4 * k * k + 1) + 2 * k)
    spread = jnp.sqrt(b / (b + 4 * k))

    def propose(key: Array) -> tuple[Array, Array]:
        u = jax.random.uniform(key, (2, count), dtype)
        tangent = spread * jnp.tan(math.pi * (u[0] - 0.5))
        energy = 2 * k / (1 + 1 / (tangent * tangent))  # 2 k sin^2 of the half angle
        bound = (2 - b) / 2 - energy + jnp.log((b + 2 * energy) / 2)
        return tangent, jnp.log1p(-u[1]) <= bound

    draw = _rejection.pooled if concentration.ndim == 0 and count > 1 else _rejection.each
    tangent, done = draw(key, propose, rounds)
    return Draws(2 * jnp.arctan(tangent).reshape(whole), done.reshape(whole))
