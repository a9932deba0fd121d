"""Smooth motions of a robot's joints as sums of sines, with exact derivatives."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import Robot
from jaxest.kinematics.robot import NQ
from jaxest.types import Array, ArrayLike


class Motion(NamedTuple):
    """Each coordinate a sum of k sines about a centre."""

    centre: Array
    """(nq,) rad or m."""
    amplitude: Array
    """(nq, k) rad or m; 0 for coordinates that stay."""
    frequency: Array
    """(nq, k) Hz."""
    phase: Array
    """(nq, k) rad."""


def random_motion(
    key: Array, robot: Robot, *, waves: int = 3, slowest: float = 0.05, fastest: float = 0.5, reach: float = 0.6
) -> Motion:
    """Draw a motion that stays within the joints' limits.

    Hinges and slides move; ball and free joints and coupled coordinates stay at home. A hinge without limits swings by
    up to `reach` times half a turn to either side, a slide without limits by up to `reach` times 0.1 m.

    Args:
        key: random key.
        robot: the robot.
        waves: number of sines per coordinate, static.
        slowest: Hz, lower end of the frequencies, drawn uniformly in their logarithm.
        fastest: Hz, upper end.
        reach: share of the way from the centre to the limits that is used, 0 to 1.

    Returns:
        The motion, in JAX's default precision.

    Raises:
        ValueError: the frequencies or the reach are out of range.
    """
    if not 0 < slowest <= fastest:
        raise ValueError(f"slowest, fastest: {slowest}, {fastest}, expected 0 < slowest <= fastest")
    if not 0 <= reach <= 1:
        raise ValueError(f"reach: {reach}, expected 0 to 1")
    centre, span = _spans(robot)
    strength, pitch, offset = jax.random.split(key, 3)
    shape = (robot.nq, waves)
    share = jax.random.uniform(strength, shape, minval=0.3, maxval=1.0)
    share = share / share.sum(axis=1, keepdims=True)
    frequency = jnp.exp(jax.random.uniform(pitch, shape, minval=np.log(slowest), maxval=np.log(fastest)))
    phase = jax.random.uniform(offset, shape, maxval=2 * np.pi)
    return Motion(jnp.asarray(centre), reach * share * jnp.asarray(span)[:, None], frequency, phase)


def _spans(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle of each coordinate's range and half its width; 0 for those that stay."""
    topology = robot.topology
    dtype = np.dtype(jnp.result_type(float))
    centre, span = np.array(robot.home, dtype), np.zeros(robot.nq, dtype)
    for kind, at in zip(topology.joint_kind, topology.joint_q, strict=True):
        if NQ[kind] > 1 or at not in topology.free:
            continue
        low, high = np.asarray(robot.limits[at])
        if np.isfinite(low) and np.isfinite(high):
            centre[at], span[at] = (low + high) / 2, (high - low) / 2
        else:
            span[at] = np.pi if kind == "hinge" else 0.1
    return centre, span


def configuration(motion: Motion, time: ArrayLike) -> Array:
    """Return the joint coordinates at a time.

    Args:
        motion: the motion.
        time: () s.

    Returns:
        q, (nq,), smooth in time: take rates and accelerations with `jax.jvp`.
    """
    angle = 2 * np.pi * motion.frequency * time + motion.phase
    return motion.centre + jnp.sum(motion.amplitude * jnp.sin(angle), axis=1)


__all__ = ["Motion", "configuration", "random_motion"]
