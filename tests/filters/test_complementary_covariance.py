"""The covariance of the complementary filter: its linearisation, its consistency, what it says of unseen directions."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK

from jaxest.filters import complementary, complementary_covariance, last, run
from jaxest.filters.complementary_covariance import Noise, Params, init, with_covariance
from jaxest.manifolds import quaternion as quat
from jaxest.metrics import align_heading, nees, nees_bounds, orientation_difference
from jaxest.systems import orientation
from jaxest.types import Reading

SILENT = Noise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
step = with_covariance()


def sensed(quaternion, rate, dt, valid):
    """What a perfect IMU reads at the start of a step."""
    seen = [quat.rotate(quat.inverse(quaternion), jnp.asarray(v)) for v in ([0.0, 0.0, 9.81], [0.0, 18.0, -41.0])]
    readings = (Reading(value, there) for value, there in zip((rate, *seen), valid, strict=True))
    return complementary.Imu(*readings, jnp.asarray(dt))


def test_the_transition_is_the_derivative_of_the_step(x64):
    """With silent noise one step makes F F' of the unit covariance, and F is what the error really does."""
    gains = complementary.Params(2.0, 0.5, 1.1, 0.8)
    truth, bias = quat.exp(jnp.array([0.4, -0.9, 2.0])), jnp.array([0.1, -0.2, 0.05])
    dt, yes = 1e-4, jnp.asarray(True)

    def state(error):
        return complementary.State(quat.retract(truth, -error[:3]), bias - error[3:], jnp.asarray(5), yes, yes)

    def after(error, rate, measurement):
        moved = complementary.step(gains, state(error), measurement)[0]
        return jnp.concatenate([quat.local(moved.quaternion, quat.retract(truth, rate * dt)), bias - moved.bias])

    @partial(jax.jit, compiler_options=QUICK)
    @jax.vmap
    def both(valid):
        rate = jnp.where(valid[0], jnp.array([0.3, 0.5, -0.2]), 0)
        measurement = sensed(truth, rate + bias, dt, valid)
        slope = jax.jacfwd(after)(jnp.zeros(6), rate, measurement)
        start = complementary_covariance.State(state(jnp.zeros(6)), jnp.eye(6))
        moved, _ = step(Params(gains, SILENT._replace(unseen_rotation=0.0)), start, measurement)
        return moved.covariance, slope

    masks = np.array([[1, 1, 1], [1, 1, 0], [1, 0, 1], [0, 0, 1], [0, 0, 0]], bool)
    covariance, slope = map(np.asarray, both(masks))
    assert np.max(np.abs(slope - np.eye(6))) > dt
    expected = slope @ np.swapaxes(slope, 1, 2)
    np.testing.assert_allclose(covariance, expected, atol=5e-8)  # F is of order dt, what it neglects of dt^2


