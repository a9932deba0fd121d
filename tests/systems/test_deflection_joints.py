"""Slides and balls in the deflection filter: exact answers, names, intervals, a robot that has every kind."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from deflection_models import CRANE, crane, crane_sensors
from quick_compile import QUICK
from scipy.spatial.transform import Rotation
from scipy.special import ive

from jaxest import kinematics
from jaxest.filters import run
from jaxest.kinematics.space import Joints
from jaxest.manifolds import quaternion
from jaxest.sensors import Sensor, link_orientation, link_position, measurement_type
from jaxest.simulate import deflection as bending
from jaxest.systems import deflection
from jaxest.types import InputError, Reading

PROPOSALS = {"bootstrap": (deflection.bootstrap, 4096), "guided": (deflection.guided, 512)}
RUNS = 40


def several(system, params, measurements, runs=RUNS):
    """Histories of the same measurements under several keys, (runs, T, ...)."""

    def one(key):
        state = system.init(params, key=key)
        return run(system.step, params, state, measurements, key=key, history=deflection.with_interval)[1]

    keys = jax.random.split(jax.random.key(3), runs)
    return jax.tree.map(np.asarray, jax.jit(lambda k: jax.lax.map(one, k), compiler_options=QUICK)(keys))


def assert_total(found, exact):
    """Evidence: the logarithm of an unbiased estimate lies half its variance too low."""
    total = np.asarray(found, float).sum(1)
    centre, spread = total.mean() + total.var(ddof=1) / 2, total.var(ddof=1)
    error = np.sqrt(spread / len(total) + spread**2 / (2 * len(total)))
    assert abs(centre - exact) < 4.5 * error + 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bootstrap", "guided"])
def test_a_slide_is_the_kalman_filter(name):
    """A slide with its encoder, sometimes missing, and a marker on its body."""
    propose, count = PROPOSALS[name]
    sensors = (
        Sensor("slide_position", "encoder", ("rail",)),
        Sensor("link_position", "marker", ("trolley",), link_position.Params(np.array([4e-4, 1.0, 1.0]))),
    )
    system = deflection.build(crane(), sensors, joints=["rail"], particles=count, proposal=propose)
    params = jax.tree.map(np.float32, system.default_params._replace(start=0.1, prior=25.0, walk=900.0))
    steps, random = 6, np.random.default_rng(5)
    way = 0.1 + 0.2 * random.normal() + np.cumsum(random.normal(size=steps) / 30)
    read, seen = way + 0.01 * random.normal(size=steps), way + 0.02 * random.normal(size=steps)
    valid = np.array([True, True, False, True, False, True])
    place = np.stack([seen, np.zeros(steps), np.full(steps, 2.0)], 1)
    measurements = measurement_type(sensors)(
        Reading(np.float32(read[:, None]), valid), Reading(np.float32(place), np.arange(steps) != 3),
        np.full(steps, 0.1, np.float32),
    )  # fmt: skip
    found = several(system, params, measurements)

    def exact(walk):
        """Means and deviations (T,), and the log-evidence."""
        mean, variance, means, evidence = 0.1, 1 / 25.0, [], 0.0
        for t in range(steps):
            variance += 1 / walk
            for value, noise, there in ((read[t], 1e-4, valid[t]), (seen[t], 4e-4, t != 3)):
                if there:
                    total, away = variance + noise, value - mean
                    evidence -= (np.log(2 * np.pi * total) + away**2 / total) / 2
                    mean, variance = mean + variance / total * away, variance * noise / total
            evidence -= np.log(2 * np.pi) * (t != 3)  # y and z of the marker, exactly as expected, of variance 1
            means.append((mean, np.sqrt(variance)))
        return np.array(means).T, evidence

    (mean, deviation), evidence = exact(900.0)
    error = found.info.mean.slide[..., 0].std(0, ddof=1) / np.sqrt(RUNS)
    assert np.all(np.abs(found.info.mean.slide[..., 0].mean(0) - mean) < 4.5 * error + 1e-6)
    np.testing.assert_allclose(np.sqrt(found.info.covariance[..., 0, 0].mean(0)), deviation, rtol=0.05)
    np.testing.assert_allclose(found.upper[..., 0].mean(0), 1.96 * deviation, rtol=0.08)
    assert_total(found.info.log_likelihood, evidence)
    if name == "guided":

        def total(log_walk, key):
            given = params._replace(walk=jnp.exp(log_walk))
            history = run(system.step, given, system.init(given, key=key), measurements, key=key)[1]
            return jnp.sum(history.log_likelihood)

        keys = jax.random.split(jax.random.key(8), RUNS)
        score_of = partial(jax.grad(total), jnp.log(jnp.float32(900.0)))
        score = jax.jit(lambda k: jax.lax.map(score_of, k), compiler_options=QUICK)
        slopes = np.asarray(score(keys), float)
        expected = (exact(900.0 * np.exp(1e-4))[1] - exact(900.0 * np.exp(-1e-4))[1]) / 2e-4
        assert abs(slopes.mean() - expected) < 4.5 * slopes.std(ddof=1) / np.sqrt(RUNS) + 1e-4


@cache
def ball_by_numpy():
    """A NumPy particle filter of a rotation: means (T, 4) wxyz, deviations (T,), log-evidence of each step."""
    random, count = np.random.default_rng(1), 200_000
    seen = Rotation.from_rotvec([[0.5, -0.2, 0.3], [0.6, -0.3, 0.5], [0.9, 0.0, 0.4]])
    lam = np.array([0.0, -30.0, -60.0, -15.0])
    t = np.linspace(0, np.pi / 2, 20_001)  # (w, z) and (x, y) as two circles
    c, s = np.cos(t) ** 2, np.sin(t) ** 2
    one, two = (lam[0] - lam[3]) / 2 * c, (lam[1] - lam[2]) / 2 * s
    energy = (lam[0] + lam[3]) / 2 * c + (lam[1] + lam[2]) / 2 * s + abs(one) + abs(two)
    area = 4 * np.pi**2 * np.trapezoid(np.cos(t) * np.sin(t) * np.exp(energy) * ive(0, one) * ive(0, two), t)
    turn = Rotation.from_rotvec(random.normal(size=(count, 3)) / np.sqrt(2.0))
    means, deviations, evidence = [], [], []
    for now in seen:
        turn = turn * Rotation.from_rotvec(random.normal(size=(count, 3)) / np.sqrt(8.0))
        e = (now * turn.inv()).as_quat()[:, [3, 0, 1, 2]]
        weight = np.exp(np.sum(lam * e * e, axis=1)) / area
        evidence.append(np.log(weight.mean()))
        turn = turn[random.choice(count, count, p=weight / weight.sum())]
        mean = turn.mean()
        means.append(mean.as_quat()[[3, 0, 1, 2]])
        deviations.append(np.sqrt(np.mean((mean.inv() * turn).magnitude() ** 2)))
    return seen.as_quat()[:, [3, 0, 1, 2]], lam, np.array(means), np.array(deviations), np.array(evidence)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bootstrap", "guided"])
def test_a_ball_is_what_numpy_finds(name):
    propose, count = PROPOSALS[name]
    seen, lam, mean, deviation, evidence = ball_by_numpy()
    sensors = (Sensor("link_orientation", "imu", ("cup",), link_orientation.Params(lam)),)
    system = deflection.build(crane(), sensors, joints=["wrist"], particles=count, proposal=propose)
    params = jax.tree.map(np.float32, system.default_params._replace(prior=2.0, walk=8.0))
    measurements = measurement_type(sensors)(Reading(np.float32(seen), np.ones(3, bool)), np.full(3, 0.1, np.float32))
    found = several(system, params, measurements)
    away = np.asarray(jax.vmap(jax.vmap(quaternion.local), (None, 0))(mean, found.info.mean.ball[:, :, 0]))
    # The reference errs, too: by a deviation over the root of its effective draws, ten thousand.
    error = np.sqrt(away.std(0, ddof=1) ** 2 / RUNS + deviation[:, None] ** 2 / 1e4)
    assert np.all(np.abs(away.mean(0)) < 4.5 * error)
    spread = np.sqrt(np.trace(found.info.covariance, axis1=2, axis2=3).mean(0))
    np.testing.assert_allclose(spread, deviation, rtol=0.05)
    assert_total(found.info.log_likelihood, evidence.sum())


def test_every_kind_at_once_follows_a_robot_that_bends():
    """The crane sways, trolley and cup give, too; the encoders alone do not see it."""
    system = deflection.build(
        crane(), crane_sensors(), joints=["wrist", "rail", "boom"], particles=512, proposal=deflection.guided
    )
    compliance = jnp.array([0.1, 0.002, 0.3, 0.3, 0.3])

    def motion(time):
        turn = quaternion.exp(0.4 * jnp.array([jnp.sin(time), jnp.cos(time) - 1, 0.3]))
        return jnp.concatenate([jnp.array([0.2 * jnp.sin(time), 0.6]), turn])

    def draw(key):
        return bending.simulate(
            crane(), crane_sensors(), key=key, duration=1.5, rate_hz=20.0, joints=["wrist", "rail", "boom"],
            motion=motion, faults=bending.Faults(compliance=compliance, drift=0.0, yaw_walk=0.0, hidden=0.0),
        )  # fmt: skip

    measurements, truth = jax.jit(draw, compiler_options=QUICK)(jax.random.key(0))
    found = several(system, jax.tree.map(np.float32, system.default_params), measurements, 1)
    assert np.all(found.info.status == 0)
    assert np.mean(found.info.ess[0, 5:]) > 0.7 * 512
    mean = jax.tree.map(lambda x: x[0, 5:], found.info.mean)
    true = jax.tree.map(lambda x: np.asarray(x[5:]), truth.angles)
    assert isinstance(mean, Joints) and mean.hinge.shape == (25, 1) and mean.slide.shape == (25, 1)
    told = np.asarray(truth.reference.hinge)[5:, 0]
    assert np.sqrt(np.mean((mean.hinge[:, 0] - true.hinge[:, 0]) ** 2)) < 0.5 * np.abs(told - true.hinge[:, 0]).mean()
    assert np.sqrt(np.mean((mean.slide - true.slide) ** 2)) < 0.01
    turn = np.asarray(jax.vmap(quaternion.local)(mean.ball[:, 0], true.ball[:, 0]))
    bent = np.asarray(jax.vmap(quaternion.local)(np.asarray(truth.reference.ball)[5:, 0], true.ball[:, 0]))
    assert np.sqrt(np.mean(turn**2)) < 0.5 * np.sqrt(np.mean(bent**2))


def test_names_and_kinds_are_told():
    with pytest.raises(InputError, match="joint 'drift' is a free joint, expected a hinge, slide or ball of its own"):
        deflection.build(crane(), joints=["drift"])
    with pytest.raises(InputError, match="sensor 'joints': no hinge is estimated"):
        deflection.build(crane(), joints=["rail"])
    with pytest.raises(InputError, match="estimated slide 'boom' does not exist; known: rail"):
        deflection.build(crane(), [Sensor("slide_position", "a", ("boom",))], joints=["rail", "boom"])
    only = CRANE.replace('name="boom" type="hinge"', 'name="boom" type="slide"')
    with pytest.raises(InputError, match="there is no hinge; slides and balls are estimated where they are named"):
        deflection.build(kinematics.load(only))
