"""Whole-body SLAM whose root an IMU drives: the integration, its covariance, and a roll that is lost without it."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK
from slam_models import robot, sensors, tiny

from jaxest.filters import run
from jaxest.filters._state import finite
from jaxest.filters.kalman import Gaussian
from jaxest.manifolds import quaternion, se3
from jaxest.mapping import Hashed
from jaxest.simulate import along
from jaxest.systems import slam_inertial
from jaxest.systems.slam_inertial import MANIFOLD, Driven, Track, advance
from jaxest.types import NON_FINITE, OK, OUT_OF_RANGE, InputError, Reading

GRAVITY = np.array([0, 0, -9.81])


def motion(time):
    """A root that swings and turns about all axes: positions and quaternions."""
    place = np.column_stack([0.3 * np.sin(2 * time), 0.2 * np.cos(3 * time), 0.1 * np.sin(time)])
    turned = np.column_stack([np.sin(2 * time), 0.8 * np.cos(time), 0.5 * np.sin(3 * time)])
    return place, np.asarray(jax.vmap(quaternion.exp)(turned))


def test_readings_lead_back_along_the_motion(x64):
    """Differentiated and integrated again at 1 kHz; the error of both is of second order."""
    worst = []
    for dt in (2e-3, 1e-3):
        place, turned = motion(dt * np.arange(round(1 / dt) + 1))
        samples = along.readings(place, turned, dt, GRAVITY)
        speed = (place[1] - place[0]) / dt - dt / 2 * (place[2] - 2 * place[1] + place[0]) / dt**2
        start = Track(se3.Pose(turned[0], place[0]), speed, np.zeros(3), np.zeros(3))

        def over(track, row, dt=dt):
            return advance(track, *row, jnp.asarray(GRAVITY), jnp.asarray(dt)), None

        end, _ = jax.lax.scan(over, jax.tree.map(jnp.asarray, start), tuple(jnp.asarray(x) for x in samples))
        np.testing.assert_allclose(quaternion.local(end.pose.rotation, turned[-1]), 0, atol=1e-9)
        worst.append(np.abs(end.pose.translation - place[-1]).max())
    assert worst[1] < 1e-4
    assert worst[1] < 0.4 * worst[0]


@pytest.mark.slow
def test_the_covariance_is_that_of_drawn_errors(x64):
    """4000 draws of the start's errors and of the noise: each variance within 6 standard errors, sqrt(2 / 4000)."""
    params = slam_inertial.Params(gyroscope=0.02, accelerometer=0.1, gyroscope_walk=0.05, accelerometer_walk=0.2)
    dt, count = 0.01, 10
    place, turned = motion(dt * np.arange(count + 1))
    samples = along.readings(place, turned, dt, GRAVITY)
    valid = np.ones(count, bool)
    none = Reading(np.zeros(0), np.zeros(0, bool))
    given = Driven(none, none, Reading(samples.gyroscope, valid), Reading(samples.accelerometer, valid),
                   np.full(count, dt), np.array(count * dt))  # fmt: skip
    deviations = np.repeat([0.01, 0.005, 0.1, 0.03, 0.2], 3)
    start = Track(se3.Pose(jnp.asarray(turned[0]), jnp.asarray(place[0])), jnp.ones(3), jnp.zeros(3), jnp.zeros(3))
    belief = Gaussian(start, jnp.diag(deviations**2))
    after, apart = slam_inertial.integrate(params, belief, given, jnp.asarray(GRAVITY))
    density = np.repeat([0.02, 0, 0.1, 0.05, 0.2], 3) * np.sqrt(dt)

    def draw(key):
        first, second = jax.random.split(key)
        track = MANIFOLD.retract(start, deviations * jax.random.normal(first, (15,)))

        def over(track, row):
            gyroscope, accelerometer, white = row
            moved = advance(track, gyroscope, accelerometer, jnp.asarray(GRAVITY), jnp.asarray(dt))
            return MANIFOLD.retract(moved, density * white), None

        rows = (samples.gyroscope, samples.accelerometer, jax.random.normal(second, (count, 15)))
        end, _ = jax.lax.scan(over, track, jax.tree.map(jnp.asarray, rows))
        return MANIFOLD.local(after.mean, end)

    errors = np.asarray(jax.jit(jax.vmap(draw))(jax.random.split(jax.random.key(0), 4000)))
    scale = np.sqrt(np.diag(after.covariance))
    found = errors.T @ errors / len(errors) / np.outer(scale, scale)
    np.testing.assert_allclose(found, after.covariance / np.outer(scale, scale), atol=6 * np.sqrt(2 / 4000))
    # How far it went in the interval is known better than where it is.
    assert np.linalg.eigvalsh(np.asarray(after.covariance)[:6, :6] - apart).min() > 0


@pytest.fixture(scope="module")
def system():
    return slam_inertial.build(
        robot(free=True), sensors(), "root", layout=Hashed(0.25, (32, 32, 16)), capacity=1500, points=72
    )


