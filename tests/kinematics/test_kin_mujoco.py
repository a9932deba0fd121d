"""Kinematics and gravity against C MuJoCo and Pinocchio, norm-wise, on 1000 random states a robot."""

import jax
import numpy as np
import pytest
from robots import PACKAGED, SHARED, answers, distance, same_sign, source, states

from jaxest import kinematics
from jaxest.kinematics.load import compile_model

STATES = 1000
NAMES = [*PACKAGED, *(pytest.param(name, marks=pytest.mark.recorded) for name in SHARED)]


@pytest.mark.parametrize("name", NAMES)
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
def test_agrees_with_pinocchio(name, shared, x64):
    pinocchio = pytest.importorskip("pinocchio")
    src = source(name, shared)
    robot = kinematics.load(src)
    model = pinocchio.buildModelFromUrdf(str(src))
    data, kind = model.createData(), pinocchio.FrameType.BODY
    q = np.random.default_rng(1).uniform(-2.5, 2.5, (STATES, robot.nq))
    order = [robot.joint_names.index(joint) for joint in model.names[1:]]
    assert model.nq == robot.nq
    shared_frames = [f for f, body in enumerate(robot.topology.body_names) if model.existFrame(body, kind)]
    last = shared_frames[-1]

    @jax.jit
    @jax.vmap
    def ours(q):
        frames = kinematics.forward(robot, q, shared_frames)
        return frames.position, kinematics.jacobian(robot, q, last), kinematics.gravity_torque(robot, q)

    positions, jacobians, torques = (np.asarray(x) for x in ours(q))
    for row, state in enumerate(q):
        theirs = state[order]
        pinocchio.framesForwardKinematics(model, data, theirs)
        expected = np.array([data.oMf[model.getFrameId(robot.frame_names[f], kind)].translation for f in shared_frames])
        assert distance(positions[row][None], expected[None]) < 1e-12
        if row % 50 == 0:
            frame_id = model.getFrameId(robot.frame_names[last], kind)
            shifted = pinocchio.computeFrameJacobian(model, data, theirs, frame_id, pinocchio.LOCAL_WORLD_ALIGNED)
            reordered = np.zeros_like(shifted)
            reordered[:, order] = np.concatenate([shifted[3:], shifted[:3]])
            assert distance(jacobians[row][None], reordered[None]) < 1e-12
            held = np.zeros(robot.nv)
            held[order] = pinocchio.computeGeneralizedGravity(model, data, theirs)
            assert distance(torques[row][None], held[None]) < 1e-11
