"""Dynamics against C MuJoCo and Pinocchio, norm-wise, on 1000 random states a robot; gradients; edge cases."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from quick_compile import QUICK
from robots import PACKAGED, SHARED, distance, source, states

from jaxest import kinematics, models
from jaxest.kinematics.load import compile_model
from jaxest.kinematics.sequence import sequence
from jaxest.types import InputError

STATES = 1000

# Two trees, one of which branches twice on every level: two registers; balls and slides on the way, and springs.
BUSH = """<mujoco><compiler angle="radian"/>
<default><joint damping="0.3" armature="0.02"/><geom type="box" size="0.1 0.04 0.03" mass="0.5"/></default>
<worldbody>{branches}<body pos="3 1 0"><freejoint/><geom/></body></worldbody></mujoco>"""


def bush(deepest=3):
    def branch(depth, side):
        kind = ('type="ball" stiffness="3"', 'axis="0 1 0" stiffness="2" springref="0.3"', 'type="slide" axis="1 0 1"')
        below = branch(depth + 1, 1) + branch(depth + 1, -1) if depth < deepest else ""
        return f'<body pos="0.2 {0.1 * side} 0.05"><joint {kind[depth % 3]}/><geom pos="0.1 0 0.02"/>{below}</body>'

    return BUSH.format(branches=branch(0, 1))


def theirs(model, q, v, a, tau):
    """Return MuJoCo's mass matrix, bias force, inverse dynamics, and accelerations without and with passive terms."""
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    springs = mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER
    data = mujoco.MjData(model)
    found = []
    for row in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:], data.qfrc_applied[:] = q[row], v[row], a[row], tau[row]
        mujoco.mj_forward(model, data)
        passive = data.qacc_smooth.copy()
        matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, matrix)
        bias = data.qfrc_bias.copy()
        model.opt.disableflags |= springs
        mujoco.mj_forward(model, data)
        smooth = data.qacc_smooth.copy()
        data.qacc[:] = a[row]
        mujoco.mj_inverse(model, data)
        model.opt.disableflags &= ~springs
        found.append((matrix, bias, data.qfrc_inverse.copy(), smooth, passive))
    return [np.array(part) for part in zip(*found, strict=True)]


def everything(robot, q, v, a, tau):
    return (
        kinematics.mass_matrix(robot, q),
        kinematics.bias_force(robot, q, v),
        kinematics.inverse_dynamics(robot, q, v, a),
        kinematics.forward_dynamics(robot, q, v, tau),
        kinematics.forward_dynamics(robot, q, v, tau, passive=True),
    )


def motions(model, count, seed):
    rng = np.random.default_rng(seed)
    return states(model, count, seed), *(s * rng.normal(size=(count, model.nv)) for s in (1, 3, 5))


ARMS = ("baxter_arm.urdf", "baxter_left_arm.urdf", "baxter_left_arm.xml", "iiwa.xml", "sawyer_arm.urdf", "ur5e.xml")
"""Chains of hinges, as panda.xml is."""
CASES = [
    pytest.param(
        name,
        dtype,
        marks=[pytest.mark.recorded] * (name in SHARED)
        + [pytest.mark.slow] * (name in (*ARMS[2:], "gripper") if dtype == "float64" else name != "panda.xml"),
    )
    for name in ["bush", *PACKAGED, *(n for n in SHARED if "hand" not in n)]
    for dtype in ("float64", "float32")
]


@pytest.mark.parametrize(("name", "dtype"), CASES)
def test_agrees_with_mujoco(name, dtype, x64, request):
    src = bush() if name == "bush" else source(name, request.getfixturevalue("shared") if name in SHARED else None)
    # MuJoCo has friction loss among its constraints, not in these accelerations; it has a test of its own.
    robot = dataclasses.replace(kinematics.load(src), friction_loss=np.zeros(kinematics.load(src).nv))
    model = compile_model(src)
    motion = motions(model, STATES, seed=5)
    expected = theirs(model, *motion)
    ours = jax.jit(jax.vmap(lambda *motion: everything(robot, *motion)), compiler_options=QUICK)
    found = ours(*(x.astype(dtype) for x in motion))
    assert {x.dtype for x in found} == {np.dtype(dtype)}
    for part, reference, what in zip(found, expected, ("M", "h", "inverse", "forward", "passive"), strict=True):
        assert distance(part, reference) < {"float64": 1e-11, "float32": 2e-5}[dtype], what
    np.testing.assert_array_equal(found[0], np.swapaxes(found[0], 1, 2))


