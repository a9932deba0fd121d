"""An encoder of slides, or where they were told to go: Gaussian.

Looks at the joints themselves. Each joint may be missing on its own.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.kinematics.robot import SLIDE
from jaxest.sensors._masked import only, shown
from jaxest.types import Array, ArrayLike, Reading

FRAMES = 0
"""How many frames it looks at; 0 for the joints."""
JOINTS = SLIDE
"""The kind of joints it looks at."""
VALUE = ()
"""Shape of a joint's value."""


class Params(NamedTuple):
    """The sensor's numbers; scalars serve all joints."""

    variance: ArrayLike = 1e-4
    """() or (n,) m^2, positive: how far the robot may be from what is read."""
    offset: ArrayLike = 0.0
    """() or (n,) m, reading minus way."""


def predict(params: Params, ways: Array) -> Array:
    """Return what slides at `ways` (n,) m read, (n,) m."""
    return ways + jnp.asarray(params.offset, ways.dtype)


def log_prob(params: Params, reading: Reading, ways: Array) -> Array:
    """Return the log-density () of the readings, 0 for those that are missing.

    Args:
        params: the sensor's.
        reading: value (n,) m, valid () or (n,).
        ways: (n,) m, of the slides.
    """
    r = residual(params, reading, ways)
    _, valid = shown(reading, ways)
    constant = jnp.log(2 * math.pi * jnp.asarray(params.variance, ways.dtype)) / 2
    return jnp.sum(only(valid, -r * r / 2 - constant))


def residual(params: Params, reading: Reading, ways: Array) -> Array:
    """Return (n,) numbers with log-density -|r|^2 / 2 less a constant, 0 for those missing; arguments as `log_prob`."""
    value, valid = shown(reading, ways)
    return only(valid, value - predict(params, ways)) / jnp.sqrt(jnp.asarray(params.variance, ways.dtype))


def rows(params: Params, reading: Reading, ways: Array, jacobian: Array) -> tuple[Array, Array]:
    """Return the residual (n,) and its derivative (n, d), given that of the ways (n, d)."""
    _, valid = shown(reading, ways)
    root = jnp.sqrt(jnp.asarray(params.variance, ways.dtype))
    slope = only(valid, jnp.broadcast_to(-1 / root, ways.shape))
    return residual(params, reading, ways), slope[:, None] * jacobian


def precision(params: Params) -> ArrayLike:
    """Return how much a reading says of a joint, () or (n,) 1/m^2."""
    return 1 / jnp.asarray(params.variance)


def sample(key: Array, params: Params, ways: Array) -> Array:
    """Draw readings (n,) m of slides at `ways` (n,) m."""
    root = jnp.sqrt(jnp.asarray(params.variance, ways.dtype))
    return predict(params, ways) + root * jax.random.normal(key, ways.shape, ways.dtype)
