"""Errors on the group for `supervised`: of one step, or of a whole recording whose heading is free."""

from typing import Any

import jax.numpy as jnp

from jaxest.manifolds import circle
from jaxest.manifolds import quaternion as quat
from jaxest.metrics import orientation_error
from jaxest.tuning.objectives import rms
from jaxest.types import Array


def inclination(info: Any, truth: Array) -> Array:
    """Return the angle () rad by which an orientation is inclined wrongly; needs no common heading.

    Args:
        info: with a `quaternion` (4,) wxyz, sensor to earth.
        truth: (4,) wxyz.

    Source: Laidig et al. 2021 (BROAD).
    """
    return orientation_error(info.quaternion, truth).inclination


def orientation(info: Any, truth: Array) -> Array:
    """Return the angle () rad of the whole error rotation; arguments as `inclination`."""
    return orientation_error(info.quaternion, truth).total


def heading(info: Any, truth: Array) -> Array:
    """Return the angle () rad of the error about the vertical; arguments as `inclination`."""
    return orientation_error(info.quaternion, truth).heading


def error_rotation(info: Any, truth: Array) -> Array:
    """Return the error rotation (4,) wxyz in the earth frame, for `free_heading`; arguments as `inclination`."""
    return quat.compose(info.quaternion, quat.inverse(truth))


def free_heading(rotations: Array, counts: Array) -> Array:
    """Return the root mean square () rad of error rotations' angles, once the best common heading is taken off.

    What a sensor without magnetometer can be judged by: its heading counts from where it began.

    Args:
        rotations: (T, 4) wxyz in the earth frame, as `error_rotation` gives them.
        counts: (T,) bool.

    Returns:
        The error; the common heading is the one that leaves the largest sum of squared cosines of half the angles, in
        closed form.
    """
    w, z = (jnp.where(counts, rotations[:, i], 0) for i in (0, 3))
    # Turned by -2 h about the vertical, w becomes w cos h + z sin h; the sum of its squares is largest here.
    some = jnp.any(counts)
    half = jnp.arctan2(2 * jnp.sum(w * z), jnp.where(some, jnp.sum(w * w - z * z), 1)) / 2
    c, s = jnp.cos(half), jnp.sin(half)
    a, b, d, e = (rotations[:, i] for i in range(4))
    turned = jnp.stack([c * a + s * e, c * b + s * d, c * d - s * b, c * e - s * a], axis=1)
    still = jnp.zeros_like(turned).at[:, 0].set(1)
    return rms(orientation_error(turned, still).total, counts)


def joints(info: Any, truth: Array) -> Array:
    """Return the root mean square () rad of differences of joint angles on the circle.

    Args:
        info: with a `mean` (d,) rad.
        truth: (d,) rad.
    """
    return rms(circle.wrap(info.mean - truth), jnp.ones(truth.shape, bool))


__all__ = ["error_rotation", "free_heading", "heading", "inclination", "joints", "orientation"]
