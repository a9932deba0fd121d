"""Derivatives in q and in the robot's own leaves against finite differences; batches, precision, edge cases."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK
from robots import source, states

from jaxest import kinematics, models
from jaxest.kinematics.load import compile_model
from jaxest.types import InputError

ROBOTS = [
    "arm",
    pytest.param("rover", marks=pytest.mark.slow),
    pytest.param("panda.xml", marks=[pytest.mark.recorded, pytest.mark.slow]),
]

MATTER = ("body_position", "body_quaternion", "body_mass", "body_com", "joint_axis", "joint_reference", "gravity")


def everything(robot, q):
    """One number that depends on all poses and the gravity torque."""
    parts = (*kinematics.forward(robot, q), kinematics.gravity_torque(robot, q))
    return sum(jnp.sum(jnp.sin(part + 0.3 * jnp.arange(part.size).reshape(part.shape))) for part in parts)


def direction(tree, seed):
    """Draw a direction of every leaf's shape."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda x: rng.normal(size=np.shape(x)), tree)


@pytest.mark.parametrize("name", ROBOTS)
def test_gradient_in_q_and_in_every_leaf(name, x64, request):
    src = source(name, request.getfixturevalue("shared") if name.endswith(".xml") else None)
    robot = kinematics.load(src)
    robot = dataclasses.replace(robot, **dict.fromkeys(("home", "limits"), 0.0))  # infinite, and used by nothing here
    q = states(compile_model(src), 1, seed=3)[0]
    value = jax.jit(everything, compiler_options=QUICK)
    found_robot, found_q = jax.jit(jax.grad(everything, argnums=(0, 1)), compiler_options=QUICK)(robot, q)
    step = 1e-6
    along = direction(q, 0)
    expected = float(value(robot, q + step * along) - value(robot, q - step * along)) / (2 * step)
    assert float(np.vdot(found_q, along)) == pytest.approx(expected, rel=1e-6, abs=1e-7)
    for field in dataclasses.fields(robot):
        leaf = getattr(robot, field.name)
        if field.name == "topology" or np.size(leaf) == 0:
            continue
        along = direction(leaf, 1)
        ahead = dataclasses.replace(robot, **{field.name: leaf + step * along})
        behind = dataclasses.replace(robot, **{field.name: leaf - step * along})
        expected = float(value(ahead, q) - value(behind, q)) / (2 * step)
        found = float(np.vdot(getattr(found_robot, field.name), along))
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-7), field.name
        if field.name in MATTER:
            assert abs(found) > 1e-4, field.name


def test_forward_mode_reverse_mode_and_hessian_agree(x64):
    robot = kinematics.load(models.path("rover"))
    q = jnp.asarray(states(compile_model(models.path("rover")), 1)[0])

    def position(q):
        return kinematics.forward(robot, q, ("palm", "site:head_imu")).position.ravel()

    back_of = jax.jit(jax.jacrev(position), compiler_options=QUICK)
    ahead, back = jax.jit(jax.jacfwd(position), compiler_options=QUICK)(q), back_of(q)
    np.testing.assert_allclose(ahead, back, atol=1e-13)
    along = direction(q, 5)
    step = 1e-5
    curvature = (back_of(q + step * along) - back_of(q - step * along)) / (2 * step)
    _, found = jax.jit(lambda q, v: jax.jvp(jax.jacrev(position), (q,), (v,)), compiler_options=QUICK)(
        q, jnp.asarray(along)
    )
    np.testing.assert_allclose(found, curvature, atol=1e-8)


def test_derivative_of_positions_is_the_geometric_jacobian(x64):
    robot = kinematics.load(models.chain(12))
    q = jnp.asarray(np.random.default_rng(0).normal(size=12))
    found = jax.jacrev(lambda q: kinematics.forward(robot, q, ("link12",)).position[0])(q)
    np.testing.assert_allclose(found, kinematics.jacobian(robot, q, "link12")[3:], atol=1e-13)


def test_a_batch_of_robots_with_payloads_and_offsets(x64):
    robot = kinematics.load(models.path("arm"))
    q = jnp.asarray([0.3, 1.0, 0.5, -0.2])
    masses = jnp.asarray([0.0, 0.5, 1.0])

    def held(mass):
        loaded = kinematics.with_parameters(robot, payload={"hand": (mass, (0.0, 0.0, 0.08))})
        return kinematics.gravity_torque(loaded, q)

    torques = jax.vmap(held)(masses)
    np.testing.assert_allclose(torques[0], kinematics.gravity_torque(robot, q), atol=1e-12)
    lever = kinematics.jacobian(robot, q, "site:end_effector")[5]  # how the payload's height changes
    np.testing.assert_allclose(torques[2] - torques[0], 9.81 * lever, atol=1e-12)
    np.testing.assert_allclose(jax.jacfwd(held)(0.5), 9.81 * lever, atol=1e-12)

    def reach(offset):  # of a body that is fixed to its parent
        moved = kinematics.with_parameters(robot, position={"hand": offset, "site:imu2": (0.0, 0.0, 0.0)})
        return kinematics.forward(moved, q, ("site:end_effector", "site:imu2")).position

    turn = jax.jacfwd(reach)(jnp.asarray([0.0, 0.0, 0.28]))
    np.testing.assert_allclose(turn[0].T @ turn[0], np.eye(3), atol=1e-12)
    link = kinematics.forward(robot, q, ("link2",)).position[0]
    np.testing.assert_allclose(reach(jnp.asarray([0.0, 0.0, 0.28]))[1], link)


