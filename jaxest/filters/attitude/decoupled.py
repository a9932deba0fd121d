"""Orientation of one IMU with inclination, heading and gyro bias estimated apart: light, and robust by construction.

The gyroscope is integrated to a frame that hardly turns. There the specific force is low-pass filtered over seconds:
what moves to and fro averages out, whichever way the sensor is turned meanwhile, and what is left points up. Feedback
on raw samples, as in `complementary`, averages in the sensor's frame or trusts single samples instead. From the
rotation that this correction still has to make, second by second, follows the gyro bias about the horizontal axes; at
rest the rates themselves are the bias. The magnetometer turns nothing but the heading.

Source: Laidig, Seel 2023 (VQF), sections 3.1 to 3.6, written anew: the low-pass is exact for varying steps, and the
heading comes from the field itself, tracked as a vector by a small Kalman filter whose readings lose weight as they
depart from it in norm, dip or heading, instead of thresholds on norm and dip.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxest.filters._state import finite
from jaxest.filters.attitude import lowpass as low
from jaxest.filters.attitude import rest as resting
from jaxest.filters.attitude.decoupled_state import Info, Params, State, init
from jaxest.filters.attitude.field import heading_slope, mahalanobis, trust
from jaxest.filters.attitude.vectors import length, levelled, northward
from jaxest.filters.imu import Imu, Sample, direction, usable
from jaxest.manifolds import quaternion as quat
from jaxest.types import OUT_OF_RANGE, Array


def step(params: Params, state: State, measurement: Imu, *, key: Array | None = None) -> tuple[State, Info]:
    """Take in one sample.

    Args:
        params: time constants and noise.
        state: as `init` or the previous step returned it; its dtype is that of the computation.
        measurement: one sample; the accelerometer in m/s^2 (its norm matters to rest detection only), the magnetometer
            in any unit.
        key: not used.

    Returns:
        The next state and the info. What is masked or not finite adds exactly nothing.

    Raises:
        ValueError: a sensor's value is not (3,), or `valid` or `dt` is not a scalar.
    """
    dtype = state.bias.dtype
    params = jax.tree.map(lambda x: jnp.asarray(x, dtype), params)
    sample = usable(measurement, dtype)
    moved, drift = _turned(params, state, sample)
    moved = _levelled(params, moved, sample)
    moved, weight = _headed(params, moved, sample, drift)
    moved = moved._replace(
        stillness=resting.watch(params.rest, state.stillness, sample),
        index=state.index + 1,
        initialized=state.initialized | sample.accelerometer.valid,
    )
    fits = finite((moved, weight))
    moved = jax.tree.map(lambda after, before: jnp.where(fits, after, before), moved, state._replace(index=moved.index))
    status = jnp.where(fits, sample.status, OUT_OF_RANGE)
    info = _info(params, moved, jnp.where(fits, weight, 0), status, seen=measurement.magnetometer is not None)
    return moved, info


def _turned(params: Any, state: State, sample: Sample) -> tuple[State, Array]:
    """Integrate the rate; also return the variance of the turn about any axis."""
    gyro, dt = sample.gyroscope, sample.dt
    rate = jnp.where(gyro.valid, gyro.value - state.bias, 0)
    covered = jnp.where(gyro.valid, jnp.minimum(dt, params.hold), 0)
    blind = dt - covered
    wrong = 2 * params.turn_time * params.misalignment**2 * jnp.sum(rate * rate) * covered
    drift = wrong + params.unseen_rotation**2 * blind
    lost = (blind > params.hold) & state.initialized
    averages = state.averages._replace(time=jnp.where(lost, 0, state.averages.time))
    spread = jnp.asarray(params.initial_bias) ** 2
    keep = jnp.exp(-dt * params.bias_walk**2 / spread)  # the walk never leads beyond the initial spread
    walk = jnp.eye(3, dtype=dt.dtype) * spread * (1 - keep)
    moved = state._replace(
        gyration=quat.retract(state.gyration, rate * covered),
        averages=averages,
        bias_covariance=jnp.where(state.initialized, keep * state.bias_covariance + walk, state.bias_covariance),
        tilt_variance=jnp.where(state.initialized, state.tilt_variance + drift, 0),
        acc_age=state.acc_age + dt,
        mag_age=state.mag_age + dt,
    )
    return moved, drift


def _levelled(params: Any, state: State, sample: Sample) -> State:
    """Correct the inclination by the low-passed specific force, and the bias by that correction or by rest."""
    acc, age = sample.accelerometer, state.acc_age
    first = acc.valid & ~state.initialized
    gyration = jnp.where(state.initialized, state.gyration, quat.identity(age.dtype))
    upright = jnp.where(first, levelled(acc.value), state.upright)
    matrix = quat.to_matrix(quat.compose(upright, gyration))
    channels = [quat.rotate(gyration, acc.value), matrix.reshape(-1), jnp.sum(matrix * state.bias[None, :], axis=1)]
    averages = low.lowpass(state.averages, jnp.concatenate(channels), age, params.tau)
    up = direction(quat.rotate(upright, averages.value[:3]))
    correction = levelled(up)
    corrected = quat.normalize(quat.compose(correction, upright))
    settled = averages.time > params.tau
    safe = jnp.where(age > 0, age, 1)
    rate = jnp.where(settled & (age > 0), 2 * correction[1:3] / safe, 0)
    mean, turned = averages.value[3:12].reshape(3, 3), averages.value[12:15]
    rest = state.stillness.time >= params.rest.time
    moving = acc.valid & settled & ~rest
    # A correction of rate c says: mean(R) bias = mean(R estimate) - c, about the horizontal axes.
    target = jnp.concatenate([turned[:2] - rate, jnp.zeros(1, age.dtype)])
    rows = jnp.where(rest, jnp.eye(3, dtype=age.dtype), mean)
    target = jnp.where(rest, state.stillness.rate, target)
    sigma = jnp.where(rest, params.bias_rest, params.bias_motion)
    noise = sigma**4 / (params.bias_walk**2 * jnp.where(rest, jnp.where(sample.dt > 0, sample.dt, 1), safe))
    flags = jnp.stack([moving, moving, jnp.zeros((), bool)]) | (rest & sample.gyroscope.valid & (sample.dt > 0))
    bias, spread = _update(state.bias, state.bias_covariance, rows, target, noise, flags, params.rest.rate)
    fade = jnp.exp(-2 * age / params.tau)
    there = acc.valid & (state.initialized | first)
    return state._replace(
        gyration=gyration,
        upright=jnp.where(acc.valid, corrected, upright),
        averages=jax.tree.map(lambda a, b: jnp.where(acc.valid, a, b), averages, state.averages),
        bias=jnp.where(state.initialized, bias, state.bias),
        bias_covariance=jnp.where(state.initialized, spread, state.bias_covariance),
        tilt_variance=jnp.where(there, fade * state.tilt_variance, state.tilt_variance),
        acc_age=jnp.where(acc.valid, 0, age),
    )


def _headed(params: Any, state: State, sample: Sample, drift: Array) -> tuple[State, Array]:
    """Track the field in the upright frame."""
    mag, dtype = sample.magnetometer, sample.dt.dtype
    ready = state.initialized | sample.accelerometer.valid
    first = mag.valid & ready & ~state.heading_initialized
    unit = jnp.where(first, jnp.where(first, length(mag.value), 1), state.unit)
    seen = quat.rotate(quat.compose(state.upright, state.gyration), mag.value / unit)
    x, y, _ = state.field
    across = jnp.stack([-y, x, jnp.zeros_like(x)])
    vertical = quat.rotate(quat.inverse(quat.compose(state.upright, state.gyration)), jnp.array([0, 0, 1], dtype))
    unsure = jnp.sum(vertical * jnp.sum(state.bias_covariance * vertical[None, :], axis=1))
    # A bias that stays for `tau` turns the heading by a walk of this variance.
    turned = drift + 2 * params.tau * unsure * sample.dt
    lost = state.doubt > params.rejection_time
    walk = (params.field_walk**2 + jnp.where(lost, params.field**2, 0)) * sample.dt
    eye = jnp.eye(3, dtype=dtype)
    spread = state.field_covariance + turned * across[:, None] * across[None, :] + walk * eye
    room = params.field**2
    weight = trust(params.tail, mahalanobis(seen - state.field, spread + room * eye), 3)
    age = jnp.where(state.mag_age > 0, state.mag_age, 1)
    use = mag.valid & state.heading_initialized & (state.mag_age > 0)
    noise = room * (1 + 2 * params.field_time / age) / weight
    field, after = _update(state.field, spread, eye, seen, noise, jnp.broadcast_to(use, 3), jnp.asarray(jnp.inf))
    moved = state._replace(
        field=jnp.where(first, seen, field),
        field_covariance=jnp.where(first, room * eye, jnp.where(state.heading_initialized, after, 0)),
        mag_age=jnp.where(mag.valid, 0, state.mag_age),
        doubt=jnp.where(use, jnp.where(weight < 0.5, state.doubt + age, 0), state.doubt),
        unit=unit,
        heading_initialized=state.heading_initialized | first,
    )
    return moved, jnp.where(use | first, jnp.where(first, 1, weight), 0)


def _info(params: Any, state: State, weight: Array, status: Array, *, seen: bool) -> Info:
    dtype = state.bias.dtype
    six = quat.normalize(quat.compose(state.upright, state.gyration))
    nine = quat.normalize(quat.compose(northward(state.field), six))
    quaternion = jnp.where(state.heading_initialized, nine, six)
    turn = heading_slope(state.field)
    heading = jnp.sum(turn * jnp.sum(state.field_covariance * turn[None, :], axis=1))
    heading = jnp.where(state.heading_initialized, heading, jnp.pi**2 / 3 if seen else 0)
    # Movements of standard deviation x leave an acceleration of x times the squared cutoff, 2 / tau^2.
    swing = 2 * params.excursion / (params.gravity * params.tau**2)
    lag = params.tau**2 * jnp.trace(state.bias_covariance) / 3
    tilt = swing**2 + lag + state.tilt_variance
    earth = jnp.stack([tilt, tilt, heading])
    matrix = quat.to_matrix(quaternion)
    covariance = jnp.sum(matrix[:, :, None] * matrix[:, None, :] * earth[:, None, None], axis=0)
    unknown = jnp.eye(3, dtype=dtype) * (jnp.pi**2 / 3)
    valid = state.initialized & state.heading_initialized if seen else state.initialized
    rest = state.stillness.time >= params.rest.time
    covariance = jnp.where(state.initialized, covariance, unknown)
    return Info(quaternion, six, state.bias, weight, rest, valid, status, covariance)


def _update(
    mean: Array, covariance: Array, rows: Array, target: Array, noise: Array, flags: Array, clip: Array
) -> tuple[Array, Array]:
    """Kalman update of three numbers by three equations `rows mean = target` of independent noise, one by one.

    In a loop, since XLA on CPU computes what unrolled equations share again and again.
    """

    def one(carry: tuple[Array, Array], equation: tuple[Array, Array, Array]) -> tuple[tuple[Array, Array], None]:
        (mean, covariance), (row, value, use) = carry, equation
        across = jnp.sum(covariance * row[None, :], axis=1)
        gain = jnp.where(use, across / (jnp.sum(across * row) + noise), 0)
        shrink = jnp.eye(3, dtype=mean.dtype) - gain[:, None] * row[None, :]
        half = jnp.sum(shrink[:, :, None] * covariance[None, :, :], axis=1)
        after = jnp.sum(half[:, None, :] * shrink[None, :, :], axis=2) + noise * gain[:, None] * gain[None, :]
        return (mean + gain * jnp.clip(value - jnp.sum(row * mean), -clip, clip), after), None

    (mean, covariance), _ = jax.lax.scan(one, (mean, covariance), (rows, target, flags))
    return mean, (covariance + covariance.T) / 2


__all__ = ["Info", "Params", "State", "init", "step"]
