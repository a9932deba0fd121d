"""The attitude filters: pieces against loops and differences, whole filters on simulated IMUs whose truth is known."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from moving_imu import moving
from reference import ref_attitude

from jaxest.filters import attitude, complementary, run
from jaxest.filters.attitude import lowpass, motion, rest
from jaxest.filters.imu import usable
from jaxest.manifolds import quaternion as quat
from jaxest.metrics import align_heading, nees, orientation_difference, orientation_error
from jaxest.types import NON_FINITE, OK, Reading

HZ, RUNS, STEPS = 50.0, 8, 3000
FILTERS = [attitude.ekf, attitude.decoupled]
NAMES = ["ekf", "decoupled"]


@cache
def drawn():
    """60 s of 8 IMUs."""
    return moving(RUNS, STEPS, HZ, seed=3)


@cache
def compiled(module):
    return jax.jit(jax.vmap(lambda params, rows: run(module.step, params, module.init(params), rows), (None, 0)))


def estimated(module, measurements, params=None):
    params = jax.tree.map(np.float32, params or module.Params())
    return jax.tree.map(np.asarray, compiled(module)(params, measurements))


def test_the_lowpass_is_butterworths_at_any_steps(dtype):
    random = np.random.default_rng(0)
    samples, dt = random.normal(size=(300, 2)), random.uniform(0.001, 0.1, 300)
    dt[200] = 2.0

    def step(memory, row):
        memory = lowpass.lowpass(memory, *row, 3.0)
        return memory, memory.value

    rows = jnp.asarray(samples, dtype), jnp.asarray(dt, dtype)
    _, values = jax.jit(lambda rows: jax.lax.scan(step, lowpass.begin(2, dtype), rows))(rows)
    expected = ref_attitude.lowpass(samples, dt, 3.0)
    np.testing.assert_allclose(values, expected, atol=1e-12 if dtype == "float64" else 2e-6)


@pytest.mark.parametrize("nine", [False, True])
def test_madgwick_against_the_loop_of_the_paper(nine, dtype):
    random = np.random.default_rng(7)
    steps = 300
    gyr, acc, mag = random.normal(size=(3, steps, 3))
    acc, mag, dt = acc + np.array([3, 2, 5]), 20 * mag + np.array([10, -40, 5]), random.uniform(0.001, 0.05, steps)
    masks = random.random((steps, 3)) > 0.2
    masks[0] = True
    readings = [Reading(np.where(mask[:, None], value, np.nan).astype(dtype), mask)
                for value, mask in zip((gyr, acc, mag), masks.T, strict=True)]  # fmt: skip
    measurements = complementary.Imu(*readings[:2], readings[2] if nine else None, dt.astype(dtype))
    params = attitude.madgwick.Params(np.asarray(0.3, dtype))
    _, info = run(attitude.madgwick.step, params, attitude.madgwick.init(params), measurements)
    expected = ref_attitude.madgwick(gyr, acc, mag if nine else None, dt, 0.3, masks)
    worst = np.max(orientation_error(np.asarray(info.quaternion, float), expected).total if nine else
                   orientation_error(np.asarray(info.quaternion, float),
                                     align_heading(np.asarray(info.quaternion, float), expected)).total)  # fmt: skip
    assert worst < (1e-7 if dtype == "float64" else 3e-4)
    assert np.all(np.asarray(info.status) == OK)
    assert np.all(info.valid)


def test_errors_move_as_the_transition_says(x64):
    """Against differences of the integration of a block, to first order in the block's length."""
    random = np.random.default_rng(1)
    count, dt = 6, 1e-3
    rows = complementary.imu(*random.normal(size=(3, count, 3)) + np.array([0, 0, 9.81]), dt=np.full(count, dt))
    track = motion.Track(
        jnp.asarray(quat.exp(jnp.array([0.4, -0.7, 1.0]))), *(jnp.asarray(random.normal(size=n)) for n in (2, 2)),
        *(0.1 * jnp.asarray(random.normal(size=3)) for _ in range(2)), jnp.array([0.1, 0.5, -0.8]),
    )  # fmt: skip

    def moved(v):
        def body(carry, row):
            return motion.integrate(*carry, usable(row, jnp.float64), 0.25), None

        start = motion.MANIFOLD.retract(track, v), motion.begin(jnp.float64)
        return jax.lax.scan(body, start, rows)[0]

    end, since = moved(jnp.zeros(16))
    slope = jax.jacfwd(lambda v: motion.MANIFOLD.local(end, moved(v)[0]))(jnp.zeros(16))
    found = motion.carry(track.scale, since)
    assert float(since.time) == pytest.approx(count * dt)
    np.testing.assert_allclose(found, slope, atol=1.2 * 9.81 * (count * dt) ** 2 / 2)  # a bias also moves the velocity
    assert np.max(np.abs(np.asarray(slope) - np.eye(16))) > 0.03