@pytest.mark.parametrize("nine", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_it_is_consistent_with_what_is_simulated(nine):
    """Mean NEES of attitude and bias over independent runs, within the chi-square interval (99.9 %).

    The turning is slow, because the algorithm compares a sample with the attitude one step earlier.
    """
    runs, steps, dt = 300, 300, 0.02
    density = {"accelerometer": 2e-3, "magnetometer": 2e-3}
    first = {"initial_inclination": 2e-3 / np.sqrt(dt), "initial_heading": 2e-3 / np.sqrt(dt) / np.cos(np.radians(66))}
    noise = Noise(gyroscope=2e-3, scale=0.0, bias_walk=1e-3, motion_time=1e-6, **density, **first)
    system = orientation.build(sensors=orientation.SENSORS[: 3 if nine else 2], covariance=True)
    params = Params(complementary.Params(4.0, 0.5, 1.0, 3.0), noise)

    def one(key):
        measurements, truth = system.simulate(params, key=key, steps=steps, rate_hz=1 / dt, colour=0.0, speed=0.05)
        state0 = system.init(params)
        state, quaternion = run(system.step, params, state0, measurements, history=lambda state, info: info.quaternion)
        return state, quaternion, truth

    batch = jax.jit(jax.vmap(one), compiler_options=QUICK)(jax.random.split(jax.random.key(0), runs))
    state, quaternion, truth = jax.tree.map(np.asarray, batch)
    true = truth.quaternion if nine else align_heading(quaternion, truth.quaternion)
    attitude = orientation_difference(quaternion, true)[:, -1]
    error = np.concatenate([attitude, truth.bias[:, -1] - state.filter.bias], axis=-1)
    values = nees(error.astype(np.float64), state.covariance.astype(np.float64))
    lower, upper = nees_bounds(6, runs, 0.999)
    assert lower < values.mean() < upper


def test_without_a_magnetometer_the_heading_grows_and_the_rest_settles(dtype):
    cast = partial(jax.tree.map, lambda x: jnp.asarray(x, dtype))
    params = cast(Params())
    rest = complementary.imu(np.zeros((6000, 3)), np.tile([0, 0, 9.81], (6000, 1)), dt=0.01)
    _, info = run(step, params, init(params), rest)
    variance = np.diagonal(np.asarray(info.covariance), axis1=1, axis2=2)
    assert variance.dtype == dtype
    assert variance[0, 2] == 0  # the earth frame's heading is the sensor's own at the first sample
    assert np.all(np.diff(variance[:, 2]) > 0)
    seconds, noise = 59.99, Noise()  # bias, walk of the bias and noise of the rate, integrated
    drift = (noise.initial_bias * seconds) ** 2 + noise.gyroscope**2 * seconds + noise.bias_walk**2 * seconds**3 / 3
    np.testing.assert_allclose(variance[-1, 2], drift, rtol=1e-3)
    np.testing.assert_allclose(variance[-1, :2], variance[3000, :2], rtol=0.1)  # the bias is still being learnt
    np.testing.assert_array_equal(info.covariance, np.swapaxes(info.covariance, 1, 2))


def test_before_the_sensors_have_spoken_nothing_is_known():
    nobody = np.zeros(4, bool)
    rows = [np.tile(np.float32(v), (4, 1)) for v in ([0, 0, 0], [0, 0, 9.81], [0, 20, -40])]
    m = complementary.imu(*rows, dt=np.float32(0.01))
    late = m._replace(
        accelerometer=Reading(rows[1], np.array([False, True, True, True])),
        magnetometer=Reading(rows[2], np.array([True, False, False, True])),
    )
    params = Params()
    variance = np.diagonal(run(step, params, init(params), late)[1].covariance, axis1=1, axis2=2)
    unknown, level, heading = np.pi**2 / 3, Noise().initial_inclination ** 2, Noise().initial_heading ** 2
    np.testing.assert_allclose(variance[0], unknown, rtol=1e-6)
    np.testing.assert_allclose(variance[1], [level, level, unknown], rtol=1e-6)
    assert variance[2, 2] >= np.float32(unknown)
    np.testing.assert_allclose(variance[3, 2], heading, rtol=1e-6)
    assert np.all(variance[3, :2] < level)
    blind = m._replace(accelerometer=Reading(rows[1], nobody), magnetometer=Reading(rows[2], nobody))
    variance = np.diagonal(run(step, params, init(params), blind)[1].covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(variance, unknown, rtol=1e-6)


def test_what_is_missing_or_shaken_makes_it_less_sure():
    """Same half minute, ended four ways; the estimate's own variance tells them apart."""
    steps = 500
    rows = [np.tile(np.float32(v), (steps, 1)) for v in ([0, 0, 0], [0, 0, 9.81], [0, 20, -40])]
    m = complementary.imu(*rows, dt=np.float32(0.01))
    late = np.arange(steps) < 400
    shaken = np.float32([0, 0, 9.81]) * np.where(late, 1, 1.5 - (np.arange(steps) % 2))[:, None].astype(np.float32)
    cases = {
        "calm": m,
        "no accelerometer": m._replace(accelerometer=Reading(rows[1], late)),
        "shaken": m._replace(accelerometer=Reading(shaken, np.ones(steps, bool))),
        "no gyroscope": m._replace(gyroscope=Reading(rows[0], late)),
    }
    params = Params()
    many = jax.tree.map(lambda *x: np.stack(x), *cases.values())
    covariance = jax.vmap(lambda m: run(step, params, init(params), m, history=last)[1].covariance)(many)
    calm, deaf, moved, still = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, 0])
    assert calm < deaf < still
    assert 2 * calm < moved


def test_the_estimate_is_that_of_the_filter_alone():
    params = Params()
    measurements, _ = orientation.build().simulate(params.filter, key=jax.random.key(4), steps=200)
    _, plain = run(complementary.step, params.filter, complementary.init(params.filter), measurements)
    _, carried = run(step, params, init(params), measurements)
    for name in plain._fields:
        np.testing.assert_allclose(getattr(carried, name), getattr(plain, name), atol=2e-6)
