"""The deflection filter on the packaged arm: both proposals agree, intervals hold, names are checked."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from deflection_models import FEW, SENSORS, arm, build
from quick_compile import QUICK
from scipy.special import i0e

from jaxest import kinematics, models
from jaxest.filters import run
from jaxest.manifolds import circle
from jaxest.sensors import Sensor, measurement_type
from jaxest.simulate import deflection as bending
from jaxest.systems import deflection
from jaxest.types import InputError, Reading


def leaning(time):
    """Stretched out to the side, where the arm bends most."""
    return jnp.array([0.2, 1.2, 0.3, -0.3]) + 0.1 * jnp.sin(time) * jnp.array([1.0, 1.0, 1.0, 0.0])


def several(system, measurements, seeds, history=deflection.with_interval):
    """Histories of the same measurements under several keys, (seeds, T, ...)."""
    params = system.default_params

    def one(key):
        return run(system.step, params, system.init(params, key=key), measurements, key=key, history=history)[1]

    return jax.jit(lambda keys: jax.lax.map(one, keys), compiler_options=QUICK)(
        jax.random.split(jax.random.key(7), seeds)
    )


@pytest.mark.slow
def test_both_proposals_find_the_same_posterior():
    """Means over 20 runs within 4.5 standard errors, the evidence of 8 steps too; guided keeps a larger share."""
    guided, blind = build(deflection.guided, FEW, 256), build(deflection.bootstrap, FEW, 2048)
    draw = jax.jit(lambda key: guided.simulate(guided.default_params, key=key, steps=8)[0], compiler_options=QUICK)
    measurements = draw(jax.random.key(2))
    found = [several(system, measurements, 20) for system in (guided, blind)]
    one, two = (np.asarray(f.info.mean, float) for f in found)
    apart = np.asarray(circle.wrap(jnp.asarray(one.mean(0) - two.mean(0))))
    error = np.sqrt((one.var(0) + two.var(0)) / 19)
    assert np.all(np.abs(apart) < 4.5 * error)
    totals = [np.asarray(f.info.log_likelihood, float).sum(1) for f in found]
    # The logarithm of an unbiased estimate lies half its variance too low.
    centre = [t.mean() + t.var() / 2 for t in totals]
    assert abs(centre[0] - centre[1]) < 4.5 * np.sqrt(sum(t.var() / 19 + t.var() ** 2 / 38 for t in totals))
    share = [np.median(f.info.ess) / n for f, n in zip(found, (256, 2048), strict=True)]
    assert share[0] > 20 * share[1]  # the walk jumps by 0.45 rad here; on a slow arm, below, guided keeps 0.9


@pytest.mark.slow
def test_a_bent_arm_is_known_better_with_imus():
    """The sag of the pitch joints: reference angles alone miss it, IMUs on links 2 and 3 find it."""
    draw = partial(bending.simulate, arm(), SENSORS, motion=leaning, duration=1.0, rate_hz=20.0)
    measurements, truth = jax.jit(lambda key: draw(key=key), compiler_options=QUICK)(jax.random.key(0))
    system = build(deflection.guided, SENSORS, 256)
    blind = measurements._replace(
        **{name: getattr(measurements, name)._replace(valid=np.zeros(20, bool)) for name in ("imu2", "imu3", "tip")}
    )
    errors = []
    for given in (measurements, blind):
        found = several(system, given, 1)
        assert np.all(np.asarray(found.info.status) == 0)
        assert np.all(np.asarray(found.info.ess)[0, 3:] > 0.9 * 256)
        errors.append(np.sqrt(np.mean(np.asarray(circle.wrap(found.info.mean[0] - truth.angles))[3:] ** 2, axis=0)))
    assert np.all(np.asarray(truth.angles - truth.reference)[:, 1] > 0.1)
    assert errors[0][1] < errors[1][1] / 3


def test_an_arm_that_sags_goes_down():
    """The tip of the bent arm is lower than that of the rigid one, wherever it leans outwards."""
    draw = partial(bending.simulate, arm(), FEW, duration=2.0, rate_hz=5.0, frames=("site:end_effector",))
    _, truth = jax.jit(lambda key: draw(key=key), compiler_options=QUICK)(jax.random.key(1))
    rigid = jax.vmap(lambda q: kinematics.forward(arm(), q, ("site:end_effector",)).position)(truth.reference)
    assert np.all(np.asarray(truth.frames.position)[:, 0, 2] < np.asarray(rigid)[:, 0, 2])


def test_the_prior_of_stiffness_takes_out_the_sag():
    """With the true compliance, reference angles alone are unbiased."""
    sensors = FEW[:1]
    draw = partial(bending.simulate, arm(), sensors, motion=leaning, duration=0.5, rate_hz=20.0)
    measurements, truth = jax.jit(lambda key: draw(key=key), compiler_options=QUICK)(jax.random.key(0))
    system = build(deflection.guided, sensors, 1000, sag=True)
    system = system._replace(default_params=system.default_params._replace(compliance=0.033))
    found = several(system, measurements, 1)
    error = np.asarray(circle.wrap(found.info.mean[0] - truth.angles))[2:]
    # Posterior deviation about 0.23 rad, 1000 particles, encoders read to 0.003.
    assert np.abs(error).max() < 4.5 * 0.25 / np.sqrt(900) + 0.01
    assert np.abs(np.asarray(truth.angles - truth.reference))[:, 1].max() > 0.05


@pytest.mark.slow
def test_gaussian_noise_gives_much_the_same():
    draw = partial(bending.simulate, arm(), FEW, duration=0.5, rate_hz=20.0)
    measurements, _ = jax.jit(lambda key: draw(key=key), compiler_options=QUICK)(jax.random.key(0))
    one, two = (
        several(build(deflection.guided, FEW, 500, noise=noise), measurements, 1).info
        for noise in (deflection.von_mises, deflection.gaussian)
    )
    assert np.abs(np.asarray(circle.wrap(one.mean - two.mean))[0, 2:]).max() < 0.06


@pytest.mark.slow
def test_others_come_with_the_measurement_or_stay_at_home():
    """A marker beyond a joint that is not estimated is understood with that joint's measured angle."""
    sensors = (Sensor("joint_angle", "encoders"), Sensor("link_position", "tip", ("site:end_effector",)))
    system = build(deflection.guided, sensors, 64, joints=("yaw", "shoulder"), others=("elbow",))
    record = measurement_type(sensors, others=True)
    q = jnp.asarray(arm().home).at[2].set(1.4)
    tip = kinematics.forward(arm(), q, ("site:end_effector",)).position[0]
    params, key = system.default_params, jax.random.key(0)
    state = system.init(params, key=key)
    step = jax.jit(system.step, compiler_options=QUICK)
    evidence = []
    for valid in (True, False):
        there = Reading(tip, jnp.asarray(True)), Reading(jnp.array([1.4]), jnp.array([valid]))
        measurement = record(Reading(q[:2], jnp.ones(2, bool)), *there, jnp.asarray(0.02))
        evidence.append(float(step(params, state, measurement, key=key)[1].log_likelihood))
    assert evidence[0] > evidence[1] + 0.5
    found, _ = system.simulate(params, key=key, steps=2)
    assert found.others.value.shape == (2, 1)