def test_a_specific_force_stands_for_the_time_since_the_last(x64):
    """At a third of the gyroscope's rate its pushes are as long; beyond `hold` something is unseen."""
    count, dt, force = 12, 0.01, np.array([1.0, 2.0, 9.81])
    rows = complementary.imu(np.zeros((count, 3)), np.tile(force, (count, 1)), dt=np.full(count, dt))
    third = rows.accelerometer._replace(valid=np.arange(count) % 3 == 2)
    none = rows.accelerometer._replace(valid=np.zeros(count, bool))
    track = motion.Track(quat.identity(jnp.float64), *(jnp.zeros(n) for n in (2, 2, 3, 3, 3)))

    def moved(rows, since, hold):
        body = lambda carry, row: (motion.integrate(*carry, usable(row, jnp.float64), hold), None)  # noqa: E731
        return jax.lax.scan(body, (track, since), rows)[0]

    start = motion.begin(jnp.float64)
    for some in (rows, rows._replace(accelerometer=third)):
        end, since = moved(some, start, 0.25)
        np.testing.assert_allclose(end.velocity, force[:2] * count * dt)
        np.testing.assert_allclose(since.push, force * count * dt)
        assert float(since.afloat) == float(since.waiting) == 0
    _, since = moved(rows._replace(accelerometer=none), start, 0.05)
    assert float(since.afloat) == pytest.approx(count * dt - 0.05)
    end, since = moved(jax.tree.map(lambda x: x[:1], rows), motion.again(since), 0.05)  # a correction in between
    np.testing.assert_allclose(end.velocity, force[:2] * 0.05)
    assert float(since.afloat) == pytest.approx(dt)


def test_an_imu_rests_when_it_is_still(dtype):
    still, memory = rest.Rest(*(np.asarray(x, dtype) for x in rest.Rest())), rest.begin(dtype)
    watch = jax.jit(rest.watch)

    def fed(memory, rate, seconds, gyro=True):
        row = complementary.imu(np.asarray(rate, dtype), np.array([0, 0, 9.81], dtype), dt=np.asarray(0.05, dtype))
        row = row._replace(gyroscope=row.gyroscope._replace(valid=np.bool_(gyro)))
        for _ in range(round(seconds / 0.05)):
            memory = watch(still, memory, usable(row, dtype))
        return memory

    memory = fed(memory, (0.01, 0, 0), 1.4)
    assert 1.3 < memory.time < 1.5
    memory = fed(memory, (0.01, 0, 0), 1.0)
    assert memory.time > 1.5
    assert fed(memory, (0, 0, 0), 1.0, gyro=False).time == memory.time  # says nothing
    assert fed(memory, (0.3, 0, 0), 0.1).time == 0
    assert fed(rest.begin(dtype), (0.3, 0, 0), 3.0).time == 0  # a steady turn is no rest


@pytest.mark.parametrize("module", FILTERS, ids=NAMES)
def test_moving_imus_are_followed(module):
    """Errors of 8 simulated runs from 20 s on, beside those of the complementary filter with its default gains."""
    measurements, truth = drawn()
    (_, info), (_, plain) = (estimated(each, measurements) for each in (module, complementary))
    assert np.all(info.status == OK)
    late = slice(round(20 * HZ), None)
    ours, theirs = (orientation_error(x.quaternion[:, late].astype(float), truth.quaternion[:, late])
                    for x in (info, plain))  # fmt: skip
    inclination, heading, usual = (
        np.degrees(np.sqrt(np.mean(x**2))) for x in (ours.inclination, ours.heading, theirs.inclination)
    )
    assert inclination < usual / (10 if module is attitude.ekf else 3)
    assert heading < 3.0


@pytest.mark.parametrize("module", FILTERS, ids=NAMES)
def test_errors_keep_what_the_covariance_claims(module):
    """Over 8 independent runs, every 5 s: neither tilt nor heading beyond 3.5 sigma, nor ten times smaller than it.

    The simulated sensors are better than what the noise stands for: accelerometers have no bias, rooms are even.
    """
    measurements, truth = drawn()
    _, info = estimated(module, measurements)
    at = slice(round(20 * HZ), None, round(5 * HZ))
    quaternion = info.quaternion[:, at].astype(float)
    error = orientation_difference(quaternion, truth.quaternion[:, at])
    turn = np.asarray(jax.vmap(jax.vmap(quat.to_matrix))(jnp.asarray(quaternion)))
    error = np.einsum("...ij,...j->...i", turn, error)
    covariance = np.einsum("...ij,...jk,...lk->...il", turn, info.covariance[:, at].astype(float), turn)
    squared = error**2 / np.diagonal(covariance, axis1=-2, axis2=-1)
    assert np.all(squared.max((0, 1)) < 3.5**2)
    assert np.all(squared.mean((0, 1)) > 0.01)
    assert np.all(np.linalg.eigvalsh(covariance) > 0)


