"""Error-state Kalman filter of one IMU: orientation, gyro bias and scale, and the field that tells the heading.

An accelerometer does not measure the vertical. It measures the vertical plus the sensor's own acceleration, which is
as large when somebody moves; but what moves about in a room has speeds and excursions that stay small for ever. So the
filter integrates the specific force to horizontal velocity and position and is told, as a measurement, that both are
near zero (`speed`, `excursion`, with their correlation time). That is the optimal form of low-pass filtering the
specific force over seconds in a frame that the gyroscope keeps from turning (Laidig and Seel 2023): how slowly is a
matter of the gyroscope's noise and of how long the filter has run, not of a time constant. What the gyroscope gets
wrong during turns (its scale) becomes visible in the same way and is part of the state.

The heading comes from the field in the frame of the gyroscope's own heading: a vector that hardly moves, tracked by the
same filter. Readings farther from it than inhomogeneous rooms explain lose their weight, by norm, dip and heading at
once; if that lasts for `rejection_time`, a new field is learned.

Errors of orientation are written in the earth frame (right-invariant: `R_true = exp(theta) R`), where they stand still
while the sensor turns; the covariance given out is of the sensor frame, like everybody's. Readings are integrated as
they come; covariance and corrections follow every `interval`.
"""

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters import kalman
from jaxest.filters.attitude import rest as resting
from jaxest.filters.attitude.ekf_state import Info, Memory, Params, State, closed, init, opened
from jaxest.filters.attitude.field import heading_slope, mahalanobis, trust
from jaxest.filters.attitude.motion import MANIFOLD, Track, again, begin, carry, integrate
from jaxest.filters.attitude.vectors import length, levelled, northward
from jaxest.filters.imu import Imu, Sample, usable
from jaxest.manifolds import quaternion as quat
from jaxest.types import NOT_CONVERGED, OK, Array


def step(params: Params, state: State, measurement: Imu, *, key: Array | None = None) -> tuple[State, Info]:
    """Take in one sample.

    Args:
        params: noise.
        state: as `init` or the previous step returned it; its dtype is that of the computation.
        measurement: one sample; the accelerometer in m/s^2, the magnetometer in any unit.
        key: not used.

    Returns:
        The next state and the info. What is masked or not finite adds exactly nothing.

    Raises:
        ValueError: a sensor's value is not (3,), or `valid` or `dt` is not a scalar.
    """
    dtype = state.numbers.dtype
    params = jax.tree.map(lambda x: jnp.asarray(x, dtype), params)
    sample = usable(measurement, dtype)
    after = advance(params, state, sample)
    memory = opened(after)
    due = memory.initialized & (memory.since.time + sample.dt / 2 >= params.interval)  # to the nearest sample
    after = jax.lax.cond(due, correct, lambda params, state: state, params, after)
    after = after._replace(index=state.index + 1)
    memory, seen = opened(after), measurement.magnetometer is not None
    valid = memory.initialized & memory.heading_initialized if seen else memory.initialized
    info = describe(params, memory, (after.upper, after.lower), valid, seen=seen)
    return after, info._replace(status=jnp.maximum(sample.status, info.status))


def advance(params: Params, state: State, sample: Sample) -> State:
    """Integrate a sample, or let it set the orientation if it is the first of its kind."""
    before, acc, mag = opened(state), sample.accelerometer, sample.magnetometer
    unit = jnp.where(mag.valid & ~before.heading_initialized, jnp.where(mag.valid, length(mag.value), 1), before.unit)
    sample = sample._replace(magnetometer=mag._replace(value=mag.value / unit))
    moved, since = integrate(before.track, before.since, sample, params.hold)
    new = acc.valid & ~before.initialized
    initialized = before.initialized | acc.valid
    level = levelled(acc.value)
    start = before.track._replace(orientation=jnp.where(new, level, before.track.orientation))
    track = jax.tree.map(lambda a, b: jnp.where(before.initialized, a, b), moved, start)
    since = jax.tree.map(lambda a, b: jnp.where(before.initialized, a, b), since, begin(acc.value.dtype))
    field = initialized & mag.valid & ~before.heading_initialized
    seen = quat.rotate(track.orientation, sample.magnetometer.value)
    since = jax.tree.map(lambda a, b: jnp.where(field, a, b), since._replace(field=0 * seen, fields=0 * unit), since)
    memory = before._replace(
        track=track._replace(field=jnp.where(field, seen, track.field)),
        since=since,
        stillness=resting.watch(params.rest, before.stillness, sample),
        unit=jnp.where(field, unit, before.unit),
        initialized=initialized,
        heading_initialized=before.heading_initialized | field,
    )

    def widened() -> tuple[Array, Array]:
        known = jnp.diag(jnp.where(jnp.arange(16) < 13, 0, params.field**2))[8:]
        upper = jnp.where(new, state.upper + _first_spread(params, acc.value)[:8], state.upper)
        return upper, jnp.where(field, state.lower + known, state.lower)

    upper, lower = jax.lax.cond(new | field, widened, lambda: (state.upper, state.lower))
    return closed(memory, upper, lower, state.index)