@pytest.mark.parametrize(("prior", "walk"), [(0.1, 5.0), (0.0, 2.0), (40.0, 5.0), (3e5, 800.0)])
def test_the_first_step_knows_the_law_of_the_angles(prior, walk, dtype):
    """Encoders alone, the evidence of the first step by quadrature; even where the prior says nothing."""
    sensors = FEW[:1]
    system = build(deflection.guided, sensors, 2000)
    params = jax.tree.map(
        lambda x: jnp.asarray(x, dtype), system.default_params._replace(prior=prior, walk=walk, start=0.4)
    )
    read = np.array([0.9, -0.6, 2.9, 0.1]) if prior < 1 else 0.4 + np.array([0.1, -0.6, 0.3, 0.0])
    measurement = measurement_type(sensors)(
        Reading(jnp.asarray(read, dtype), jnp.ones(4, bool)), jnp.asarray(0.1, dtype)
    )
    step = jax.jit(system.step, compiler_options=QUICK)
    _, info = step(params, system.init(params, key=jax.random.key(1)), measurement, key=jax.random.key(1))
    grid = np.linspace(-np.pi, np.pi, 20_001)[:-1]

    def density(x, k):
        return np.exp(k * (np.cos(x) - 1)) / (2 * np.pi * i0e(k))

    # Noises of all three add on the circle: their Fourier coefficients multiply.
    waves = np.prod([np.fft.fft(density(grid, k)) for k in (prior, walk, 15.0)], axis=0)
    both = np.real(np.fft.ifft(waves)) * (grid[1] - grid[0]) ** 2
    both = np.interp(circle.wrap(read - 0.4), grid, both)  # three grids from -pi on: the sum's starts there, too
    exact = np.log(both).sum()
    share = float(info.ess) / 2000
    assert share > 0.9
    assert abs(float(info.log_likelihood) - exact) < 4.5 * np.sqrt((1 / share - 1) / 2000) + 5e-3


