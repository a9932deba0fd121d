"""The passive complementary filter against a loop on matrices, closed forms and static oracles."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.ref_complementary import complementary as reference
from scipy.spatial.transform import Rotation

from jaxest.filters import complementary, run
from jaxest.filters.attitude import madgwick
from jaxest.filters.complementary import Imu, Params, exponential, init, projection, step
from jaxest.types import NON_FINITE, OK, Reading

UP = np.array([0.0, 0.0, 9.81])
FIELD = np.array([0.0, 20.0, -40.0])  # microtesla, ENU, dipping to the north
projected = partial(step, update=projection)


def rotations(quaternion):
    return Rotation.from_quat(np.asarray(quaternion, float), scalar_first=True)


def angle_deg(quaternion, rotation):
    return np.degrees((rotations(quaternion).inv() * rotation).magnitude())


def resting(rotation, steps, rate=(0.0, 0.0, 0.0), dt=0.01, dtype=np.float32):
    """What an IMU at rest reads, sensor to earth `rotation`, with a gyro that reads `rate`."""
    rows = [np.tile(v, (steps, 1)).astype(dtype) for v in (rate, rotation.inv().apply(UP), rotation.inv().apply(FIELD))]
    return complementary.imu(*rows, dt=dtype(dt))


@pytest.fixture(scope="module")
def shaken():
    """A wild minute-long recording with irregular steps and gaps, in float64."""
    random = np.random.default_rng(7)
    steps = 400
    gyr, acc, mag = random.normal(size=(3, steps, 3))
    acc, mag = acc + np.array([3, 2, 5]), 20 * mag + np.array([10, -40, 5])
    dt = random.uniform(0.001, 0.1, steps)
    masks = random.random((steps, 3)) > 0.2
    masks[:3] = [[True, False, False], [True, False, True], [False, True, False]]
    return gyr, acc, mag, dt, masks


def measured(shaken, nine, dtype):
    gyr, acc, mag, dt, masks = shaken
    readings = [
        Reading(np.where(mask[:, None], value, np.nan).astype(dtype), mask)
        for value, mask in zip((gyr, acc, mag), masks.T, strict=True)
    ]
    return Imu(*readings[:2], readings[2] if nine else None, dt.astype(dtype))


@pytest.mark.parametrize("nine", [False, True])
@pytest.mark.parametrize("update", [exponential, projection])
def test_against_the_loop_on_matrices(shaken, nine, update, dtype):
    gains = 0.74, 0.05, 1.0, 0.7
    expected, biases, errors = reference(
        *shaken[:2], shaken[2] if nine else None, shaken[3], gains, shaken[4], projection=update is projection
    )
    params = Params(*(np.asarray(x, dtype) for x in gains))
    chosen = step if update is exponential else projected
    state, info = run(chosen, params, init(params), measured(shaken, nine, dtype))
    tolerance = 1e-12 if dtype == "float64" else 3e-5
    np.testing.assert_allclose(rotations(info.quaternion).as_matrix(), expected, atol=tolerance)
    np.testing.assert_allclose(info.bias, biases, atol=tolerance)
    np.testing.assert_allclose(info.error_acc, errors[:, 0], atol=tolerance)
    np.testing.assert_allclose(info.error_mag, errors[:, 1], atol=tolerance)
    np.testing.assert_array_equal(info.status, OK)
    first = np.argmax(shaken[4][:, 1])  # of the accelerometer; a magnetometer sample before it sets nothing
    headed = first + np.argmax(shaken[4][first:, 2]) if nine else first
    np.testing.assert_array_equal(info.valid, np.arange(len(expected)) >= headed)
    assert int(state.index) == len(expected)


def test_the_first_samples_set_the_orientation(dtype):
    """Also upside down and for fields that point the wrong way; +1 g up is what a resting accelerometer reads."""
    special = Rotation.from_quat(np.vstack([np.eye(4), np.eye(4)[0] + np.eye(4)[1:]]), scalar_first=True)
    truth = Rotation.concatenate([Rotation.random(200, rng=np.random.default_rng(1)), special])
    acc, mag = (truth.inv().apply(v).astype(dtype) for v in (UP, FIELD))
    sample = complementary.imu(np.zeros_like(acc), acc, mag, dt=np.zeros(len(acc), dtype))
    params = Params(*(np.asarray(x, dtype) for x in Params()))
    first = jax.jit(jax.vmap(lambda m: step(params, init(params), m)[1]))
    tolerance = 1e-10 if dtype == "float64" else 1e-4
    assert np.max(angle_deg(first(sample).quaternion, truth)) < tolerance
    up = Rotation.from_quat(np.asarray(first(sample._replace(magnetometer=None)).quaternion), scalar_first=True).apply(
        acc
    )
    np.testing.assert_allclose(up, np.tile(UP, (len(acc), 1)), atol=10 * tolerance)


def test_a_wrong_start_converges_to_the_truth_from_every_side():
    """At rest, in 10 s, from errors up to 150 degrees."""
    truth = Rotation.random(30, rng=np.random.default_rng(2))
    axes = np.random.default_rng(3).normal(size=(30, 3))
    axes *= np.linspace(0.1, 2.6, 30)[:, None] / np.linalg.norm(axes, axis=1)[:, None]
    off = truth * Rotation.from_rotvec(axes)
    params = Params(np.float32(20.0), np.float32(0.0), np.float32(1.0), np.float32(1.0))
    yes = np.ones(30, bool)
    start = jax.vmap(lambda q, yes: init(params)._replace(quaternion=q, initialized=yes, heading_initialized=yes))(
        off.as_quat(scalar_first=True).astype(np.float32), yes
    )
    rest = jax.tree.map(lambda *x: np.stack(x), *(resting(r, 1000) for r in truth))
    state, _ = jax.vmap(partial(run, step, params))(start, rest)
    assert np.max(angle_deg(off.as_quat(scalar_first=True), truth)) > 90
    assert np.max(angle_deg(state.quaternion, truth)) < 0.05


def test_small_errors_fall_off_with_the_gains(x64):
    """Level and heading north, a small error obeys phi' = -K_p (1 - z z' + u u') phi, u normal to the field."""
    params, start, steps = Params(0.74, 0.0, 1.0, 1.0), np.array([2e-6, -1e-6, 3e-6]), 500
    yes = np.bool_(True)
    off = Rotation.from_rotvec(start).as_quat(scalar_first=True)
    state0 = init(params)._replace(quaternion=jnp.asarray(off), initialized=yes, heading_initialized=yes)
    state, _ = run(step, params, state0, resting(Rotation.identity(), steps, dtype=np.float64))
    normal = np.array([0, -FIELD[2], FIELD[1]]) / np.linalg.norm(FIELD)
    pull = np.diag([1.0, 1.0, 0.0]) + np.outer(normal, normal)
    left = np.linalg.matrix_power(np.eye(3) - 0.74 * 0.01 * pull, steps) @ start
    np.testing.assert_allclose(2 * np.asarray(state.quaternion)[1:], left, rtol=1e-4)


