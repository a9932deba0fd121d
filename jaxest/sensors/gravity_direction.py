"""Which way is up, from a raw accelerometer on a link that hardly accelerates: von Mises-Fisher on its direction."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import Frames
from jaxest.kinematics import components as c
from jaxest.sensors import _turned
from jaxest.sensors._masked import only, shown
from jaxest.types import Array, ArrayLike, Reading

FRAMES = 1
"""How many frames it looks at."""
VALUE = (3,)
"""Shape of its value."""


class Params(NamedTuple):
    """The sensor's numbers."""

    concentration: ArrayLike = 400.0
    """() at least 0, 1/rad^2 of each of the two tilts (400: 0.05 rad)."""
    mounting: ArrayLike = np.array([1.0, 0.0, 0.0, 0.0])
    """(4,) wxyz, sensor to frame; normalised on use."""
    up: ArrayLike = np.array([0.0, 0.0, 1.0])
    """(3,) unit, the specific force at rest in the world: against gravity."""


def _orientation(params: Params, frames: Frames) -> c.Quaternion:
    mounting = _turned.unit(jnp.asarray(params.mounting, frames.quaternion.dtype))
    return c.multiply(c.split(frames.quaternion[0]), mounting)


def predict(params: Params, frames: Frames) -> Array:
    """Return the direction (3,) of the specific force in the sensor on the one frame given, +1 g up at rest."""
    up = c.split(jnp.asarray(params.up, frames.quaternion.dtype))
    return jnp.stack(c.rotate_back(_orientation(params, frames), up))


def _direction(reading: Reading, frames: Frames) -> Array:
    value, valid = shown(reading, frames.position)
    square = jnp.sum(value * value)
    there = square > jnp.finfo(value.dtype).tiny
    return only(valid, value / jnp.sqrt(jnp.where(there, square, 1)))


def log_prob(params: Params, reading: Reading, frames: Frames) -> Array:
    """Return the log-density () per steradian, 0 where it is missing.

    Args:
        params: the sensor's.
        reading: value (3,) specific force in the sensor, of any length; valid ().
        frames: the one frame.
    """
    k = jnp.asarray(params.concentration, frames.position.dtype)
    r = residual(params, reading, frames)
    some = jnp.where(k > 0, k, 1)
    constant = jnp.log(jnp.where(k > 0, some / -jnp.expm1(-2 * some), 0.5)) - math.log(2 * math.pi)
    return only(reading.valid, constant - (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) / 2)


def residual(params: Params, reading: Reading, frames: Frames) -> Array:
    """Return (3,) numbers with log-density -|r|^2 / 2 less a constant, 0 where missing; arguments as `log_prob`."""
    root = jnp.sqrt(jnp.asarray(params.concentration, frames.position.dtype))
    return only(reading.valid, root * (_direction(reading, frames) - predict(params, frames)))


def rows(params: Params, reading: Reading, frames: Frames, jacobian: Array) -> tuple[Array, Array]:
    """Return the residual (3,) and its derivative (3, d), given the frame's geometric Jacobian (1, 6, d)."""
    dtype = frames.position.dtype
    turn = tuple(jacobian[0, i] for i in range(3))
    shape = turn[0].shape
    up = tuple(jnp.broadcast_to(u, shape) for u in c.split(jnp.asarray(params.up, dtype)))
    orientation = tuple(jnp.broadcast_to(x, shape) for x in _orientation(params, frames))
    root = jnp.sqrt(jnp.asarray(params.concentration, dtype))
    slope = jnp.stack([-root * m for m in c.rotate_back(orientation, c.cross(up, turn))])
    return residual(params, reading, frames), only(reading.valid, slope)


def sample(key: Array, params: Params, frames: Frames) -> Array:
    """Draw a direction (3,) of unit length.

    Source: Ulrich 1984 and Wood 1994: on the sphere the cosine's distribution is inverted in closed form.
    """
    dtype = frames.position.dtype
    k = jnp.asarray(params.concentration, dtype)
    u, turn = jax.random.uniform(key, (2,), dtype, minval=jnp.finfo(dtype).tiny)
    some = jnp.where(k > 0, k, 1)
    # 1 - cosine, so that narrow ones keep their digits; evenly spread where nothing is concentrated.
    fall = jnp.where(k > 0, -jnp.log(u + (1 - u) * jnp.exp(-2 * some)) / some, 2 * (1 - u))
    sine, angle = jnp.sqrt(fall * (2 - fall)), 2 * math.pi * turn
    centre = predict(params, frames)
    side = _across(centre)
    other = jnp.cross(centre, side)
    return centre * (1 - fall) + sine * (jnp.cos(angle) * side + jnp.sin(angle) * other)


def _across(direction: Array) -> Array:
    """Return a unit vector (3,) across another."""
    helper = jnp.eye(3, dtype=direction.dtype)[jnp.argmin(jnp.abs(direction))]
    side = jnp.cross(direction, helper)
    return side / jnp.sqrt(jnp.sum(side * side))