def correct(params: Params, state: State) -> State:
    """Carry the covariance over the samples since the last correction, and correct."""
    memory = opened(state)
    belief = predicted(params, memory, state.covariance)
    factors, weights, doubt = news(params, memory, belief)
    belief, _ = kalman.update(MANIFOLD, belief, factors)
    memory = memory._replace(
        track=belief.mean,
        since=again(memory.since),
        doubt=doubt,
        weights=jnp.where(jnp.stack([jnp.bool_(True), memory.since.fields > 0]), weights, memory.weights),
        lost=~jnp.isfinite(jnp.sum(belief.covariance)),
    )
    return closed(memory, belief.covariance[:8], belief.covariance[8:], state.index)


def predicted(params: Params, memory: Memory, covariance: Array) -> kalman.Gaussian:
    """Return the belief before a correction."""
    transition, noise = carry(memory.track.scale, memory.since), process_noise(params, memory)
    before = kalman.Gaussian(memory.track, covariance)
    return kalman.predict(MANIFOLD, before, lambda x: x, jnp.diag(noise), jacobian=lambda x: transition)


def process_noise(params: Params, memory: Memory) -> Array:
    """Return the variances (16,) that the samples since the last correction add."""
    since, one = memory.since, jnp.ones(3, memory.unit.dtype)
    rotation = (
        params.gyroscope**2 * since.time
        + 2 * params.turn_time * params.misalignment**2 * since.stir
        + params.unseen_rotation**2 * since.blind
    )
    force = params.accelerometer**2 * since.time + params.unseen_force**2 * since.afloat
    lost = memory.doubt > params.rejection_time
    field = params.field_walk**2 + jnp.where(lost, params.field**2, 0)
    spread = [rotation * one, force * one[:2], 0 * one[:2], params.bias_walk**2 * since.time * one, 0 * one]
    return jnp.concatenate([*spread, jnp.where(memory.heading_initialized, field * since.time, 0) * one])


def news(params: Params, memory: Memory, belief: kalman.Gaussian) -> tuple[list[kalman.Factor], Array, Array]:
    """Return what is measured at a correction, its weights (2,), and for how long the field has been in doubt."""
    since, covariance, dtype = memory.since, belief.covariance, memory.unit.dtype
    nominal = belief.mean.orientation
    time = jnp.where(since.time > 0, since.time, 1)
    some = since.time > 0

    still = 1 + 2 * params.move_time / time
    usual = jnp.concatenate([jnp.full(2, params.speed**2, dtype), jnp.full(2, params.excursion**2, dtype)])
    swing = jnp.concatenate([belief.mean.velocity, belief.mean.position])
    root = linalg.cholesky(covariance[3:7, 3:7] + jnp.diag(usual))
    scaled = linalg.solve_triangular(root, swing)
    weight_acc = trust(params.tail, jnp.sum(scaled * scaled), 4)

    def motion(x: Track) -> Array:
        return -jnp.concatenate([x.velocity, x.position])

    field = since.field / jnp.where(since.fields > 0, since.fields, 1)
    x, y, z = field
    zero = jnp.zeros((), dtype)
    across = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    design = jnp.concatenate([across, jnp.zeros((3, 10), dtype), jnp.eye(3, dtype=dtype)], axis=1)
    room = params.field**2
    expected = _sandwich(design, covariance) + room * jnp.eye(3, dtype=dtype)
    weight_mag = trust(params.tail, mahalanobis(field - belief.mean.field, expected), 3)
    there = (since.fields > 0) & memory.heading_initialized
    doubt = jnp.where(weight_mag < 0.5, memory.doubt + since.time, 0)

    def magnetic(x: Track) -> Array:
        turn = quat.compose(x.orientation, quat.inverse(nominal))
        return quat.rotate(turn, field) - x.field

    rate = since.rate / jnp.where(since.rates > 0, since.rates, 1)
    sway = params.gyroscope**2 / time + params.rest_rate**2 * still
    at_rest = (memory.stillness.time >= params.rest.time) & (since.rates > 0) & some
    factors = [
        kalman.Factor(motion, usual * still / weight_acc, jnp.broadcast_to(some, 4)),
        kalman.Factor(
            magnetic,
            jnp.full(3, room * (1 + 2 * params.field_time / time) / weight_mag, dtype),
            jnp.broadcast_to(there & some, 3),
        ),
        kalman.Factor(lambda x: rate - x.bias, jnp.full(3, sway, dtype), jnp.broadcast_to(at_rest, 3)),
    ]
    return factors, jnp.stack([weight_acc, weight_mag]), jnp.where(there, doubt, memory.doubt)


