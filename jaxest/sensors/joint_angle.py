"""An encoder, or the angle that a joint was told to take: von Mises.

Looks at the joints themselves. Each joint may be missing on its own.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.distributions import von_mises
from jaxest.kinematics.components import half_sincos
from jaxest.kinematics.robot import HINGE
from jaxest.manifolds import circle
from jaxest.sensors._masked import only, shown
from jaxest.types import Array, ArrayLike, Reading

FRAMES = 0
"""How many frames it looks at; 0 for the joints."""
JOINTS = HINGE
"""The kind of joints it looks at."""
VALUE = ()
"""Shape of a joint's value."""


class Params(NamedTuple):
    """The sensor's numbers; scalars serve all joints."""

    concentration: ArrayLike = 15.0
    """() or (n,), at least 0; 1/rad^2 where it is large. Source: Sato 2023, Table I."""
    offset: ArrayLike = 0.0
    """() or (n,) rad, reading minus angle."""


def predict(params: Params, angles: Array) -> Array:
    """Return what joints at `angles` (n,) rad read, (n,) rad."""
    return circle.wrap(angles + jnp.asarray(params.offset, angles.dtype))


def log_prob(params: Params, reading: Reading, angles: Array) -> Array:
    """Return the log-density () of the readings, 0 for those that are missing.

    Args:
        params: the sensor's.
        reading: value (n,) rad, valid () or (n,).
        angles: (n,) rad, of the joints.

    Source: Sato 2023, eq. 28.
    """
    value, valid = shown(reading, angles)
    concentration = jnp.asarray(params.concentration, angles.dtype)
    error = only(valid, value - predict(params, angles))
    s, _ = half_sincos(circle.wrap(error))
    peak = von_mises.log_prob(jnp.zeros((), angles.dtype), 0.0, concentration)
    return jnp.sum(only(valid, -2 * concentration * s * s + peak))


def residual(params: Params, reading: Reading, angles: Array) -> Array:
    """Return (n,) numbers with log-density -|r|^2 / 2 less a constant, 0 for those missing; arguments as `log_prob`."""
    value, valid = shown(reading, angles)
    s, _ = half_sincos(only(valid, circle.wrap(value - predict(params, angles))))
    return 2 * jnp.sqrt(jnp.asarray(params.concentration, angles.dtype)) * s


def rows(params: Params, reading: Reading, angles: Array, jacobian: Array) -> tuple[Array, Array]:
    """Return the residual (n,) and its derivative (n, d), given that of the angles (n, d)."""
    value, valid = shown(reading, angles)
    s, c = half_sincos(only(valid, circle.wrap(value - predict(params, angles))))
    root = jnp.sqrt(jnp.asarray(params.concentration, angles.dtype))
    slope = only(valid, -root * c)
    return 2 * root * s, slope[:, None] * jacobian


def precision(params: Params) -> ArrayLike:
    """Return how much a reading says of a joint, () or (n,) 1/rad^2, but for the noise's shape."""
    return params.concentration


def sample(key: Array, params: Params, angles: Array) -> Array:
    """Draw readings (n,) rad of joints at `angles` (n,) rad."""
    concentration = jnp.asarray(params.concentration, angles.dtype)
    return von_mises.sample(jax.random.fold_in(key, 0), predict(params, angles), concentration, angles.shape)
