"""Simulated measurements of `posture` and `posture_pairs`: a random motion of the robot, and what its IMUs read."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters.imu import Imu
from jaxest.kinematics import Robot, expand
from jaxest.simulate import imu as imus_on
from jaxest.simulate import trajectories
from jaxest.types import Array, PyTree


class Truth(NamedTuple):
    """What simulated measurements come from."""

    q: Array
    """(T, nq)"""
    quaternion: Array
    """(T, n, 4) wxyz, IMU to earth"""


def simulate(
    robot: Robot,
    names: tuple[str, ...],
    magnetic: bool,
    params: PyTree,
    *,
    key: Array,
    steps: int = 1000,
    rate_hz: float = 100.0,
    sensor: Any = None,
    fastest: float = 0.5,
) -> tuple[Imu, Truth]:
    """Draw a random motion within the joints' limits and what the IMUs read; `build` binds the leading arguments.

    Args:
        robot: the robot.
        names: frames with an IMU.
        magnetic: whether there are magnetometers.
        params: mountings, and the dtype.
        key: key of the whole draw.
        steps: number of samples T, static.
        rate_hz: samples per second.
        sensor: a `jaxest.simulate.imu.Sensor`, or None for its default.
        fastest: Hz, of the joints' motion.

    Returns:
        Measurements with a leading axis of T, all valid, and the truth.
    """
    dtype = jnp.result_type(*(x for x in jax.tree.leaves(params)))
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    first, second = jax.random.split(key)
    drawn = trajectories.random_motion(first, robot, fastest=fastest)
    free = np.array(robot.topology.free)

    def motion(time: Array) -> Array:
        return expand(robot, trajectories.configuration(drawn, time)[free])

    stacked, found = imus_on.record_all(
        robot, motion, names, key=second, duration=steps / rate_hz, rate_hz=rate_hz, sensor=sensor,
        mounting=jnp.asarray(params.mounting),
    )  # fmt: skip
    q = jax.vmap(motion)(found.time)
    cast = jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, stacked)
    there = cast if magnetic else cast._replace(magnetometer=None)
    return there, Truth(q.astype(dtype), found.truth.quaternion.astype(dtype))


__all__ = ["Truth", "simulate"]