def test_payload_adds_up_as_mujoco_does(x64):
    loaded = kinematics.with_parameters(kinematics.load(models.path("arm")), payload={"hand": (0.4, (0.01, 0.02, 0.1))})
    text = models.path("arm").read_text()
    assert '<site name="end_effector"' in text
    ball = '<geom type="sphere" size="1e-3" pos="0.01 0.02 0.1" mass="0.4"/><site name="end_effector"'
    expected = kinematics.load(text.replace('<site name="end_effector"', ball))
    index = expected.topology.body_names.index("hand")
    np.testing.assert_allclose(loaded.body_mass, expected.body_mass, rtol=1e-12)
    np.testing.assert_allclose(loaded.body_com, expected.body_com, atol=1e-12)
    np.testing.assert_allclose(
        loaded.body_inertia[index], expected.body_inertia[index], atol=1e-6
    )  # the ball has a little


@pytest.mark.parametrize("dtype", ["float32", pytest.param("float64", marks=pytest.mark.slow)], indirect=True)
def test_jit_vmap_and_eager_agree_and_trace_once(dtype):
    robot = kinematics.load(models.path("rover"))
    q = states(compile_model(models.path("rover")), 4).astype(dtype)
    traces = []

    @jax.jit
    def both(q):
        traces.append(None)
        return kinematics.forward(robot, q), kinematics.jacobian(robot, q, "palm")

    single = [both(state) for state in q]
    assert len(traces) == 1
    stacked = jax.tree.map(lambda *x: np.stack(x), *single)
    batched = jax.vmap(both)(q)
    eager = kinematics.forward(robot, q[0]), kinematics.jacobian(robot, q[0], "palm")
    eps = np.finfo(dtype).eps
    for a, b, c in zip(*map(jax.tree.leaves, (stacked, batched, eager)), strict=True):
        assert a.dtype == dtype
        np.testing.assert_allclose(a, b, atol=40 * eps)
        np.testing.assert_allclose(a[0], c, atol=40 * eps)


def test_float32_stays_float32_with_x64_on(x64):
    robot = kinematics.load(models.path("rover"))
    q = jnp.asarray(robot.home, jnp.float32)
    found = kinematics.forward(robot, q), kinematics.jacobian(robot, q, 3), kinematics.gravity_torque(robot, q)
    assert {x.dtype for x in jax.tree.leaves(found)} == {np.dtype("float32")}


@pytest.mark.parametrize("angle", [0.0, 1e-4, 3.0, 50.0, 1e4, 1e6])
def test_large_and_small_angles_in_float32(angle):
    robot = kinematics.load(models.chain(1))
    q = np.float32([angle])
    quaternion = np.asarray(kinematics.forward(robot, q, (0,)).quaternion[0], float)
    half = float(q[0]) / 2
    error = np.abs(quaternion[[0, 3]] - [np.cos(half), np.sin(half)]).max()
    assert error < 3e-7 + np.finfo(np.float32).eps * angle  # the rounding of the angle itself


@pytest.mark.parametrize("dtype", ["float32", pytest.param("float64", marks=pytest.mark.slow)], indirect=True)
def test_a_zero_quaternion_is_no_rotation_and_has_a_finite_gradient(dtype):
    robot = kinematics.load(models.path("rover"))
    q = jnp.zeros(robot.nq, dtype)
    value, gradient = jax.value_and_grad(lambda q: kinematics.forward(robot, q).position.sum())(q)
    assert np.isfinite(value)
    assert np.isfinite(gradient).all()


def test_expand_fills_coupled_joints(x64):
    robot = kinematics.load(models.path("rover"))
    free = jnp.asarray(robot.home)[np.array(robot.topology.free)]
    np.testing.assert_allclose(kinematics.expand(robot, free), robot.home, atol=1e-7)
    leader = robot.topology.joint_q[robot.joint_names.index("left_finger")]
    follower = robot.topology.joint_q[robot.joint_names.index("left_tip")]
    slope = jax.jacfwd(lambda x: kinematics.expand(robot, x))(free)[follower, robot.topology.free.index(leader)]
    assert slope == pytest.approx(0.5 + 2 * 0.1 * 0.2)
    with pytest.raises(ValueError, match=r"free: shape \(3,\), expected \(18,\)"):
        kinematics.expand(robot, jnp.zeros(3))


def test_wrong_shapes_and_names():
    robot = kinematics.load(models.path("arm"))
    with pytest.raises(ValueError, match=r"q: shape \(5,\), expected \(4,\); batch with jax.vmap"):
        kinematics.forward(robot, np.zeros(5))
    with pytest.raises(ValueError, match="frames: index 99, expected 0 to 8"):
        kinematics.forward(robot, np.zeros(4), (99,))
    with pytest.raises(ValueError, match=r"frames: got 'hand', expected a sequence .*such as \['hand'\]"):
        kinematics.forward(robot, np.zeros(4), "hand")
    with pytest.raises(InputError, match="frame 'site:imu4' does not exist; did you mean 'site:imu"):
        kinematics.frame(robot, "site:imu4")
    with pytest.raises(InputError, match="body 'hnad' does not exist; did you mean 'hand'"):
        kinematics.with_parameters(robot, mass={"hnad": 1.0})
    assert kinematics.forward(robot, np.zeros(4), ()).position.shape == (0, 3)
