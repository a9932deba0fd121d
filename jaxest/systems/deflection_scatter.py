"""Whether sensors scatter as much as the deflection filter was told they do: the bands rest on it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.kinematics import Robot
from jaxest.sensors import Sensor
from jaxest.systems import _deflection_body as bodies
from jaxest.systems.deflection import Params, sagged
from jaxest.types import Array, PyTree

MANY = 1024
"""Steps at once: a long log of a large robot would not fit into memory otherwise."""


class Scatter(NamedTuple):
    """What is left of each of s sensors' readings once the estimate is taken off."""

    ratio: NDArray[np.float64]
    """(s,) its root mean square over the one that the sensor's noise lets expect: 1 where that is right."""
    spare: NDArray[np.float64]
    """(s,) how many readings' worth the estimate does not simply follow; of few, no ratio can be told."""
    readings: NDArray[np.float64]
    """(s,) how many numbers were read."""


def scatter(
    robot: Robot,
    sensors: Sequence[Sensor],
    params: Params,
    mean: PyTree,
    covariance: Array,
    measurements: Any,
    *,
    joints: Sequence[str] | None = None,
    others: Sequence[str] = (),
    sag: bool = False,
) -> Scatter:
    """Compare what sensors read with an estimate, given the noise that the filter took them to have.

    Residuals r in units of the noise leave m - tr(J P J') of their m squares to be expected beside an estimate of
    covariance P, so that a sensor which the estimate follows, having no other, is not taken for a good one.

    Args:
        robot: the robot, as `joints`, `others`, `sag` and the sensors were given to `deflection.build`.
        sensors: the sensors.
        params: the filter's.
        mean: its states, leaves (T, ...).
        covariance: (T, d, d), its own.
        measurements: with a leading time axis.
        joints: as for `build`.
        others: as for `build`.
        sag: as for `build`.

    Returns:
        A row for each sensor, in their order. The first step, which hears a prior, counts as all others.

    Raises:
        InputError: a joint, frame or kind does not exist.
    """
    body = bodies.body(robot, sensors, joints, others)

    def step(x: PyTree, covariance: Array, measurement: Any) -> tuple[Array, Array, Array]:
        seen = sagged(body, params, measurement) if sag else measurement
        value, slope = bodies.rows(body, params, x, seen)
        there = jnp.any(slope != 0, axis=1)  # what is missing or said nothing of has no slope
        followed = jnp.einsum("ij,jk,ik->i", slope, covariance.astype(slope.dtype), slope)
        return jnp.where(there, value * value, 0), jnp.where(there, 1 - followed, 0), there

    every = jax.jit(lambda *given: jax.lax.map(lambda one: step(*one), given, batch_size=MANY))
    squares, spare, there = (np.asarray(x, np.float64).sum(axis=0) for x in every(mean, covariance, measurements))
    first = jax.tree.map(lambda x: x[0], (mean, measurements))
    owner = np.repeat(np.arange(len(body.looks)), _sizes(body, params, *first))
    squares, spare, there = (np.bincount(owner, x, len(body.looks)).astype(float) for x in (squares, spare, there))
    with np.errstate(divide="ignore", invalid="ignore"):
        return Scatter(np.sqrt(np.where(spare > 0, squares / spare, np.nan)), spare, there)


def _sizes(body: bodies.Body, params: Params, x: PyTree, measurement: Any) -> list[int]:
    """How many residuals each sensor has."""
    views = bodies.views(body, x, measurement)
    return [
        look.kind.residual(getattr(params.sensors, look.name), getattr(measurement, look.name), view).shape[0]
        for look, view in zip(body.looks, views, strict=True)
    ]


__all__ = ["Scatter", "scatter"]