def rolled(system, rate):
    """Draw 20 steps of 0.1 s and their samples at 100 Hz; it begins to roll at 1 s."""
    options = {"steps": 201, "dt": 0.01, "odometry": False, "roll": rate, "bias": 0.0}
    draw = partial(system.simulate, system.default_params, **options)
    dense, truth = jax.jit(draw, compiler_options=QUICK)(key=jax.random.key(3))
    turned = np.asarray(jax.vmap(quaternion.from_matrix)(truth.rotation[:, 0]))
    samples = along.readings(np.asarray(truth.position)[:, 0], turned, 0.01, np.asarray(robot(free=True).gravity))
    samples = along.spoiled(samples, along.Faults(), 0.01, 5)
    imu = []
    for value in samples:
        before = np.concatenate([np.zeros((1, 10, 3)), value[:200].reshape(20, 10, 3)])
        imu.append(Reading(jnp.asarray(before, jnp.float32), jnp.ones(before.shape[:2], bool)))
    spacing = jnp.full((21, 10), 0.01, jnp.float32).at[0].set(0)
    some = jax.tree.map(lambda x: x[::10], dense)
    given = Driven(some.ranges, some.joints, *imu, spacing, jnp.full(21, 0.1, jnp.float32))
    return given, turned[::10]


@pytest.mark.slow
def test_a_roll_that_is_lost_without_an_imu_is_followed_with_it(system):
    """1.5 rad a step, from rest; where samples are missing SLAM goes on alone, and says so of what is not finite."""
    given, turned = rolled(system, 15.0)
    step = jax.jit(partial(run, system.step), compiler_options=QUICK)
    start = system.init(system.default_params)
    state, info = step(system.default_params, start, given)
    away = jax.vmap(lambda a, b: jnp.linalg.norm(quaternion.local(a, b)))(turned, info.inner.quaternion[:, 0])
    assert np.asarray(away).max() < 0.05
    assert np.all(np.isin(np.asarray(info.status), [OK, 3]))
    assert np.all(np.asarray(info.driven)[1:])
    assert np.linalg.eigvalsh(np.asarray(state.track.covariance)).min() > 0
    missing = np.asarray(given.gyroscope.value).copy()
    missing[4, 3] = np.nan
    _, info = step(system.default_params, start, given._replace(gyroscope=Reading(missing, given.gyroscope.valid)))
    assert not info.driven[4]
    assert info.driven[5]
    assert int(info.status[4]) == NON_FINITE
    away = jax.vmap(lambda a, b: jnp.linalg.norm(quaternion.local(a, b)))(turned, info.inner.quaternion[:, 0])
    assert np.asarray(away).max() < 0.05


def test_where_a_scan_tells_nothing_the_root_is_as_uncertain_as_its_imu():
    """SLAM's root is then where the IMU has brought it: as a measurement it would be counted again in every step."""
    system = tiny(system=slam_inertial, imu="root")
    state = system.init(system.default_params)
    back = se3.Pose(jnp.array([1.0, 0, 0, 0]), jnp.zeros(3))
    spread = jnp.asarray(np.repeat([0.02, 0.3, 0.1, 0.01, 0.1], 3) ** 2, jnp.float32)
    track = state.track._replace(covariance=jnp.diag(spread))
    sure = state.inner._replace(covariance=state.inner.covariance.at[:6, :6].set(1e-4 * jnp.eye(6)))
    blind, inner = slam_inertial._corrected(track, sure, back, jnp.bool_(False))
    np.testing.assert_array_equal(blind.covariance, track.covariance)
    np.testing.assert_allclose(np.diag(inner.covariance)[:6], np.repeat([0.09, 0.0004], 3), rtol=1e-5)
    told, kept = slam_inertial._corrected(track, sure, back, jnp.bool_(True))
    np.testing.assert_array_equal(kept.covariance, sure.covariance)
    assert np.all(np.diag(told.covariance)[3:6] < 1.1e-4)


@pytest.mark.slow
def test_samples_that_stand_for_another_time_than_the_step_or_outgrow_the_precision_are_left_out(system):
    given, _ = rolled(system, 0.1)
    state, _ = jax.jit(partial(run, system.step), compiler_options=QUICK)(
        system.default_params, system.init(system.default_params), jax.tree.map(lambda x: x[:5], given)
    )
    step = jax.jit(system.step, compiler_options=QUICK)
    row = jax.tree.map(lambda x: x[5], given)
    huge = row.accelerometer._replace(value=row.accelerometer.value.at[0, 0].set(1e30))
    long = row.spacing.at[0].set(2.0)
    for changed, status in (
        (row, OK),
        (row._replace(spacing=long), OK),
        (row._replace(accelerometer=huge), OUT_OF_RANGE),
    ):
        after, info = step(system.default_params, state, changed)
        assert int(info.status) == status
        assert bool(info.driven) == (changed is row)
        assert finite(after)


def test_an_imu_elsewhere_is_named():
    with pytest.raises(InputError, match="expected a free one"):
        slam_inertial.build(robot(), sensors(), "root")
    with pytest.raises(InputError, match="expected the root 'root'"):
        slam_inertial.build(robot(free=True), sensors(), "site:tip")
    with pytest.raises(InputError, match="expected as many, and three"):
        along.readings(np.zeros((2, 3)), np.ones((2, 4)), 0.1)
