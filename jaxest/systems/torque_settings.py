"""Data sets of Zakeri 2023: Baxter's left arm under the paper's torques in three settings, and steps too long.

The paper leaves the motion open. `reachable`, the default, lets a known torque swing the arm within its limits; in
`paper` and `mild` the arm falls freely, the last joint faster than any real one.
"""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics import inverse_dynamics
from jaxest.kinematics.robot import Robot
from jaxest.mcmc.model import Data, Prior
from jaxest.systems.torque import Params, Truth, data_of, default_params, paper_prior, simulate
from jaxest.systems.torque_model import Inputs
from jaxest.systems.torque_step import check_step
from jaxest.types import Array, unknown_name

TORQUE = np.array([0.7, 0.6, 1.8, 1.0, 0.6, 0.25, 0.085])
"""N m, Zakeri 2023, tables 1 and 2."""
VARIANCE = 2e-7
SAFE = 0.01  # s; these settings are known to be stable over 1 s, and are not looked at again
FALLING = np.array([0, 1.047, 0, 0.5, 0, 0.02, 0])
SWINGING = np.array([0, -0.55, 0, 0.75, 0, 1.26, 0])
_AMPLITUDES = np.array([0.4, 0.3, 0.5, 0.4, 0.6, 0.5, 0.6])
_RATES = np.linspace(0.25, 0.55, 7)  # Hz


class Setting(NamedTuple):
    """How a data set is made."""

    dt: float
    """s"""
    steps: int
    """T"""
    start: np.ndarray
    """(7,) rad"""
    swings: bool
    """Whether a known torque swings the arm."""


SETTINGS = {
    "reachable": Setting(0.01, 100, SWINGING, True),
    "paper": Setting(0.01, 100, FALLING, False),
    "mild": Setting(0.005, 100, FALLING, False),
}


class Scene(NamedTuple):
    """A data set."""

    data: Data
    prior: Prior
    truth: Truth


def named(name: str) -> Setting:
    """Return a setting; raises InputError for a name that there is not."""
    if name not in SETTINGS:
        raise unknown_name("setting", name, SETTINGS)
    return SETTINGS[name]


def scene(robot: Robot, setting: Setting, *, key: Array, missing: float = 0.0) -> Scene:
    """Draw a data set.

    Args:
        robot: Baxter's left arm, or another arm of seven joints.
        setting: how.
        key: random key.
        missing: share of the readings that are missing.

    Returns:
        Series, prior and truth.

    Raises:
        InputError: steps so long that the motion blows up; names the largest that are not.
    """
    start = jnp.asarray(setting.start)
    known = feedforward(robot, setting) if setting.swings else jnp.zeros((setting.steps, 7))
    if setting.dt > SAFE:
        x = jnp.concatenate([start, jnp.zeros(7), jnp.asarray(TORQUE)])
        check_step(robot, x, setting.dt, setting.dt * setting.steps, known)
    given = default_params(robot)._replace(mean=jnp.concatenate([start, jnp.zeros(7), jnp.asarray(TORQUE)]))
    measured, truth = simulate(given, key=key, steps=setting.steps, dt=setting.dt, feedforward=known, missing=missing)
    return Scene(data_of(measured), paper_prior(start, 7, variance=VARIANCE), truth)


def blank(setting: Setting) -> tuple[Prior, Data]:
    """Return the prior and a series of the right shapes, all zero, for programs that are compiled before the data."""
    steps = setting.steps
    given = Inputs(jnp.zeros(steps - 1), jnp.zeros((steps - 1, 7)), jnp.zeros(steps - 1, jnp.int32))
    data = Data(jnp.zeros((steps, 7)), jnp.ones((steps, 7), bool), given)
    return paper_prior(jnp.asarray(setting.start), 7, variance=VARIANCE), data


def feedforward(robot: Robot, setting: Setting) -> Array:
    """Return the torques (T, 7) that swing the arm around its start, less the unknown ones; row k ends at k."""
    time = jnp.arange(setting.steps) * setting.dt
    rates = 2 * math.pi * jnp.asarray(_RATES)
    # 1 - cos starts at rest, where the prior has the arm.
    turn = rates[None] * time[:, None]
    size = jnp.asarray(_AMPLITUDES)[None] / 2
    q = jnp.asarray(setting.start)[None] + size * (1 - jnp.cos(turn))
    v, a = size * rates[None] * jnp.sin(turn), size * rates[None] ** 2 * jnp.cos(turn)
    wanted = jax.vmap(partial(inverse_dynamics, robot))(q, v, a) - jnp.asarray(TORQUE)[None]
    return jnp.concatenate([wanted[:1], wanted[:-1]])


__all__ = ["FALLING", "SETTINGS", "SWINGING", "TORQUE", "VARIANCE", "Params", "Scene", "Setting", "blank", "check_step",
           "feedforward", "named", "scene"]  # fmt: skip