def test_bias_and_scale_are_found():
    """After a minute of turns: a tenth of the bias is left by the Kalman filter, a third by the other; of 2 % of scale,
    given as such, a fifth."""
    measurements, truth = drawn()
    for module, share in ((attitude.ekf, 0.15), (attitude.decoupled, 0.35)):
        _, info = estimated(module, measurements)
        assert np.sqrt(np.mean((info.bias[:, -1] - truth.bias) ** 2)) < share * np.sqrt(np.mean(truth.bias**2))
    wrong, truth = moving(RUNS, STEPS, HZ, seed=4, scale=0.02)
    scale = estimated(attitude.ekf, wrong, attitude.ekf.Params(initial_scale=0.02))[1].scale[:, -1]
    assert np.sqrt(np.mean((scale - truth.scale) ** 2)) < 0.2 * np.sqrt(np.mean(truth.scale**2))


@pytest.mark.parametrize("module", FILTERS, ids=NAMES)
def test_a_magnet_for_ten_seconds_turns_little(module):
    """A magnet as strong as the field, 45 uT to the east: its readings are rejected."""
    measurements, truth = drawn()
    mag = measurements.magnetometer
    back = jax.vmap(jax.vmap(lambda q: quat.rotate(quat.inverse(q), jnp.array([45.0, 0, 0], q.dtype))))
    hit = (np.arange(STEPS) >= 20 * HZ) & (np.arange(STEPS) < 30 * HZ)
    value = mag.value + np.where(hit[None, :, None], np.asarray(back(jnp.asarray(truth.quaternion, "f"))), 0)
    clean, hurt = (
        estimated(module, m)[1] for m in (measurements, measurements._replace(magnetometer=Reading(value, mag.valid)))
    )
    end = round(30 * HZ) - 1
    apart = orientation_error(hurt.quaternion[:, end].astype(float), clean.quaternion[:, end].astype(float))
    assert np.degrees(np.max(apart.heading)) < 8.0  # its field points 68 degrees elsewhere
    assert np.degrees(np.max(apart.inclination)) < 0.3
    assert np.all(hurt.weight_mag[:, end] < 0.5)


@pytest.mark.parametrize("module", FILTERS, ids=NAMES)
def test_a_lasting_change_of_the_field_is_believed_in_the_end(module):
    count, hz = STEPS, 20  # 150 s
    field = np.where(np.arange(count)[:, None] < 10 * hz, [0, 18.0, -41], [41.0, 18, 0])
    rows = complementary.imu(np.zeros((count, 3), "f"), np.tile(np.float32([0, 0, 9.81]), (count, 1)),
                             field.astype("f"), dt=np.float32(1 / hz))  # fmt: skip
    _, info = jax.tree.map(lambda x: x[0], estimated(module, jax.tree.map(lambda x: np.stack([x] * RUNS), rows)))
    assert np.min(info.weight_mag[: 10 * hz]) == 1
    assert np.max(info.weight_mag[11 * hz : 40 * hz]) < 0.5
    heading = np.degrees(2 * np.arctan2(info.quaternion[:, 3], info.quaternion[:, 0]))
    assert np.max(np.abs(heading[: 60 * hz])) < 20
    assert info.weight_mag[-1] > 0.9
    assert heading[-1] == pytest.approx(np.degrees(np.arctan2(41, 18)), abs=3)


@pytest.mark.parametrize("module", FILTERS, ids=NAMES)
def test_a_gap_grows_the_covariance_and_is_overcome(module):
    measurements, truth = drawn()
    start, end = round(25 * HZ), round(27 * HZ)
    hidden = np.ones((RUNS, STEPS), bool)
    hidden[:, start:end] = False
    names = ("gyroscope", "accelerometer", "magnetometer")
    gone = {name: Reading(getattr(measurements, name).value, hidden) for name in names}
    _, info = estimated(module, measurements._replace(**gone))
    spread = np.trace(info.covariance, axis1=2, axis2=3)
    assert np.all(spread[:, end - 1] > 30 * spread[:, start - 1])
    assert np.all(spread[:, -1] < 3 * spread[:, start - 1])
    error = orientation_error(info.quaternion.astype(float), truth.quaternion.astype(float))
    assert np.degrees(np.median(error.inclination[:, end - 1])) > 3
    assert np.degrees(np.max(error.inclination[:, -1])) < 3


