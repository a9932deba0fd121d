"""The position of a point on a link in the world, as a camera gives it from a marker: Gaussian."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import Frames
from jaxest.kinematics import components as c
from jaxest.sensors._masked import only, shown
from jaxest.types import Array, ArrayLike, Reading

FRAMES = 1
"""How many frames it looks at."""
VALUE = (3,)
"""Shape of its value."""


class Params(NamedTuple):
    """The sensor's numbers."""

    variance: ArrayLike = np.array([0.01, 0.01, 0.01])
    """(3,) m^2, positive, along the world's axes. Source: Sato 2023, Table I."""
    offset: ArrayLike = np.array([0.0, 0.0, 0.0])
    """(3,) m, the point in the frame."""


def _predicted(params: Params, frames: Frames) -> tuple[c.Vector, c.Vector]:
    """Return the point, and the way to it from the frame's origin."""
    offset = c.split(jnp.asarray(params.offset, frames.position.dtype))
    arm = c.rotate(c.split(frames.quaternion[0]), offset)
    return c.add(c.split(frames.position[0]), arm), arm


def predict(params: Params, frames: Frames) -> Array:
    """Return the point (3,) m in the world, on the one frame given."""
    return jnp.stack(_predicted(params, frames)[0])


def log_prob(params: Params, reading: Reading, frames: Frames) -> Array:
    """Return the log-density () per m^3, 0 where it is missing.

    Args:
        params: the sensor's.
        reading: value (3,) m in the world; valid ().
        frames: the one frame.

    Source: Sato 2023, eq. 26.
    """
    variance = jnp.asarray(params.variance, frames.position.dtype)
    r = residual(params, reading, frames)
    constant = jnp.sum(jnp.log(variance)) / 2 + 1.5 * math.log(2 * math.pi)
    return only(reading.valid, -(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) / 2 - constant)


def residual(params: Params, reading: Reading, frames: Frames) -> Array:
    """Return (3,) numbers with log-density -|r|^2 / 2 less a constant, 0 where missing; arguments as `log_prob`."""
    value, valid = shown(reading, frames.position)
    root = jnp.sqrt(jnp.asarray(params.variance, value.dtype))
    return only(valid, value - predict(params, frames)) / root


def rows(params: Params, reading: Reading, frames: Frames, jacobian: Array) -> tuple[Array, Array]:
    """Return the residual (3,) and its derivative (3, d), given the frame's geometric Jacobian (1, 6, d)."""
    turn, shift = (tuple(jacobian[0, i + j] for i in range(3)) for j in (0, 3))
    arm = tuple(jnp.broadcast_to(a, turn[0].shape) for a in _predicted(params, frames)[1])
    moved = c.add(shift, c.cross(turn, arm))
    root = jnp.sqrt(jnp.asarray(params.variance, frames.position.dtype))
    slope = jnp.stack([-m / s for m, s in zip(moved, c.split(root), strict=True)])
    return residual(params, reading, frames), only(reading.valid, slope)


def sample(key: Array, params: Params, frames: Frames) -> Array:
    """Draw a reading (3,) m."""
    root = jnp.sqrt(jnp.asarray(params.variance, frames.position.dtype))
    return predict(params, frames) + root * jax.random.normal(key, (3,), root.dtype)
