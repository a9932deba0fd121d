"""How likely a series of joint angles is for given noise, torques and motion integrated out: what noise is tuned by.

The robot is linearised along the most probable path, once; what is left is linear and normal, and its likelihood exact
and smooth in the noise. It is the samplers' collapsed density without the variances' prior.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.kinematics.robot import Robot
from jaxest.mcmc import twist
from jaxest.mcmc.model import Data, Linear, Model, Prior, Unknown
from jaxest.systems.torque_model import Inputs, check_robot, require_float64
from jaxest.systems.torque_sampler import first_path
from jaxest.systems.torque_step import check_series
from jaxest.types import Array, Reading


class Noise(NamedTuple):
    """Standard deviations, those of the process a step."""

    position_noise: Array
    """(n,) rad"""
    velocity_noise: Array
    """(n,) rad/s"""
    torque_noise: Array
    """(n,) N m by which a torque that walks does; (0,) where it is constant."""
    sensor_noise: Array
    """(n,) rad"""

    @property
    def variances(self) -> Array:
        """Variances, as the samplers have them: process noise first."""
        return jnp.concatenate([jnp.asarray(x).reshape(-1) ** 2 for x in self])


class Linearized(NamedTuple):
    """A series with the model linearised along its most probable path, leaves (T, ...); see `mcmc.model.Linear`."""

    joints: Reading
    """(n,) rad"""
    path: Array
    jacobian: Array
    offset: Array
    """About torques of 0."""
    design: Array
    dt: Array
    """() s"""


def noise_of(model: Model, variances: Array) -> Noise:
    """Return the standard deviations whose squares are variances (n + m,) in the samplers' order."""
    blocks = np.split(np.sqrt(np.asarray(variances, float)), len(variances) // len(model.observed))
    return Noise(*(jnp.asarray(x) for x in (*blocks[:2], blocks[2] if len(blocks) > 3 else np.zeros(0), blocks[-1])))


def linearized(model: Model, robot: Robot, prior: Prior, data: Data) -> Linearized:
    """Find the most probable path of a series, and linearise there.

    Args:
        model: of `torque_model`.
        robot: its parameters.
        prior: the prior; its variances' modes are the noise that the path is sought with.
        data: the series.

    Returns:
        What `log_evidence` takes.

    Raises:
        InputError: a robot without inertia, or steps too long for explicit Euler.
        ValueError: JAX computes in float32.
    """
    require_float64()
    check_robot(robot)
    first = Unknown(jnp.clip(jnp.zeros(model.linear), prior.low, prior.high), prior.beta / (prior.alpha + 1))
    found = twist.fit_path(model, robot, prior, data, first, jnp.asarray(first_path(data, prior, model)))
    check_series(model, robot, data, found)
    inputs: Inputs = data.inputs
    dt = jnp.concatenate([jnp.zeros(1, inputs.dt.dtype), inputs.dt])
    offset = found.offset - jnp.einsum("tip,p->ti", found.design, found.centre)
    return Linearized(Reading(data.value, data.valid), found.path, found.jacobian, offset, found.design, dt)


def log_evidence(model: Model, prior: Prior, noise: Noise, series: Linearized) -> Array:
    """Return log p(angles | noise) (), constant torques integrated out too.

    Args:
        model: of `torque_model`.
        prior: of the first state; torques are flat, whatever its box.
        noise: standard deviations.
        series: as `linearized` gives it; readings that are missing say nothing, nor do steps behind the last.

    Returns:
        The log-density, differentiable in the noise.

    Source: Zakeri 2023, eq. 10, whose path integral is in closed form here; Rauch, Tung, Striebel 1965.
    """
    linear = Linear(series.path, jnp.zeros(model.linear), series.jacobian, series.offset, series.design)
    data = Data(series.joints.value, series.joints.valid, None)
    return twist.collapse(prior, linear, twist.backward(model, prior, data, linear, noise.variances)).log_evidence


__all__ = ["Linearized", "Noise", "linearized", "log_evidence", "noise_of"]