PLANAR = """<mujoco><worldbody><body name="one"><joint name="one" axis="0 0 1"/><geom size=".01"/>
<body name="two" pos=".5 0 0"><joint name="two" axis="0 0 1"/><geom size=".01"/><site name="tip" pos=".4 0 0"/></body>
</body></worldbody></mujoco>"""


def evidence_of_a_tip(tip, start, prior, walk, variance, points=720):
    """Density of where the tip of `PLANAR` is read at the first step, by quadrature over both angles."""
    grid = np.arange(points) * 2 * np.pi / points
    waves = [np.fft.fft(np.exp(k * (np.cos(grid) - 1)) / (2 * np.pi * i0e(k))) for k in (prior, walk)]
    law = np.real(np.fft.ifft(waves[0] * waves[1])) * (grid[1] - grid[0])
    one, two = np.meshgrid(grid + start, grid + start, indexing="ij")
    seen = np.stack([
        0.5 * np.cos(one) + 0.4 * np.cos(one + two), 0.5 * np.sin(one) + 0.4 * np.sin(one + two), 0 * one
    ], axis=-1)  # fmt: skip
    away = np.sum((tip - seen) ** 2, axis=-1) / variance
    density = np.exp(-away / 2) / (2 * np.pi * variance) ** 1.5
    return np.log(np.sum(density * law[:, None] * law[None]) * (grid[1] - grid[0]) ** 2)


@pytest.mark.parametrize(("particles", "curved"), [(128, False), pytest.param(100, True, marks=pytest.mark.slow)])
def test_an_unknown_start_without_encoders_is_found_in_all_its_postures(particles, curved):
    """Two postures have the tip there: evidence and score over 60 runs within 4.5 standard errors of quadrature."""
    sensors = (Sensor("link_position", "tip", ("site:tip",)),)
    propose = partial(deflection.guided, curved=curved)
    system = deflection.build(
        kinematics.load(mujoco.MjModel.from_xml_string(PLANAR)), sensors, particles=particles, proposal=propose
    )
    values = {"start": 0.4, "prior": 0.3, "walk": 400.0, "variance": 4e-4}
    tip = np.array([0.45, 0.35, 0.01])
    measurement = measurement_type(sensors)(Reading(jnp.asarray(tip, jnp.float32), jnp.asarray(True)), jnp.float32(0.1))

    def loss(values, key):
        params = system.default_params._replace(start=values["start"], prior=values["prior"], walk=values["walk"])
        own = params.sensors.tip._replace(variance=jnp.full(3, values["variance"]))
        params = jax.tree.map(jnp.float32, params._replace(sensors=params.sensors._replace(tip=own)))
        _, info = system.step(params, system.init(params, key=key), measurement, key=key)
        return info.log_likelihood, info.ess

    given = {name: jnp.float32(value) for name, value in values.items()}
    both = jax.jit(jax.vmap(jax.value_and_grad(loss, has_aux=True), (None, 0)), compiler_options=QUICK)
    (found, ess), score = both(given, jax.random.split(jax.random.key(5), 60))
    found = np.asarray(found, float)
    assert np.asarray(ess).mean() > 0.9 * particles
    ratio = np.exp(found - evidence_of_a_tip(tip, **values))
    assert ratio.std() < 0.05
    assert abs(ratio.mean() - 1) < 4.5 * ratio.std() / np.sqrt(59)
    for name, value in values.items():
        h = 1e-3 * value
        ends = [evidence_of_a_tip(tip, **{**values, name: value + way}) for way in (h, -h)]
        # Of the evidence, whose estimate has no bias: that of its logarithm has one of order 1 / particles.
        slopes = np.asarray(score[name], float) * ratio
        exact = (ends[0] - ends[1]) / (2 * h)
        assert abs(slopes.mean() - exact) < 4.5 * slopes.std() / np.sqrt(59)


