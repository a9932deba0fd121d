"""Unknown joint torques of a robot whose angles are measured: online, smoothed, and what the samplers need.

`build` gives an extended Kalman filter on (q, v, torque) for live use; `smooth` gives the most probable motion and,
with it, the marginal likelihood of noise and robot. Full posteriors come from `jaxest.mcmc` through `data_of` and
`paper_prior`; `jaxest.systems.torque_sampler` puts both together.

Source: Zakeri 2023 (see `torque_model` for its equations).
"""

from collections.abc import Sequence
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters import kalman
from jaxest.kinematics import forward_dynamics
from jaxest.kinematics.robot import Robot
from jaxest.manifolds import Euclidean
from jaxest.systems.torque_data import Measurement, check_prior, data_of, paper_prior
from jaxest.systems.torque_model import check_robot, require_float64
from jaxest.types import Array, PyTree, Reading, System, unknown_name

SENSORS = ("joints",)


class Params(NamedTuple):
    """Parameters of the filter; the paper's figures by default. Every noise is a variance."""

    robot: Robot
    position: Array
    """(n,) rad2 a step"""
    velocity: Array
    """(n,) (rad/s)2 a step"""
    torque: Array
    """(n,) (N m)2 a step, by which the unknown torque walks; 0 where it is constant."""
    sensor: Array
    """(n,) rad2"""
    mean: Array
    """(3 n,) start: q, v and torque."""
    variance: Array
    """(3 n,) of the start."""


class Truth(NamedTuple):
    """What simulated measurements come from."""

    angles: Array
    """(T, n) rad"""
    velocity: Array
    """(T, n) rad/s"""
    torque: Array
    """(T, n) N m, the unknown one, over the step that ends at each time."""


def build(robot: Robot, sensors: Sequence[str] = SENSORS, *, passive: bool = False) -> System:
    """Build the live estimator: an extended Kalman filter of angles, velocities and torques.

    Args:
        robot: hinges and slides, with inertia.
        sensors: `joints`; there is no other.
        passive: whether the robot's damping, springs and friction act; static.

    Returns:
        The system; its measurement is a `Measurement`, its estimates are (q, v, torque).

    Raises:
        InputError: a sensor of another name, or a robot with other joints or without inertia.
        ValueError: JAX computes in float32.
    """
    require_float64()
    check_robot(robot)
    for name in sensors:
        if name not in SENSORS:
            raise unknown_name("sensor", name, SENSORS)
    model = kalman_model(robot.nv, passive)
    return System(default_params(robot), _init, _filter(model), partial(simulate, passive=passive))


def default_params(robot: Robot) -> Params:
    """Return the paper's noise, a start at rest in the home posture, and torques anywhere within 50 N m."""
    n = robot.nv
    small = jnp.full(n, 2e-7)
    mean = jnp.concatenate([jnp.asarray(robot.home, float), jnp.zeros(2 * n)])
    variance = jnp.concatenate([jnp.full(2 * n, 2e-7), jnp.full(n, 2500.0)])
    return Params(robot, small, small, 0 * small, small, mean, variance)


def _init(params: Params, *, key: Array | None = None) -> kalman.State:
    del key
    return kalman.init(params.mean, jnp.diag(params.variance))


@cache
def _filter(model: kalman.Model) -> PyTree:
    return kalman.filter_step(model)


@cache
def kalman_model(joints: int, passive: bool = False) -> kalman.Model:
    """Make the robot a `filters.kalman.Model` of (q, v, torque); the same object for the same arguments.

    Args:
        joints: number of joints n.
        passive: as in `build`.

    Returns:
        The model; parameters are a `Params`, measurements `Measurement`s.
    """

    def dynamics(params: Params, x: Array, measurement: Measurement) -> Array:
        return euler(params.robot, x, measurement.feedforward, measurement.dt, passive)

    def noise(params: Params, x: Array, measurement: Measurement) -> Array:
        del x
        variances = jnp.concatenate([params.position, params.velocity, params.torque])
        return jnp.diag(jnp.where(measurement.dt > 0, variances, 0))

    def angles(params: Params, x: Array, measurement: Measurement) -> Array:
        del params, measurement
        return x[:joints]

    def spread(params: Params, measurement: Measurement) -> Array:
        del measurement
        return params.sensor

    sensor = kalman.sensor("joints", angles, spread)
    return kalman.Model(Euclidean((3 * joints,)), dynamics, noise, (sensor,))