def test_branches_that_need_registers():
    assert sequence(kinematics.load(bush()).topology).registers == 3
    assert sequence(kinematics.load(models.chain(9)).topology).registers == 0
    assert sequence(kinematics.load(models.path("rover")).topology).registers == 1


@pytest.mark.recorded
@pytest.mark.parametrize("name", [name for name in SHARED if name.endswith(".urdf")])
def test_agrees_with_pinocchio(name, shared, x64):
    pinocchio = pytest.importorskip("pinocchio")
    src = source(name, shared)
    robot = kinematics.load(src)
    model = pinocchio.buildModelFromUrdf(str(src))
    data = model.createData()
    q, v, a, tau = motions(compile_model(src), STATES, seed=6)
    order = [robot.joint_names.index(joint) for joint in model.names[1:]]
    expected = []
    for row in range(STATES):
        at, rate, wanted, torque = (x[row, order] for x in (q, v, a, tau))
        matrix = pinocchio.crba(model, data, at)
        matrix = np.triu(matrix) + np.triu(matrix, 1).T
        bias = pinocchio.nonLinearEffects(model, data, at, rate).copy()
        needed = pinocchio.rnea(model, data, at, rate, wanted).copy()
        expected.append((matrix, bias, needed, pinocchio.aba(model, data, at, rate, torque).copy()))
    ours = jax.jit(jax.vmap(lambda *motion: everything(robot, *motion)), compiler_options=QUICK)(q, v, a, tau)
    ours = [np.asarray(ours[0])[:, order][:, :, order], *(np.asarray(x)[:, order] for x in ours[1:4])]
    for part, reference in zip(ours, map(np.array, zip(*expected, strict=True)), strict=True):
        assert distance(part, reference) < 1e-11


def test_friction_loss_is_that_of_mujoco_while_joints_slide(x64):
    text = models.chain(3).replace('axis="', 'frictionloss="0.4" damping="0.1" axis="')
    robot, model = kinematics.load(text), compile_model(text)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v = rng.normal(size=3), 5 * rng.choice([-1, 1], 3)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_constraint, -0.4 * np.sign(v), rtol=1e-6)
        found = kinematics.forward_dynamics(robot, q, v, np.zeros(3), passive=True)
        np.testing.assert_allclose(found, data.qacc, rtol=1e-6)
    still = kinematics.passive_torque(robot, q, np.zeros(3))
    np.testing.assert_array_equal(still, np.zeros(3))


@pytest.mark.slow
def test_gradients_in_state_and_in_every_leaf(x64):
    src = bush(2)
    robot = kinematics.load(src)
    robot = dataclasses.replace(
        robot, home=np.zeros(robot.nq), limits=np.zeros((robot.nq, 2)), friction_loss=np.full(robot.nv, 0.2)
    )
    rng = np.random.default_rng(7)

    def value(arguments):
        robot, q, v, a, tau = arguments
        forward = kinematics.forward_dynamics(robot, q, v, tau, passive=True)
        inverse = kinematics.inverse_dynamics(robot, q, v, a)
        matrix = kinematics.mass_matrix(robot, q)
        return sum(jnp.vdot(part, weight) for part, weight in zip((forward, inverse, matrix), weights, strict=True))

    weights = [s * rng.normal(size=size) for s, size in ((1e-2, robot.nv), (1, robot.nv), (1, (robot.nv, robot.nv)))]
    arguments = (robot, *(x[0] for x in motions(compile_model(src), 1, seed=3)))
    gradient = jax.tree.leaves(jax.jit(jax.grad(value), compiler_options=QUICK)(arguments))
    value = jax.jit(value, compiler_options=QUICK)
    names = [str(path[-1]) for path, _ in jax.tree_util.tree_flatten_with_path(arguments)[0]]
    leaves, tree = jax.tree.flatten(arguments)
    assert all(np.isfinite(g).all() for g in gradient)
    moved = set()
    for k, leaf in enumerate(leaves):
        along = rng.normal(size=np.shape(leaf)) * (1e-2 if names[k] in (".body_inertia", ".armature") else 1)
        ahead, behind = (
            jax.tree.unflatten(tree, [*leaves[:k], leaf + s * along, *leaves[k + 1 :]]) for s in (1e-6, -1e-6)
        )
        expected = float(value(ahead) - value(behind)) / 2e-6
        found = float(np.vdot(gradient[k], along))
        assert found == pytest.approx(expected, rel=2e-6, abs=2e-5), names[k]
        if abs(found) > 1e-3:
            moved.add(names[k].removeprefix("."))
    assert {"body_mass", "body_com", "body_inertia", "body_position", "armature", "damping", "stiffness"} <= moved
    assert {"joint_axis", "gravity", "friction_loss", "spring_reference", "[1]", "[2]", "[3]", "[4]"} <= moved