def describe(params: Params, memory: Memory, covariance: tuple[Array, Array], valid: Array, *, seen: bool) -> Info:
    """Return the estimate in the earth frame with its covariance in the sensor frame.

    Args:
        params: noise.
        memory: the estimate.
        covariance: (8, 16) first and (8, 16) last rows of that of its errors.
        valid: () bool, goes into the info.
        seen: whether there is a magnetometer.

    Returns:
        The info.
    """
    track, dtype = memory.track, memory.unit.dtype
    north = northward(track.field)
    quaternion = quat.normalize(quat.compose(north, track.orientation))
    quaternion = jnp.where(memory.heading_initialized, quaternion, track.orientation)
    upper, lower = covariance
    # theta = R' (error of the orientation, plus the field's turn about the vertical)
    turn = jnp.where(memory.heading_initialized, heading_slope(track.field), 0)
    across = jnp.sum(upper[:3, 13:] * turn[None, :], axis=1)
    about = jnp.sum(jnp.sum(lower[5:, 13:] * turn[None, :], axis=1) * turn)
    free = jnp.where(seen & ~memory.heading_initialized, jnp.pi**2 / 3, 0)
    lasting = (params.accelerometer_bias / params.gravity) ** 2
    up = jnp.array([0, 0, 1], dtype)
    diagonal = jnp.stack([lasting, lasting, jnp.asarray(about + free, dtype)])
    earth = upper[:3, :3] + across[:, None] * up[None, :] + up[:, None] * across[None, :] + jnp.diag(diagonal)
    covariance_here = _sandwich(quat.to_matrix(track.orientation).T, earth)
    unknown = jnp.eye(3, dtype=dtype) * (jnp.pi**2 / 3)
    return Info(
        quaternion,
        track.bias,
        track.scale,
        memory.weights[0],
        memory.weights[1],
        memory.stillness.time >= params.rest.time,
        valid,
        jnp.where(memory.lost, NOT_CONVERGED, OK).astype(jnp.int32),
        jnp.where(memory.initialized, (covariance_here + covariance_here.T) / 2, unknown),
    )


def _first_spread(params: Params, force: Array) -> Array:
    """Covariance (16, 16) of what the first specific force says: the inclination, and that nothing is known to move."""
    norm = length(force)
    excess = (norm - params.gravity) / jnp.maximum(norm, params.gravity)
    tilt = params.initial_inclination**2 + excess * excess
    spread = [tilt, tilt, 0, *[params.speed**2] * 2, *[params.excursion**2] * 2, *[0] * 9]
    return jnp.diag(jnp.stack([jnp.asarray(s, force.dtype) for s in spread]))


def _sandwich(a: Array, p: Array) -> Array:
    half = jnp.sum(a[:, :, None] * p[None, :, :], axis=1)
    return jnp.sum(half[:, None, :] * a[None, :, :], axis=2)


__all__ = ["Info", "Params", "State", "init", "step"]