@pytest.mark.parametrize("module", [pytest.param(attitude.ekf, marks=pytest.mark.slow), attitude.decoupled], ids=NAMES)
def test_units_of_the_field_and_masks(module):
    """Gauss or microtesla; a masked magnetometer is none; a broken value is reported and left out."""
    measurements, _ = drawn()
    mag = measurements.magnetometer
    _, info = estimated(module, measurements)
    other = measurements._replace(magnetometer=Reading(mag.value / 128, mag.valid))
    np.testing.assert_allclose(estimated(module, other)[1].quaternion, info.quaternion, atol=1e-4)
    _, six = estimated(module, measurements._replace(magnetometer=None))
    _, hidden = estimated(module, measurements._replace(magnetometer=Reading(mag.value, np.zeros_like(mag.valid))))
    np.testing.assert_allclose(hidden.quaternion, six.quaternion, atol=1e-4)
    assert not np.any(hidden.valid)
    assert np.all(six.valid)
    broken = mag.value.copy()
    broken[:, 77] = np.inf
    _, reported = estimated(module, measurements._replace(magnetometer=Reading(broken, mag.valid)))
    assert np.all((reported.status == NON_FINITE) == (np.arange(STEPS) == 77))
    if module is attitude.decoupled:
        np.testing.assert_allclose(info.quaternion_6, six.quaternion, atol=1e-4)


def test_wrong_shapes_are_named():
    row = jax.tree.map(lambda x: x[0, 0], drawn()[0])
    for module in (*FILTERS, attitude.madgwick):
        wrong = row._replace(accelerometer=Reading(np.zeros(4, "f"), np.bool_(True)))
        with pytest.raises(ValueError, match=r"measurement.accelerometer: got shape \(4,\), expected \(3,\)"):
            module.step(module.Params(), module.init(module.Params()), wrong)


@cache
def smoothed(length, block):
    rows = jax.tree.map(lambda x: x[0, :length], drawn()[0])
    params = jax.tree.map(np.float32, attitude.ekf.Params())
    return jax.tree.map(np.asarray, attitude.smooth(params, attitude.ekf.init(params), rows, block=block))


@pytest.mark.parametrize("dtype", ["float32", pytest.param("float64", marks=pytest.mark.slow)], indirect=True)
def test_the_smoother_beats_the_filter_and_ends_near_it(dtype):
    """At the end, with nothing behind, it knows what the filter knows; before, it is better and surer."""
    measurements, truth = drawn()
    params = jax.tree.map(lambda x: np.asarray(x, dtype), attitude.ekf.Params(interval=0.04))
    rows = jax.tree.map(lambda x: x[0, :1500] if x.dtype == bool else x[0, :1500].astype(dtype), measurements)
    _, filtered = run(attitude.ekf.step, params, attitude.ekf.init(params), rows)
    info = attitude.smooth(params, attitude.ekf.init(params), rows, block=2)
    assert info.quaternion.dtype == dtype
    quaternions = [np.asarray(x.quaternion, float) for x in (info, filtered)]
    covariances = [np.asarray(x.covariance, float) for x in (info, filtered)]
    apart = orientation_difference(*(q[-1] for q in quaternions))
    assert nees(apart, covariances[1][-1]) < 0.2  # of 3; two linearisations of a start 10 degrees off
    np.testing.assert_allclose(info.bias[-1], filtered.bias[-1], atol=1e-4)
    np.testing.assert_allclose(covariances[0][-1], covariances[1][-1], rtol=0.1, atol=1e-6)
    exact = truth.quaternion[0, :1500]
    rms = [np.sqrt(np.mean(orientation_error(q, exact).total ** 2)) for q in quaternions]
    assert rms[0] < 0.7 * rms[1]
    traces = [np.trace(c, axis1=1, axis2=2) for c in covariances]
    assert np.all(traces[0] < 1.05 * traces[1])
    assert np.all(np.asarray(info.valid))


def test_blocks_that_do_not_fit_are_padded():
    """What is smoothed does not hang on the length of blocks, nor on how many samples the last one has."""
    whole, odd = smoothed(1500, 2), smoothed(1499, 3)
    assert odd.quaternion.shape == (1499, 4)
    apart = orientation_error(odd.quaternion.astype(float), whole.quaternion[:1499].astype(float))
    assert np.degrees(np.max(apart.total)) < 0.2
    with pytest.raises(ValueError, match="block: got 0, expected at least 1"):
        attitude.smooth(attitude.ekf.Params(), attitude.ekf.init(attitude.ekf.Params()), drawn()[0], block=0)
