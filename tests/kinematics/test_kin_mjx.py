"""The MJX backend against our own kinematics and C MuJoCo; rollouts, their gradients, and sensors."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from robots import source, states

from jaxest import kinematics, models
from jaxest.kinematics import mjx
from jaxest.kinematics.load import compile_model
from jaxest.types import InputError

QUICK = partial(jax.jit, compiler_options={**mjx.NO_FUSION, "xla_backend_optimization_level": 0})  # compiles quicker


@pytest.fixture(autouse=True)
def as_mjx_is_written():
    """Let MJX promote ranks, which its own code does."""
    with jax.numpy_rank_promotion("allow"):
        yield


@pytest.mark.parametrize("name", ["arm", pytest.param("rover", marks=pytest.mark.slow)])
def test_agrees_with_ours_and_with_c(name, x64):
    src = source(name)
    backend, robot, model = mjx.build(src), kinematics.load(src), compile_model(src)
    q = states(model, 1, seed=2)[0]
    v = np.random.default_rng(0).normal(size=model.nv)
    last = robot.frame_names[-1]

    @QUICK
    def theirs(q, v):
        poses, matrix = mjx.forward(backend, q), mjx.mass_matrix(backend, q)
        return poses, mjx.jacobian(backend, q, last), mjx.jacobian(backend, q, 2), matrix, mjx.bias_force(backend, q, v)

    frames, site, body, matrix, bias = theirs(q, v)
    ours = kinematics.forward(robot, q)
    np.testing.assert_allclose(frames.position, ours.position, atol=1e-12)
    dots = np.sum(np.asarray(frames.quaternion) * np.asarray(ours.quaternion), axis=1)
    np.testing.assert_allclose(np.abs(dots), 1, atol=1e-12)
    np.testing.assert_allclose(site, kinematics.jacobian(robot, q, last), atol=1e-12)
    np.testing.assert_allclose(body, kinematics.jacobian(robot, q, 2), atol=1e-12)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    np.testing.assert_allclose(matrix, full, atol=1e-10)
    np.testing.assert_allclose(bias, data.qfrc_bias, atol=1e-10)


def test_a_robot_without_inertias_has_no_dynamics_here_either():
    """The engine has stand-ins of 1 kg, which must not be taken for the robot's."""
    backend = mjx.build('<mujoco><worldbody><body name="a"><joint name="j"/></body></worldbody></mujoco>')
    state = mjx.State(jnp.zeros(1), jnp.zeros(1))
    for call in (
        lambda: mjx.mass_matrix(backend, state.q),
        lambda: mjx.bias_force(backend, *state),
        lambda: mjx.step(backend, state, jnp.zeros(1)),
    ):
        with pytest.raises(InputError, match=r"no inertia for 1 moving bodies \(a\)"):
            call()


ACCELEROMETER = '<sensor><accelerometer name="felt" site="imu3"/><gyro name="turn" site="imu3"/></sensor></mujoco>'


@pytest.mark.slow
def test_rollout_follows_c_and_its_gradient_finite_differences(x64):
    text = models.path("arm").read_text().replace("</mujoco>", ACCELEROMETER)
    backend, model = mjx.build(text, constraints=False), compile_model(text)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    torques = np.random.default_rng(0).normal(size=(10, model.nv))
    start = mjx.State(jnp.asarray(model.key_qpos[0]), jnp.zeros(model.nv))
    run = QUICK(lambda torques: mjx.rollout(backend, start, torques))
    found = run(torques)
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0]
    for step, torque in enumerate(torques):
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)  # leaves the sensors of the state before the step
        np.testing.assert_allclose(found.state.q[step], data.qpos, atol=1e-9)
        np.testing.assert_allclose(found.sensors["felt"][step], data.sensordata[:3], atol=1e-7)
        np.testing.assert_allclose(found.sensors["turn"][step], data.sensordata[3:], atol=1e-7)
    gradient = QUICK(jax.grad(lambda torques: mjx.rollout(backend, start, torques).state.q[-1].sum()))(torques)
    along = np.random.default_rng(1).normal(size=torques.shape)
    ahead, behind = (float(run(torques + s * along).state.q[-1].sum()) for s in (1e-5, -1e-5))
    assert float(np.vdot(gradient, along)) == pytest.approx((ahead - behind) / 2e-5, rel=1e-6)


def test_a_resting_arm_feels_one_g():
    text = models.path("arm").read_text().replace("</mujoco>", ACCELEROMETER)
    robot = kinematics.load(text)
    backend = mjx.build(text)
    held = kinematics.gravity_torque(robot, jnp.asarray(robot.home))
    state = mjx.State(jnp.asarray(robot.home, jnp.float32), jnp.zeros(robot.nv))
    _, sensors = mjx.jit(lambda state, torque: mjx.step(backend, state, torque))(state, held)
    assert np.linalg.norm(sensors["felt"]) == pytest.approx(9.81, rel=1e-3)


def test_what_mjx_lacks_is_named():
    with pytest.raises(InputError, match=r"MJX cannot simulate it: .*CYLINDER.*BOX"):
        mjx.build(models.path("arm"), contacts=True)


SCENE = """<mujoco><worldbody>
<geom type="box" size="0.1 1 1" pos="1 0 0.5"/><geom type="{kind}" name="pole" size="0.1 0.5" pos="-1 0.1 0.5"/>
<body pos="0 0 0.5"><joint axis="0 0 1"/><geom type="cylinder" size="0.05 0.05"/>
<site name="eye" euler="0 90 0" pos="0.1 0 0"/><site name="back" euler="0 -90 0" pos="-0.1 0 0"/></body>
</worldbody><sensor><rangefinder name="ahead" site="eye"/><rangefinder name="behind" site="back"/></sensor></mujoco>"""


def test_range_finders_read_what_those_of_c_read():
    """Nothing there has a material, which MJX's rays ask for; the sensor's own body is not seen."""
    text = SCENE.format(kind="capsule")
    backend, model = mjx.build(text), mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    look = QUICK(lambda q: mjx.step(backend, mjx.State(q, jnp.zeros(1)), jnp.zeros(1))[1])
    for angle in (0.1, -0.02, 1.5):
        data.qpos[:] = angle
        mujoco.mj_forward(model, data)
        found = look(jnp.array([angle]))
        np.testing.assert_allclose([found["ahead"][0], found["behind"][0]], data.sensordata, rtol=1e-5)
    with pytest.raises(InputError, match=r"range finders of MJX look through cylinders.*pole"):
        mjx.build(SCENE.format(kind="cylinder"))