def snake(joints):
    """A chain of light links whose joints bend by some degrees, with an IMU on every second link."""
    robot = kinematics.load(models.chain(joints))
    imus = [Sensor("link_orientation", f"imu{i}", (f"link{i}",)) for i in range(2, joints + 1, 2)]
    return robot, (Sensor("joint_angle", "encoders"), *imus)


@pytest.mark.slow
@pytest.mark.parametrize("joints", [8, 20])
def test_long_chains_keep_their_particles(joints):
    """IMUs on every second link: the share of particles, and the error beside that of encoders alone."""
    robot, sensors = snake(joints)
    carried = np.arange(joints, 0, -1)
    heaviest = 0.3 * 9.81 * 0.25 * carried**2 / 2  # N m, of the links stretched out: 0.3 kg and 0.25 m each
    faults = bending.Faults(compliance=np.minimum(0.033, 0.25 / heaviest))
    draw = partial(bending.simulate, robot, sensors, duration=1.5, rate_hz=20.0, faults=faults)
    measurements, truth = jax.jit(lambda key: draw(key=key), compiler_options=QUICK)(jax.random.key(4))
    system = deflection.build(robot, sensors, particles=256, proposal=deflection.guided)
    params, key = jax.tree.map(jnp.float32, system.default_params), jax.random.key(1)
    imus = {s.name: getattr(measurements, s.name) for s in sensors[1:]}
    blind = measurements._replace(**{n: r._replace(valid=jnp.zeros_like(r.valid)) for n, r in imus.items()})
    go = jax.jit(
        lambda m: run(system.step, params, system.init(params, key=key), m, key=key)[1], compiler_options=QUICK
    )
    errors = []
    for given in (measurements, blind):
        found = go(given)
        assert np.all(np.asarray(found.status) == 0)
        assert np.mean(np.asarray(found.ess)) > 0.7 * 256
        errors.append(np.sqrt(np.mean(np.asarray(circle.wrap(found.mean - truth.angles)) ** 2)))
    assert errors[0] < errors[1] / 2.5


def test_bad_names_are_told():
    with pytest.raises(InputError, match="frame 'site:imu4' does not exist; did you mean 'site:imu"):
        deflection.build(arm(), [Sensor("link_orientation", "imu", "site:imu4")])
    with pytest.raises(InputError, match="joint 'sholder' does not exist; did you mean 'shoulder'"):
        deflection.build(arm(), joints=["sholder"])
    with pytest.raises(InputError, match="estimated joint 'elbow' does not exist; known: yaw"):
        deflection.build(arm(), [Sensor("joint_angle", "a", ("elbow",))], joints=["yaw"])
    with pytest.raises(InputError, match="yaw named twice"):
        deflection.build(arm(), joints=["yaw", "yaw"])
    with pytest.raises(ValueError, match="particles: got 0"):
        deflection.build(arm(), particles=0)
    with pytest.raises(ValueError, match="key: got None"):
        build().init(build().default_params)
