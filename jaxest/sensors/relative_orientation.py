"""The rotation from one link to another, as two IMUs with a common heading or a camera on a link give it: Bingham.

The error is about the axes of the first sensor.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.distributions import bingham
from jaxest.kinematics import Frames
from jaxest.kinematics import components as c
from jaxest.sensors import _turned
from jaxest.sensors._masked import only, shown
from jaxest.types import Array, ArrayLike, Reading

FRAMES = 2
"""How many frames it looks at: where the first and the second sensor sit."""
VALUE = (4,)
"""Shape of its value."""


class Params(NamedTuple):
    """The sensor's numbers."""

    lam: ArrayLike = np.array([0.0, -800.0, -800.0, -800.0])
    """(4,) Bingham concentrations of the error's w, x, y, z."""
    first_mounting: ArrayLike = np.array([1.0, 0.0, 0.0, 0.0])
    """(4,) wxyz, first sensor to first frame; normalised on use."""
    second_mounting: ArrayLike = np.array([1.0, 0.0, 0.0, 0.0])
    """(4,) wxyz, second sensor to second frame; normalised on use."""


def _sensors(params: Params, frames: Frames) -> tuple[c.Quaternion, c.Quaternion]:
    first, second = (
        c.multiply(c.split(frames.quaternion[i]), _turned.unit(jnp.asarray(m, frames.quaternion.dtype)))
        for i, m in enumerate((params.first_mounting, params.second_mounting))
    )
    return first, second


def _predicted(params: Params, frames: Frames) -> c.Quaternion:
    first, second = _sensors(params, frames)
    return c.multiply(c.conjugate(first), second)


def predict(params: Params, frames: Frames) -> Array:
    """Return the rotation (4,) wxyz, second sensor to first, on the two frames given."""
    return jnp.stack(_predicted(params, frames))


def log_prob(params: Params, reading: Reading, frames: Frames) -> Array:
    """Return the log-density () per unit of area of S^3, 0 where it is missing.

    Args:
        params: the sensor's.
        reading: value (4,) unit quaternion wxyz, second sensor to first; valid ().
        frames: the two frames.
    """
    value, _ = shown(reading, frames.quaternion)
    lam = jnp.asarray(params.lam, value.dtype)
    return only(reading.valid, _turned.log_density(lam, _turned.error(value, _predicted(params, frames))))


def residual(params: Params, reading: Reading, frames: Frames) -> Array:
    """Return (3,) numbers with log-density -|r|^2 / 2 less a constant, 0 where missing; arguments as `log_prob`."""
    value, _ = shown(reading, frames.quaternion)
    return _turned.residual(jnp.asarray(params.lam, value.dtype), _turned.error(value, _predicted(params, frames)))


def rows(params: Params, reading: Reading, frames: Frames, jacobian: Array) -> tuple[Array, Array]:
    """Return the residual (3,) and its derivative (3, d), given the frames' geometric Jacobians (2, 6, d)."""
    value, _ = shown(reading, frames.quaternion)
    lam = jnp.asarray(params.lam, value.dtype)
    first, second = _sensors(params, frames)
    e = _turned.error(value, c.multiply(c.conjugate(first), second))
    apart = tuple(jacobian[1, i] - jacobian[0, i] for i in range(3))
    rate = c.rotate_back(tuple(jnp.broadcast_to(x, apart[0].shape) for x in first), apart)
    return _turned.residual(lam, e), _turned.jacobian(lam, e, rate)


def sample(key: Array, params: Params, frames: Frames) -> Array:
    """Draw a reading (4,) wxyz."""
    dtype = frames.quaternion.dtype
    e = bingham.sample(key, bingham.standard(jnp.asarray(params.lam, dtype)), (1,))[0]
    return jnp.stack(c.multiply(c.split(e), _predicted(params, frames)))
