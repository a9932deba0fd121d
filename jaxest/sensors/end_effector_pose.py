"""Position and orientation of a link in the world together: Gaussian times Bingham."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.kinematics import Frames
from jaxest.sensors import link_orientation, link_position
from jaxest.types import Array, Reading

FRAMES = 1
"""How many frames it looks at."""
VALUE = (7,)
"""Shape of its value: m, then wxyz."""


class Params(NamedTuple):
    """The sensor's numbers."""

    position: link_position.Params = link_position.Params()
    orientation: link_orientation.Params = link_orientation.Params(link_orientation.unimodal())


def _parts(reading: Reading) -> tuple[Reading, Reading]:
    value = jnp.asarray(reading.value)
    return Reading(value[:3], reading.valid), Reading(value[3:], reading.valid)


def predict(params: Params, frames: Frames) -> Array:
    """Return the pose (7,), m in the world and wxyz sensor to world, on the one frame given."""
    position = link_position.predict(params.position, frames)
    return jnp.concatenate([position, link_orientation.predict(params.orientation, frames)])


def log_prob(params: Params, reading: Reading, frames: Frames) -> Array:
    """Return the log-density (), 0 where it is missing.

    Args:
        params: the sensor's.
        reading: value (7,) m and unit quaternion wxyz; valid ().
        frames: the one frame.

    Source: Sato 2023, eqs. 26 and 27.
    """
    where, turn = _parts(reading)
    position = link_position.log_prob(params.position, where, frames)
    return position + link_orientation.log_prob(params.orientation, turn, frames)


def residual(params: Params, reading: Reading, frames: Frames) -> Array:
    """Return (6,) numbers with log-density -|r|^2 / 2 less a constant, 0 where missing; arguments as `log_prob`."""
    where, turn = _parts(reading)
    position = link_position.residual(params.position, where, frames)
    return jnp.concatenate([position, link_orientation.residual(params.orientation, turn, frames)])


def rows(params: Params, reading: Reading, frames: Frames, jacobian: Array) -> tuple[Array, Array]:
    """Return the residual (6,) and its derivative (6, d), given the frame's geometric Jacobian (1, 6, d)."""
    where, turn = _parts(reading)
    first, slope = link_position.rows(params.position, where, frames, jacobian)
    second, tilt = link_orientation.rows(params.orientation, turn, frames, jacobian)
    return jnp.concatenate([first, second]), jnp.concatenate([slope, tilt])


def sample(key: Array, params: Params, frames: Frames) -> Array:
    """Draw a reading (7,)."""
    one, two = jax.random.split(key)
    position = link_position.sample(one, params.position, frames)
    return jnp.concatenate([position, link_orientation.sample(two, params.orientation, frames)])
