"""The posture of a robot that bends, from any mix of sensors: a particle filter over effective joint angles.

Links bend and joints give; the angles at which a rigid robot would stand as the real one does are estimated from
encoders, IMUs, markers and the like. Table I of the paper is the default.

States are angles (d,) rad where all joints are hinges, else `jaxest.kinematics.space.Joints`: hinges, slides, balls.
Tangent vectors (d,), and so covariances and what `Params` has for each coordinate, take them in that order.

Source: Sato 2023.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters import particle
from jaxest.filters.resampling import Resampler, stratified
from jaxest.kinematics import Robot, gravity_torque
from jaxest.kinematics.robot import BALL, HINGE, SLIDE
from jaxest.kinematics.space import Space, space_of, unflat
from jaxest.manifolds.base import Manifold
from jaxest.sensors import Sensor, default_params, measurement_type
from jaxest.systems import _deflection_body as bodies
from jaxest.systems import _deflection_walk as walks
from jaxest.systems._deflection_body import Body
from jaxest.systems._deflection_simulation import simulate
from jaxest.systems._deflection_walk import first, gaussian, guessing, opening, von_mises
from jaxest.types import Array, ArrayLike, InputError, PyTree, Reading, System

SENSORS = (Sensor("joint_angle", "joints"),)
"""The reference angles alone."""

Choice = Callable[[Manifold, particle.Transition, Any, Any], particle.Proposal]
"""`(manifold, transition, log_likelihood, rows) -> proposal`."""


class Params(NamedTuple):
    """What may be tuned."""

    sensors: PyTree = None
    """Each sensor's `Params`, by its name."""
    walk: ArrayLike = 5.0
    """() or (d,) concentration of a step's noise, 1/rad^2 where it is large, 1/m^2 for slides (`build` has 2500:
    0.02 m). Hinges' noise of the default is drawn fastest."""
    prior: ArrayLike = 0.1
    """() or (d,) concentration of the angles before the first measurement; slides' and balls' must not be 0
    (`build` has 1: 1 m, 1 rad)."""
    start: ArrayLike = 0.0
    """() or (d,) rad, their mean; m for slides, a rotation vector for balls."""
    compliance: ArrayLike = 0.0
    """() or (d,) rad/(N m), how far joints give under gravity, m/N for slides; only looked at with `sag`."""


class Estimate(NamedTuple):
    """An info with the interval of each joint."""

    info: particle.Info
    lower: Array
    """(d,) rad or m, lower end, from the mean in the tangent space there."""
    upper: Array
    """(d,) upper end."""


def bootstrap(manifold: Manifold, transition: particle.Transition, log_likelihood: Any, rows: Any) -> Any:
    """Send particles where the random walk takes them, as the paper does."""
    return particle.bootstrap(manifold, transition, log_likelihood)


def guided(
    manifold: Manifold,
    transition: particle.Transition,
    log_likelihood: Any,
    rows: Any,
    *,
    iterations: int = 2,
    defensive: float = 0.0,
    curved: bool | None = None,
) -> Any:
    """Send particles where the sensors that are present say, with exact weights; see `particle.guided`."""
    return particle.guided(
        manifold, transition, log_likelihood, rows, iterations=iterations, defensive=defensive, curved=curved
    )


def build(
    robot: Robot,
    sensors: Sequence[Sensor] = SENSORS,
    *,
    joints: Sequence[str] | None = None,
    others: Sequence[str] = (),
    particles: int = 2048,
    proposal: Choice = bootstrap,
    resample: Resampler = stratified,
    noise: Callable[[Space], particle.Transition] = von_mises,
    sag: bool = False,
    ancestors: bool = False,
    filtering: Callable[..., Any] | None = None,
) -> System:
    """Build the filter of one robot's effective joint angles.

    Build it once: a system's functions are its own, and `run` compiles once for them.

    Args:
        robot: the robot; its numbers are folded into the compiled step.
        sensors: the sensors, with their parameters where they differ from the defaults.
        joints: names of the hinges, slides and balls to estimate; every hinge that no other joint leads and that is
            not among `others` if None.
        others: names of joints that are not estimated, whose coordinates come with the measurement. All other joints
            stand at `robot.home`.
        particles: number N.
        proposal: `bootstrap`, `guided` or `partial(guided, iterations=1)`. Guided wants far fewer particles (256).
        resample: at every step by default; see `jaxest.filters.resampling`.
        noise: `von_mises` or `gaussian`.
        sag: whether joint angles are expected to give under gravity by `compliance` times the holding torque at the
            angles read. A reading that is not valid counts as `home` in that torque.
        ancestors: whether infos carry them.
        filtering: `(manifold, transition, log_likelihood) -> step` in place of proposal and resampling, such as
            `jaxest.tuning.relaxed`, which wants `gaussian` noise.

    Returns:
        The system. A measurement is `jaxest.sensors.measurement_type(sensors, others=...)`: a `Reading` per sensor
        under its name, `others` (n,) where there are any, and `dt`. Its infos are `particle.Info` with the mean, a
        state (angles on the circle, balls among rotations), and the covariance (d, d) in the tangent space there;
        `history=with_interval` of `run` adds 95 % intervals.

    Raises:
        InputError: a joint, frame or kind does not exist (the closest names are given), a joint is free or coupled, or
            gravity is asked of a robot without masses.
        ValueError: there are no particles.

    Source: Sato 2023, section III-D; Table I.
    """
    if particles < 1:
        raise ValueError(f"particles: got {particles}, expected at least 1")
    body = bodies.body(robot, sensors, joints, others)
    if sag and robot.topology.massless:
        raise InputError(f"sag: bodies without mass: {', '.join(robot.topology.massless)}")
    where, read = body.space, partial(bodies.read, body)
    manifold, transition = where.manifold, guessing(where, noise(where), read)
    if noise is von_mises:
        transition = transition._replace(opening=opening(where, transition, read))
    propose = proposal(manifold, transition, partial(bodies.log_likelihood, body), partial(bodies.rows, body))
    step = particle.filter_step(particle.Model(manifold, propose, resample, ancestors))
    if filtering is not None:
        step = filtering(manifold, transition, partial(bodies.log_likelihood, body))
    return System(
        defaults(where, default_params(sensors)),
        partial(init, where, particles),
        partial(_sagging, body, step) if sag else step,
        partial(simulate, body, measurement_type(sensors, others=bool(body.others)), transition, sag),
    )