@pytest.mark.slow
def test_second_derivatives_of_forward_dynamics(x64):
    robot = kinematics.load(models.chain(3))
    q, v, tau = np.random.default_rng(0).normal(size=(3, 3))

    def slope(q):
        return jax.jacrev(lambda q: kinematics.forward_dynamics(robot, q, v, tau))(q)

    found = jax.jit(jax.jacfwd(slope), compiler_options=QUICK)(q)
    along = np.array([0.3, -1.0, 0.5])
    slope = jax.jit(slope, compiler_options=QUICK)
    np.testing.assert_allclose(found @ along, (slope(q + 1e-6 * along) - slope(q - 1e-6 * along)) / 2e-6, atol=1e-6)


def test_a_thrown_body_keeps_its_angular_momentum(x64):
    text = (
        '<mujoco><worldbody><body><freejoint/><geom type="box" size=".3 .2 .1" mass="2"/></body></worldbody></mujoco>'
    )
    robot = kinematics.load(text)
    q = np.array([1e3, 2, 3, 0.5, 0.5, -0.5, 0.5])
    v = np.array([5.0, 6, 7, 1, 2, 3])
    found = kinematics.forward_dynamics(robot, q, v, np.zeros(6))
    spin = np.diag(robot.body_inertia[0])
    np.testing.assert_allclose(found[:3], [0, 0, -9.81], atol=1e-12)
    np.testing.assert_allclose(found[3:], -np.cross(v[3:], spin * v[3:]) / spin, atol=1e-12)


def test_far_from_the_origin_no_digit_is_lost():
    ours = jax.jit(everything, compiler_options=QUICK)
    near = kinematics.load(models.path("rover"))
    q = near.home.astype(np.float32)
    v = np.linspace(-1, 1, near.nv, dtype=np.float32)
    far = np.where(np.arange(near.nq) < 3, 1e6, q).astype(np.float32)
    for x, y in zip(ours(near, q, v, v, v), ours(near, far, v, v, v), strict=True):
        np.testing.assert_array_equal(x, y)
    arm = kinematics.load(models.chain(4))
    moved = kinematics.with_parameters(arm, position={"link1": (1e5, -2e5, 3e5)})
    q = v = v[:4]
    for x, y in zip(ours(arm, q, v, v, v), ours(moved, q, v, v, v), strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.mark.slow
def test_batches_agree_and_gradients_stay_finite(dtype):
    robot = kinematics.load(models.chain(5))
    q = np.random.default_rng(0).normal(size=(3, 5)).astype(dtype)
    batched = jax.jit(jax.vmap(lambda q: everything(robot, q, q, q, q)), compiler_options=QUICK)(q)
    single = jax.jit(lambda q: everything(robot, q, q, q, q), compiler_options=QUICK)(q[1])
    for part, one in zip(batched, single, strict=True):
        np.testing.assert_allclose(part[1], one, rtol=2000 * np.finfo(dtype).eps)
    rover = kinematics.load(models.path("rover"))
    still = jnp.zeros(rover.nq, dtype), *(jnp.zeros(rover.nv, dtype),) * 2

    def total(state):
        return kinematics.forward_dynamics(rover, *state, passive=True).sum()

    gradient = jax.jit(jax.grad(total), compiler_options=QUICK)(still)
    assert all(np.isfinite(g).all() for g in gradient)
    assert {g.dtype for g in gradient} == {dtype}


def test_wrong_shapes_and_robots_without_joints_or_inertias():
    robot = kinematics.load(models.path("rover"))
    with pytest.raises(ValueError, match=r"v: shape \(19,\), expected \(18,\); batch with jax.vmap"):
        kinematics.bias_force(robot, robot.home, np.zeros(19))
    with pytest.raises(ValueError, match=r"tau: shape \(\), expected \(18,\)"):
        kinematics.forward_dynamics(robot, robot.home, np.zeros(18), 0.0)
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
    bare = f'<robot name="r"><link name="a"/><link name="b"/>{joint}</robot>'
    with pytest.raises(InputError, match="no inertia for 1 moving bodies"):
        kinematics.mass_matrix(kinematics.load(bare), np.zeros(1))
    fixed = kinematics.load('<mujoco><worldbody><body><geom size=".1"/></body></worldbody></mujoco>')
    assert kinematics.mass_matrix(fixed, np.zeros(0)).shape == (0, 0)
    assert kinematics.forward_dynamics(fixed, np.zeros(0), np.zeros(0), np.zeros(0)).shape == (0,)