def test_a_magnet_turns_the_heading_and_not_the_up_axis():
    """The reference field is the measured one, so a wrong field does not tilt a level sensor with the right heading."""
    m = resting(Rotation.identity(), 3000)
    strong = np.tile(np.float32([0, 60, 80]), (3000, 1))
    state, _ = run(step, Params(), init(Params()), m._replace(magnetometer=Reading(strong, np.ones(3000, bool))))
    np.testing.assert_allclose(np.asarray(state.quaternion), [1, 0, 0, 0], atol=1e-6)


def test_constant_rate_is_exact_however_long_the_steps(x64):
    """With the gains at zero the exponential turns exactly; the projection by atan(w dt)."""
    rate = np.array([0.5, -1.2, 0.8])
    still = Params(0.0, 0.0, 1.0, 1.0)
    random = np.random.default_rng(4)
    dt = np.concatenate([[0.3], random.uniform(0.001, 0.9, 50)])
    size = np.linalg.norm(rate)
    for chosen, angle in ((step, size * dt[1:]), (projected, np.arctan(size * dt[1:]))):
        m = resting(Rotation.identity(), len(dt), rate, dtype=np.float64)._replace(dt=dt)
        state, _ = run(chosen, still, init(still), m)
        expected = Rotation.from_rotvec(rate / size * angle.sum())
        assert angle_deg(state.quaternion, expected) < 1e-10


def test_the_projection_agrees_with_the_exponential_to_second_order(x64):
    def apart(dt):
        q, rate = jnp.array([1.0, 0, 0, 0]), jnp.array([1.0, -2.0, 0.5])
        return float(jnp.linalg.norm(exponential(q, rate, dt) - projection(q, rate, dt)))

    np.testing.assert_allclose(apart(1e-2) / apart(1e-3), 1000, rtol=1e-2)  # one order more in a single step


