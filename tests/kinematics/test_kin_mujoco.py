"""Kinematics and gravity against C MuJoCo and Pinocchio, norm-wise, on 1000 random states a robot."""

import jax
import numpy as np
import pytest
from robots import PACKAGED, SHARED, answers, distance, same_sign, source, states

from jaxest import kinematics
from jaxest.kinematics.load import compile_model

STATES = 1000
SINGLE = ("arm", "rover", "baxter.xml")
"""What is among the quick tests also in float32."""
CASES = [
    pytest.param(
        name,
        dtype,
        marks=[pytest.mark.recorded] * (name in SHARED)
        + [pytest.mark.slow] * (dtype == "float32" and name not in SINGLE),
    )
    for name in (*PACKAGED, *SHARED)
    for dtype in ("float32", "float64")
]


@pytest.mark.parametrize(("name", "dtype"), CASES, indirect=["dtype"])
def test_agrees_with_mujoco(name, dtype, request):
    src = source(name, request.getfixturevalue("shared") if name in SHARED else None)
    model = compile_model(src)
    robot = kinematics.load(src)
    count = len(robot.frame_names)
    frames = (count - 1, model.nbody - 2, count // 2)
    q = states(model, STATES)
    position, quaternion, jacobian, torque = answers(model, q, frames)

    @jax.jit
    @jax.vmap
    def ours(q):
        held = None if robot.topology.massless else kinematics.gravity_torque(robot, q)
        return kinematics.forward(robot, q), [kinematics.jacobian(robot, q, f) for f in frames], held

    found, jacobians, held = ours(q.astype(dtype))
    tolerance = 1e-12 if dtype == np.float64 else 1e-5
    assert found.position.dtype == found.quaternion.dtype == jacobians[0].dtype == dtype
    assert distance(found.position, position) < tolerance
    assert distance(same_sign(found.quaternion, quaternion), quaternion) < tolerance
    bodies = model.nbody - 1
    assert distance(found.quaternion[:, :bodies], quaternion[:, :bodies]) < tolerance  # the sign is MuJoCo's too
    for k in range(len(frames)):
        assert distance(jacobians[k], jacobian[:, k]) < tolerance
    if held is not None:
        assert distance(held, torque) < tolerance


@pytest.mark.recorded
@pytest.mark.parametrize("name", [name for name in SHARED if name.endswith(".urdf")])
def test_agrees_with_pinocchio(name, shared, dtype):
    pinocchio = pytest.importorskip("pinocchio")
    src = source(name, shared)
    robot = kinematics.load(src)
    model = pinocchio.buildModelFromUrdf(str(src))
    data, kind = model.createData(), pinocchio.FrameType.BODY
    q = np.random.default_rng(1).uniform(-2.5, 2.5, (STATES, robot.nq))
    order = [robot.joint_names.index(joint) for joint in model.names[1:]]
    assert model.nq == robot.nq
    same = [f for f, body in enumerate(robot.topology.body_names) if model.existFrame(body, kind)]
    ids = [model.getFrameId(robot.frame_names[f], kind) for f in same]

    @jax.jit
    @jax.vmap
    def ours(q):
        frames = kinematics.forward(robot, q, same)
        return frames.position, kinematics.jacobian(robot, q, same[-1]), kinematics.gravity_torque(robot, q)

    expected = []
    for state in q[:, order]:
        pinocchio.framesForwardKinematics(model, data, state)
        positions = np.array([data.oMf[i].translation for i in ids])
        jacobian = pinocchio.computeFrameJacobian(model, data, state, ids[-1], pinocchio.LOCAL_WORLD_ALIGNED)
        columns = np.zeros((6, robot.nv))
        columns[:, order] = np.concatenate([jacobian[3:], jacobian[:3]])
        held = np.zeros(robot.nv)
        held[order] = pinocchio.computeGeneralizedGravity(model, data, state)
        expected.append((positions, columns, held))
    tolerance = 1e-12 if dtype == np.float64 else 1e-5
    for found, wanted in zip(ours(q.astype(dtype)), map(np.array, zip(*expected, strict=True)), strict=True):
        assert found.dtype == dtype
        assert distance(found, wanted) < tolerance
