"""A series of joint angles as the samplers of torques take it, and the priors of what is unknown."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.mcmc.model import Data, Prior
from jaxest.stamps import GAP
from jaxest.systems.torque_model import Inputs
from jaxest.types import Array, InputError, Reading


class Measurement(NamedTuple):
    """What is known of one time."""

    joints: Reading
    """(n,) rad, each joint with its own mask."""
    feedforward: Array
    """(n,) N m, known torque over the step that ends here."""
    dt: Array
    """() s since the measurement before; 0 for one that belongs to the start."""


def data_of(measurements: Measurement, segments: int = 1) -> Data:
    """Bring measurements into the form of the samplers.

    Args:
        measurements: leaves (T, ...); missing readings and NaN are integrated over.
        segments: into how many equal pieces the series is cut, each with its own constant torque.

    Returns:
        The series.

    Raises:
        InputError: times that do not rise, or a step of the series much longer than the others.
    """
    dt = np.asarray(measurements.dt)[1:]
    if not (dt > 0).all():
        at = int(np.flatnonzero(~(dt > 0))[0]) + 1
        raise InputError(f"measurements: dt is {dt[at - 1]:g} s at row {at}, expected times that rise")
    most = GAP * float(np.median(dt)) if len(dt) else 0.0
    if (dt > most).any():
        at = int(np.argmax(dt)) + 1
        raise InputError(f"measurements: dt is {dt[at - 1]:g} s at row {at}, expected at most {most:g} s, {GAP} median "
                         "steps; put rows without valid readings into gaps")  # fmt: skip
    value, valid = jnp.asarray(measurements.joints.value), jnp.asarray(measurements.joints.valid)
    good = jnp.broadcast_to(valid, value.shape) & jnp.isfinite(value)
    steps = len(dt)
    segment = jnp.minimum(jnp.arange(steps) * segments // steps, segments - 1).astype(jnp.int32)
    given = Inputs(jnp.asarray(dt), jnp.asarray(measurements.feedforward)[1:], segment)
    return Data(jnp.where(good, value, 0), good, given)


def paper_prior(
    start: Array, joints: int, *, low: Array | float = 0.0, high: Array | float | None = None, segments: int = 1,
    variance: float = 2e-7,
) -> Prior:  # fmt: skip
    """Return the paper's priors: uniform torques, an inverse-gamma density with mode and scale of `variance`.

    Args:
        start: (n,) rad, where the robot starts, at rest.
        joints: number of joints n.
        low: (n,) or () N m, lower bound of the torques.
        high: (n,) or () N m, upper bound; the paper's 50 and 15 (the last three joints of seven) if None.
        segments: as in `data_of`.
        variance: about what each variance is; the inverse-gamma density is (3, 4 times that), as the oracle has it.

    Returns:
        The prior of `torque_model.constant`.

    Source: Zakeri 2023, eqs. 19 to 24.
    """
    if high is None:
        high = jnp.asarray([50.0] * 4 + [15.0] * 3) if joints == 7 else 50.0
    low, high = (jnp.tile(jnp.broadcast_to(jnp.asarray(x, float), (joints,)), segments) for x in (low, high))
    mean = jnp.concatenate([jnp.asarray(start, float), jnp.zeros(joints)])
    count = 3 * joints
    return Prior(low, high, jnp.full(count, 3.0), jnp.full(count, 4 * variance), mean, jnp.full(2 * joints, variance))


def check_prior(prior: Prior, data: Data, theta: Array | None = None) -> None:
    """Raise InputError where a prior cannot be that of the data.

    Args:
        prior: the prior.
        data: the series.
        theta: (p,) torques to start from, or None.

    Raises:
        InputError: an empty box, torques outside it, or a first measurement more than 8 standard deviations off.
    """
    low, high = np.asarray(prior.low), np.asarray(prior.high)
    for i in np.flatnonzero(~(low < high)):
        raise InputError(f"prior: torque {i} lies between {low[i]:g} and {high[i]:g} N m, expected low < high")
    for i in np.flatnonzero(() if theta is None else (np.asarray(theta) < low) | (np.asarray(theta) > high)):
        raise InputError(f"torque {i}: {np.asarray(theta)[i]:g} N m lies outside the prior, {low[i]:g} to {high[i]:g}")
    m = data.value.shape[1]
    usual = np.asarray(prior.beta / np.maximum(prior.alpha - 1, 0.5))[-m:]
    sd = np.sqrt(np.asarray(prior.variance)[:m] + usual)
    away = np.abs(np.asarray(data.value[0]) - np.asarray(prior.mean)[:m])
    for i in np.flatnonzero(np.asarray(data.valid[0]) & (away > 8 * sd)):
        raise InputError(
            f"prior of the start: joint {i} is measured {away[i]:.3g} rad from its mean, {away[i] / sd[i]:.0f} "
            "standard deviations; expected a prior that covers the start"
        )


__all__ = ["Measurement", "check_prior", "data_of", "paper_prior"]
