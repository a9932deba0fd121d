"""Observed against predicted rotations under a Bingham density, and rows for it, by components.

With the error e = observed * predicted^-1 (wxyz) the log-density is sum lam_i e_i^2 less a constant. As e has unit
length, that is the same as -|r|^2 / 2 with r_i = sqrt(2 (lam_w - lam_i)) e_i for i = x, y, z.
"""

import jax.numpy as jnp

from jaxest.distributions import bingham
from jaxest.kinematics import components as c
from jaxest.types import Array


def unit(q: Array) -> c.Quaternion:
    """Return a quaternion (4,) by components, of unit length."""
    return tuple(x / jnp.sqrt(jnp.sum(q * q)) for x in c.split(q))


def error(observed: Array, predicted: c.Quaternion) -> c.Quaternion:
    """Return observed * predicted^-1."""
    return c.multiply(c.split(observed), c.conjugate(predicted))


def log_density(lam: Array, e: c.Quaternion) -> Array:
    """Return the log-density () per unit of area of S^3."""
    shifted = lam - jnp.max(lam)
    energy = sum(jnp.asarray(s * x * x) for s, x in zip(c.split(shifted), e, strict=True))
    return jnp.asarray(energy) - bingham.log_normalizer(shifted)


def roots(lam: Array) -> c.Vector:
    """Return the weights of r; what is more concentrated along w than lam_w itself is left out."""
    return c.split(jnp.sqrt(jnp.maximum(2 * (lam[0] - lam[1:]), 0)))


def residual(lam: Array, e: c.Quaternion) -> Array:
    """Return r (3,)."""
    return jnp.stack([s * x for s, x in zip(roots(lam), e[1:], strict=True)])


def jacobian(lam: Array, e: c.Quaternion, rate: c.Vector) -> Array:
    """Return the derivative (3, d) of r, where the predicted rotation turns at `rate`, components (d,) in e's frame."""
    w, x, y, z = (jnp.broadcast_to(a, rate[0].shape) for a in e)
    moved = c.scale(c.add(c.scale(rate, w), c.cross((x, y, z), rate)), -0.5)
    return jnp.stack([s * m for s, m in zip(roots(lam), moved, strict=True)])