def euler(robot: Robot, x: Array, feedforward: Array, dt: Array, passive: bool = False) -> Array:
    """Take one explicit Euler step of (q, v, torque) without noise.

    Source: Zakeri 2023, eqs. 12 and 13.
    """
    n = robot.nv
    q, v, tau = x[:n], x[n : 2 * n], x[2 * n :]
    a = forward_dynamics(robot, q, v, tau + feedforward, passive)
    return jnp.concatenate([q + dt * v, v + dt * a, tau])


def smooth(params: Params, measurements: Measurement, *, passive: bool = False, iterations: int = 10) -> kalman.History:
    """Return the most probable motion and torque, and Laplace's approximation of the marginal likelihood.

    Args:
        params: parameters; the sum of the history's `log_likelihood` may be differentiated by them.
        measurements: leaves (T, ...).
        passive: as in `build`.
        iterations: linearisations of the path at most; static.

    Returns:
        The history of `filters.kalman.smooth`.

    Raises:
        ValueError: JAX computes in float32.
    """
    require_float64()
    model = kalman_model(params.robot.nv, passive)
    return kalman.smooth(model, params, _init(params), measurements, iterations=iterations)


@partial(jax.jit, static_argnames=("steps", "passive"))
def simulate(
    params: Params,
    *,
    key: Array,
    steps: int = 100,
    dt: float = 0.01,
    torque: Array | None = None,
    feedforward: Array | None = None,
    missing: float = 0.0,
    passive: bool = False,
) -> tuple[Measurement, Truth]:
    """Draw a motion under unknown torques, with the model's own noise.

    Args:
        params: parameters. The torque starts at its mean, not drawn, and walks as `params.torque` says.
        key: key of the whole draw.
        steps: number of measurements T, static; the first belongs to the start.
        dt: s, between measurements.
        torque: (T, n) N m, in place of the walk: row k acts over the step that ends at k.
        feedforward: (T, n) N m, known; zero if None.
        missing: share of the readings that are missing.
        passive: as in `build`; static.

    Returns:
        Measurements and truth, leaves (T, ...).
    """
    n = params.robot.nv
    keys = jax.random.split(key, 4)
    given = jnp.zeros((steps, n)) if feedforward is None else jnp.asarray(feedforward)
    start = params.mean[: 2 * n] + jnp.sqrt(params.variance[: 2 * n]) * jax.random.normal(keys[0], (2 * n,))
    noise = jax.random.normal(keys[1], (steps * 3 * n,)).reshape(steps, 3 * n)
    scale = jnp.sqrt(jnp.concatenate([params.position, params.velocity, params.torque]))
    wanted = jnp.zeros((steps, n)) if torque is None else jnp.asarray(torque)

    def advance(x: Array, now: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        tau, ahead, noise = now
        x = x if torque is None else jnp.concatenate([x[: 2 * n], tau])
        x = euler(params.robot, x, ahead, jnp.asarray(dt), passive) + scale * noise
        return x, jnp.concatenate([x[: 2 * n], tau if torque is not None else x[2 * n :]])

    x0 = jnp.concatenate([start, params.mean[2 * n :] if torque is None else wanted[0]])
    xs = jnp.concatenate([x0[None], jax.lax.scan(advance, x0, (wanted[1:], given[1:], noise[1:]))[1]])
    error = jnp.sqrt(params.sensor)[None] * jax.random.normal(keys[2], (steps * n,)).reshape(steps, n)
    valid = jax.random.uniform(keys[3], (steps * n,)).reshape(steps, n) >= missing
    value = jnp.where(valid, xs[:, :n] + error, 0)
    times = jnp.where(jnp.arange(steps) > 0, dt, 0.0)
    measured = Measurement(Reading(value, valid), given, times)
    return measured, Truth(xs[:, :n], xs[:, n : 2 * n], xs[:, 2 * n :])


__all__ = ["SENSORS", "Measurement", "Params", "Truth", "build", "check_prior", "data_of", "default_params", "euler",
           "kalman_model", "paper_prior", "simulate", "smooth"]  # fmt: skip