def defaults(where: Space, sensors: PyTree) -> Params:
    """Return Table I's parameters, with numbers of our own for slides and balls.

    Args:
        where: the joints.
        sensors: the sensors' parameters.
    """
    given = Params(sensors)
    if all(kind == HINGE for kind in where.kinds):
        return given
    walk, prior = {HINGE: given.walk, SLIDE: walks.SLIDE, BALL: walks.BALL}, {HINGE: given.prior}
    return given._replace(
        walk=np.array([walk[kind] for kind in where.kinds]),
        prior=np.array([prior.get(kind, walks.PRIOR) for kind in where.kinds]),
    )


def init(where: Space, particles: int, params: Params, *, key: Array | None = None) -> particle.State:
    """Draw particles from what is known before the first measurement.

    Args:
        where: the joints.
        particles: N.
        params: the parameters; `prior` and `start` are used.
        key: random key.

    Returns:
        The state.

    Raises:
        ValueError: there is no key.

    Source: Sato 2023, eq. 29.
    """
    if key is None:
        raise ValueError("key: got None, expected a key to draw the first particles with")
    return particle.init(first(where, params, jax.random.fold_in(key, 0x7FFFFFFF), particles))


def _sagging(
    body: Body, step: Any, params: Params, state: particle.State, measurement: Any, *, key: Array | None = None
) -> tuple[particle.State, particle.Info]:
    """Step with joint angles as they are expected to give."""
    return step(params, state, sagged(body, params, measurement), key=key)


def sagged(body: Body, params: Params, measurement: Any) -> Any:
    """Return the measurement with joint readings less what gravity bends the robot by."""
    for look in body.looks:
        if look.kind.FRAMES:
            continue
        reading = getattr(measurement, look.name)
        value = jnp.asarray(reading.value)
        valid = jnp.broadcast_to(jnp.asarray(reading.valid, bool), value.shape) & jnp.isfinite(value)
        x = jnp.asarray(body.robot.home[np.array(body.space.coordinates)], value.dtype)
        read = np.array(look.columns)  # of hinges and slides, which have as many coordinates as velocities
        x = x.at[read].set(jnp.where(valid, value, x[read]))
        bend = jnp.asarray(params.compliance, value.dtype) * holding_torque(body, unflat(body.space, x), measurement)
        measurement = measurement._replace(**{look.name: Reading(value - bend[read], reading.valid)})
    return measurement


def holding_torque(body: Body, x: PyTree, measurement: Any) -> Array:
    """Return the torques (d,) N m, or N for slides, that hold the estimated joints in the state x."""
    torque = gravity_torque(body.robot, bodies.posture(body, x, measurement))
    return torque[np.array(body.space.velocities)]


def interval(state: particle.State, probability: float = 0.95) -> particle.Interval:
    """Return the mean of each joint and the equal-tailed interval about it, by circular quantiles.

    Args:
        state: the filter's.
        probability: share inside.

    Returns:
        Centre, a state, and the ends (d,) rad or m in the tangent space there. O(N log N).
    """
    return particle.interval(space_of(state.particles), state.particles, state.log_weights, probability)


def with_interval(state: particle.State, info: particle.Info) -> Estimate:
    """Keep every info with its 95 % interval: a `history` for `jaxest.filters.run`."""
    manifold = space_of(state.particles)
    found = particle.interval(manifold, state.particles, state.log_weights, 0.95, info.mean)
    return Estimate(info, found.lower, found.upper)


__all__ = [
    "SENSORS",
    "Estimate",
    "Params",
    "bootstrap",
    "build",
    "gaussian",
    "guided",
    "interval",
    "simulate",
    "von_mises",
    "with_interval",
]
