"""Joint torques: the model, the filter and the smoother, what the samplers are handed, and what is refused."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from quick_compile import QUICK

from jaxest import kinematics, models
from jaxest.filters import run
from jaxest.mcmc import twist
from jaxest.mcmc.model import Data, Unknown, linearize
from jaxest.systems import torque, torque_model, torque_sampler, torque_settings, torque_step
from jaxest.types import InputError

PENDULUM = """<mujoco><worldbody><body name="link"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.5"
size=".02" mass="1"/></body></worldbody></mujoco>"""
BARE = """<robot name="bare"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>
<child link="b"/><axis xyz="0 1 0"/></joint></robot>"""


@pytest.fixture(scope="module")
def arm():
    return kinematics.load(models.path("baxter_left_arm"))


@pytest.fixture(scope="module")
def pendulum():
    return kinematics.load(PENDULUM)


def drawn(robot, steps=20, **options):
    given = torque.default_params(robot)
    mean = jnp.concatenate([jnp.full(1, 0.5), jnp.zeros(1), jnp.full(1, 0.8)])
    given = given._replace(mean=mean, variance=given.variance.at[2].set(25.0))
    return given, *torque.simulate(given, key=jax.random.key(0), steps=steps, dt=0.02, **options)


def test_packaged_arm_moves_as_mujoco_says(arm, x64):
    model = mujoco.MjModel.from_xml_path(str(models.path("baxter_left_arm")))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(3):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = rng.normal(size=(3, 7))
        mujoco.mj_forward(model, data)
        found = kinematics.forward_dynamics(arm, data.qpos, data.qvel, data.qfrc_applied)
        np.testing.assert_allclose(found, data.qacc_smooth, rtol=1e-9)
    np.testing.assert_allclose(np.sum(model.body_mass), 19.71082, rtol=1e-6)


@pytest.mark.recorded
def test_packaged_arm_is_the_published_one(arm, shared, x64):
    other = kinematics.load(shared / "robots" / "baxter_left_arm.xml")
    rng = np.random.default_rng(1)
    q, v, tau = rng.normal(size=(3, 7))
    found, wanted = (kinematics.forward_dynamics(one, q, v, tau) for one in (arm, other))
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_float32_is_refused(pendulum):
    with jax.enable_x64(False), pytest.raises(ValueError, match="needs float64, JAX is set to float32"):
        torque.build(pendulum)


def test_one_step_is_the_papers_euler_step(pendulum, x64):
    x = jnp.array([0.4, -0.3, 0.9])
    ahead = torque.euler(pendulum, x, jnp.array([0.2]), jnp.asarray(0.01))
    a = kinematics.forward_dynamics(pendulum, x[:1], x[1:2], jnp.array([1.1]))
    np.testing.assert_allclose(ahead, [0.4 - 0.003, -0.3 + 0.01 * float(a[0]), 0.9], rtol=1e-12)


def test_the_filter_finds_a_constant_torque(pendulum, x64):
    given, measurements, truth = drawn(pendulum, 200)
    system = torque.build(pendulum)
    start = given._replace(mean=given.mean.at[2].set(0.0))
    state, info = run(system.step, start, system.init(start), measurements)
    assert np.all(np.asarray(truth.torque) == 0.8)
    sd = float(jnp.sqrt(state.covariance[2, 2]))
    assert sd < 0.1
    assert abs(float(state.mean[2]) - 0.8) < 4 * sd
    assert info.mean.shape == (200, 3)


@pytest.mark.slow  # compiles for a minute; the collapsed likelihood's gradient stands in for it
def test_marginal_likelihood_is_differentiable(pendulum, x64):
    given, measurements, _ = drawn(pendulum, 10)

    def value(logs, payload):
        robot = kinematics.with_parameters(pendulum, payload={"link": (payload, jnp.array([0, 0, -0.5]))})
        noise = jnp.exp(logs)
        params = given._replace(robot=robot, position=noise[:1], velocity=noise[1:2], sensor=noise[2:])
        return jnp.sum(torque.smooth(params, measurements, iterations=8).log_likelihood)

    at = (jnp.log(jnp.array([2e-7, 3e-7, 4e-7])), jnp.zeros(()))
    both = jax.jit(jax.value_and_grad(value, (0, 1)), compiler_options=QUICK)
    slopes, slope = both(*at)[1]
    step = 1e-4
    for i in range(3):
        up, down = (both(at[0].at[i].add(s), at[1])[0] for s in (step, -step))
        np.testing.assert_allclose(slopes[i], (up - down) / (2 * step), rtol=1e-6, atol=1e-6)
    up, down = (both(at[0], at[1] + s)[0] for s in (step, -step))
    np.testing.assert_allclose(slope, (up - down) / (2 * step), rtol=1e-5, atol=1e-5)


def test_collapsed_likelihood_is_differentiable(pendulum, x64):
    _, measurements, _ = drawn(pendulum, 10)
    model = torque_model.constant(1)
    data = torque.data_of(measurements)
    prior = torque.paper_prior(jnp.array([0.5]), 1)
    path = torque_sampler.first_path(data, prior, model)
    first = Unknown(jnp.zeros(1), jnp.full(3, 2e-7))
    linear = twist.fit_path(model, pendulum, prior, data, first, jnp.asarray(path))

    @jax.jit
    @jax.value_and_grad
    def value(logs):
        given = twist.backward(model, prior, data, linear, jnp.exp(logs))
        return twist.collapse(prior, linear, given).log_evidence

    at = jnp.log(jnp.array([2e-7, 3e-7, 4e-7]))
    _, slopes = value(at)
    for i in range(3):
        up, down = (value(at.at[i].add(s))[0] for s in (1e-4, -1e-4))
        np.testing.assert_allclose(slopes[i], (up - down) / 2e-4, rtol=1e-6, atol=1e-6)


def test_a_reachable_motion_stays_reachable(arm, x64):
    setting = torque_settings.named("reachable")
    scene = torque_settings.scene(arm, setting, key=jax.random.key(3), missing=0.1)
    low, high = np.asarray(arm.limits).T
    assert np.all((scene.truth.angles > low[None]) & (scene.truth.angles < high[None]))
    assert np.abs(scene.truth.velocity).max() < 3
    assert 0.05 < 1 - np.asarray(scene.data.valid).mean() < 0.15
    torque.check_prior(scene.prior, scene.data, jnp.asarray(torque_settings.TORQUE))


def test_pieces_and_missing_steps(pendulum, x64):
    _, measurements, _ = drawn(pendulum, 12)
    hidden = measurements.joints.value.at[4].set(jnp.nan)
    data = torque.data_of(measurements._replace(joints=measurements.joints._replace(value=hidden)), segments=3)
    assert not data.valid[4, 0]
    assert np.isfinite(data.value).all()
    assert data.inputs.segment.tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2]
    model = torque_model.constant(1, 3)
    one = model.transition(
        pendulum, jnp.array([0.0, 5.0, 0.0]), jnp.array([0.3, 0.0]), jax.tree.map(lambda x: x[5], data.inputs)
    )
    other = torque.euler(pendulum, jnp.array([0.3, 0.0, 5.0]), jnp.zeros(1), jnp.asarray(0.02))
    np.testing.assert_allclose(one, other[:2], rtol=1e-12)
    with pytest.raises(InputError, match="expected times that rise"):
        torque.data_of(measurements._replace(dt=measurements.dt.at[3].set(0.0)))
    with pytest.raises(InputError, match=r"dt is 199 s at row 3, expected at most 0.05 s"):
        torque.data_of(measurements._replace(dt=measurements.dt.at[3].set(199.0)))


def test_priors_that_cannot_be_are_refused(pendulum, x64):
    _, measurements, _ = drawn(pendulum)
    data = torque.data_of(measurements)
    good = torque.paper_prior(jnp.array([0.5]), 1)
    torque.check_prior(good, data)
    with pytest.raises(InputError, match="lies outside the prior, 0 to 50"):
        torque.check_prior(good, data, jnp.array([-1.0]))
    with pytest.raises(InputError, match="expected low < high"):
        torque.check_prior(torque.paper_prior(jnp.array([0.5]), 1, low=60.0), data)
    with pytest.raises(InputError, match="expected a prior that covers the start"):
        torque.check_prior(torque.paper_prior(jnp.array([0.6]), 1), data)


def test_a_step_that_is_too_long_is_refused_with_one_that_is_not(arm, x64):
    x = jnp.concatenate([jnp.asarray(torque_settings.FALLING), jnp.zeros(7), jnp.asarray(torque_settings.TORQUE)])
    torque_settings.check_step(arm, x, 0.01, 1.0)
    long = torque_settings.named("paper")._replace(dt=0.05, steps=40)
    with pytest.raises(InputError, match="explicit Euler blows up within 2 s"):
        torque_settings.scene(arm, long, key=jax.random.key(0))
    with pytest.raises(InputError, match=r"explicit Euler blows up within 2 s .* the largest safe step is about 0\.0"):
        torque_settings.check_step(arm, x, 0.05, 2.0)


def test_a_series_whose_steps_are_too_long_is_refused(x64):
    """A damped joint, D / I = 40 / s: Euler's steps of it are stable up to 2 I / D = 0.05 s."""
    damped = kinematics.load(PENDULUM.replace('axis="0 1 0"', 'axis="0 1 0" damping="3.343"'))
    model = torque_model.constant(1, 1, True)
    inertia = float(kinematics.mass_matrix(damped, jnp.zeros(1))[0, 0])

    def series(dt, steps=60):
        inputs = torque_model.Inputs(
            jnp.full(steps - 1, dt), jnp.zeros((steps - 1, 1)), jnp.zeros(steps - 1, jnp.int32)
        )
        data = Data(jnp.full((steps, 1), 0.5), jnp.ones((steps, 1), bool), inputs)
        path = jnp.stack([jnp.full(steps, 0.5), jnp.full(steps, 0.3)], axis=1)
        prior = torque.paper_prior(jnp.array([0.5]), 1)
        return data, linearize(model, damped, prior, data, path, jnp.zeros(1))

    limit = 2 * inertia / 3.343
    torque_step.check_series(model, damped, *series(0.9 * limit))
    with pytest.raises(InputError, match="the largest safe step is about") as caught:
        torque_step.check_series(model, damped, *series(1.5 * limit))
    largest = float(str(caught.value).split()[-2])
    assert 0.8 * limit < largest < 1.1 * limit


def test_robots_without_inertia_or_with_free_joints_are_refused(x64):
    bare = kinematics.load(BARE)
    with pytest.raises(InputError, match="inertia"):
        torque.build(bare)
    with pytest.raises(InputError, match="expected hinges and slides only"):
        torque.build(kinematics.load(models.path("rover")))
    with pytest.raises(InputError, match="setting 'papr' does not exist; did you mean 'paper'"):
        torque_settings.named("papr")
    with pytest.raises(InputError, match="sampler 'gibs' does not exist"):
        torque_sampler.sampler("gibs", torque_model.constant(1))
