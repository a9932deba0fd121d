"""The orientation of a link in the world, as an attitude filter on an IMU gives it: Bingham.

The error is about the world's axes, so that `axisymmetric` leaves the yaw about the vertical free, which a 6-axis IMU
cannot know.
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

FRAMES = 1
"""How many frames it looks at."""
VALUE = (4,)
"""Shape of its value."""


def unimodal(concentration: float = 800.0) -> np.ndarray:
    """Return `lam` (4,) for errors of 1 / sqrt(2 concentration) half turns' sines about every axis (800: 0.05 rad)."""
    return np.array([0.0, -concentration, -concentration, -concentration])


def axisymmetric(concentration: float = 800.0) -> np.ndarray:
    """Return `lam` (4,) that says nothing of the rotation about the world's z; see `unimodal`."""
    return np.array([0.0, -concentration, -concentration, 0.0])


class Params(NamedTuple):
    """The sensor's numbers."""

    lam: ArrayLike = np.array([0.0, -800.0, -800.0, 0.0])
    """(4,) Bingham concentrations of the error's w, x, y, z. Source: Sato 2023, Table I (there in xyzw)."""
    mounting: ArrayLike = np.array([1.0, 0.0, 0.0, 0.0])
    """(4,) wxyz, sensor to frame; normalised on use."""


def _predicted(params: Params, frames: Frames) -> c.Quaternion:
    mounting = _turned.unit(jnp.asarray(params.mounting, frames.quaternion.dtype))
    return c.multiply(c.split(frames.quaternion[0]), mounting)


def predict(params: Params, frames: Frames) -> Array:
    """Return the sensor's orientation (4,) wxyz, sensor to world, on the one frame given."""
    return jnp.stack(_predicted(params, frames))


def log_prob(params: Params, reading: Reading, frames: Frames) -> Array:
    """Return the log-density () per unit of area of S^3, 0 where it is missing.

    Args:
        params: the sensor's.
        reading: value (4,) unit quaternion wxyz, sensor to world; valid ().
        frames: the one frame.

    Source: Sato 2023, eq. 27.
    """
    value, _ = shown(reading, frames.quaternion)
    lam = jnp.asarray(params.lam, value.dtype)
    return only(reading.valid, _turned.log_density(lam, _turned.error(value, _predicted(params, frames))))


def residual(params: Params, reading: Reading, frames: Frames) -> Array:
    """Return (3,) numbers with log-density -|r|^2 / 2 less a constant, 0 where missing; arguments as `log_prob`."""
    value, _ = shown(reading, frames.quaternion)
    return _turned.residual(jnp.asarray(params.lam, value.dtype), _turned.error(value, _predicted(params, frames)))


def rows(params: Params, reading: Reading, frames: Frames, jacobian: Array) -> tuple[Array, Array]:
    """Return the residual (3,) and its derivative (3, d), given the frame's geometric Jacobian (1, 6, d)."""
    value, _ = shown(reading, frames.quaternion)
    lam = jnp.asarray(params.lam, value.dtype)
    e = _turned.error(value, _predicted(params, frames))
    return _turned.residual(lam, e), _turned.jacobian(lam, e, tuple(jacobian[0, i] for i in range(3)))


def sample(key: Array, params: Params, frames: Frames) -> Array:
    """Draw a reading (4,) wxyz."""
    dtype = frames.quaternion.dtype
    e = bingham.sample(key, bingham.standard(jnp.asarray(params.lam, dtype)), (1,))[0]
    return jnp.stack(c.multiply(c.split(e), _predicted(params, frames)))