def test_the_bias_is_found():
    """The integrator integrates with dt: with K_p^2 = 4 K_i the bias settles as a double pole at K_p / 2."""
    bias = np.array([0.02, -0.03, 0.01])
    params = Params(np.float32(4.0), np.float32(4.0), np.float32(1.0), np.float32(5.0))
    truth = Rotation.from_rotvec([0.5, 0.4, -1.0])
    ends = [run(step, params, init(params), resting(truth, int(40 / dt), bias, dt))[0] for dt in (0.01, 0.02)]
    for state in ends:
        np.testing.assert_allclose(state.bias, bias, atol=2e-5)
        assert angle_deg(state.quaternion, truth) < 0.01


def test_halving_the_step_changes_little():
    """K_i with dt and not 1/dt: the same second in 100 or in 200 samples ends the same."""
    truth, params = Rotation.from_rotvec([0.3, -0.2, 0.1]), Params(0.74, 0.3, 1.0, 1.0)
    ends = [
        run(step, params, init(params), resting(truth, n, (0.1, 0.0, -0.1), 1.0 / n))[0].bias for n in (100, 200, 400)
    ]
    np.testing.assert_allclose(ends[0], ends[2], rtol=0.02)
    np.testing.assert_allclose(ends[1], ends[2], rtol=0.01)


def test_a_masked_magnetometer_is_no_magnetometer(shaken):
    with_it = measured(shaken, True, "float32")
    hidden = with_it._replace(magnetometer=with_it.magnetometer._replace(valid=np.zeros(400, bool)))
    a = run(step, Params(), init(Params()), hidden)[1]
    b = run(step, Params(), init(Params()), measured(shaken, False, "float32"))[1]
    np.testing.assert_allclose(a.quaternion, b.quaternion, atol=1e-6)
    assert not np.any(a.valid)
    assert np.all(b.valid[10:])


def test_bad_time_steps_and_free_fall_change_nothing():
    params = Params()
    m = resting(Rotation.identity(), 5, (0.3, 0.2, 0.1))
    falling = m._replace(
        dt=np.float32([0.01, np.nan, np.inf, -0.01, 0.01]),
        accelerometer=Reading(np.float32([[1, 2, 9], [0, 0, 9], [0, 0, 9], [0, 0, 9], [0, 0, 0]]), np.ones(5, bool)),
        magnetometer=Reading(np.float32([[10, 20, -30], [1, 2, 3], [1, 2, 3], [1, 2, 3], [0, 0, 0]]), np.ones(5, bool)),
    )
    _, info = run(step, params, init(params), falling)
    assert np.asarray(info.status).tolist() == [OK, NON_FINITE, NON_FINITE, NON_FINITE, OK]
    np.testing.assert_allclose(info.quaternion[1:4], np.asarray(info.quaternion)[[0, 0, 0]], atol=1e-7)
    assert not np.any(np.asarray([info.error_acc[1:], info.error_mag[1:]]))
    assert np.all(np.isfinite(info.quaternion))


def test_a_turn_that_overflows_is_left_out_and_said():
    """Its exponential is no number, which must neither stay in the state nor be taken for no rotation."""
    m = resting(Rotation.from_rotvec([0.5, 0.2, 0.1]), 3)
    wild = m._replace(
        gyroscope=m.gyroscope._replace(value=np.float32([[0, 0, 0], [1e16, 0, 0], [0, 0, 0]])),
        dt=np.float32([0.01, 1e4, 0.01]),
    )
    for module, still in ((complementary, Params(0.0, 0.0)), (madgwick, madgwick.Params(0.0))):
        _, info = run(module.step, still, module.init(still), wild)
        assert np.asarray(info.status).tolist() == [OK, NON_FINITE, OK]
        np.testing.assert_allclose(info.quaternion, np.asarray(info.quaternion)[[0, 0, 0]], atol=1e-6)


def test_wrong_shapes_are_named():
    m = jax.tree.map(lambda x: x[0], resting(Rotation.identity(), 1))
    state = init(Params())
    for field, wrong, message in (
        (
            "gyroscope",
            Reading(np.zeros(4), np.bool_(True)),
            r"measurement.gyroscope: got shape \(4,\), expected \(3,\)",
        ),
        ("accelerometer", Reading(np.zeros(3), np.ones(3, bool)), r"measurement.accelerometer.valid: got shape \(3,\)"),
        ("dt", np.zeros(2), r"measurement.dt: got shape \(2,\), expected \(\)"),
    ):
        with pytest.raises(ValueError, match=message):
            step(Params(), state, m._replace(**{field: wrong}))


def test_imu_bundles_arrays():
    bundled = complementary.imu(np.zeros((5, 3)), np.ones((5, 3)), dt=0.01)
    assert bundled.magnetometer is None
    assert bundled.dt.shape == bundled.gyroscope.valid.shape == (5,)
    assert np.all(bundled.accelerometer.valid)
