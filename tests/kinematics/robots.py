"""Robots to test with, and MuJoCo's own answers for them."""

import logging

import mujoco
import numpy as np

from jaxest import models

# Baxter's arm is one more arm of seven hinges, and among the shared robots too.
PACKAGED = [*(name for name in models.names() if name not in ("baxter_left_arm", "sticks")), "chain7"]
SHARED = [
    "baxter.xml",
    "baxter_arm.urdf",
    "baxter_left_arm.urdf",
    "baxter_left_arm.xml",
    "humanoid/humanoid.xml",
    "iiwa.xml",
    "inspire_left_hand.xml",
    "panda.xml",
    "sawyer_arm.urdf",
    "ur5e.xml",
]
logging.getLogger("jaxest").setLevel(logging.ERROR)  # absent meshes are the normal case here


def source(name, shared=None):
    """Return what to load: a path below `shared` or a packaged robot."""
    if name in models.names():
        return models.path(name)
    if name.startswith("chain"):
        return models.chain(int(name.removeprefix("chain")))
    return shared / "robots" / name


def states(model, count, seed=0):
    """Draw configurations, quaternions normalised, (count, nq)."""
    q = np.random.default_rng(seed).uniform(-2.5, 2.5, (count, model.nq))
    for joint in range(model.njnt):
        start = model.jnt_qposadr[joint] + (3 if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE else 0)
        if model.jnt_type[joint] in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
            turn = q[:, start : start + 4]
            q[:, start : start + 4] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    return q


def answers(model, q, frames):
    """Return MuJoCo's positions, quaternions, Jacobians of some frames, and holding torques."""
    data = mujoco.MjData(model)
    positions, quaternions, jacobians, torques = [], [], [], []
    for state in q:
        data.qpos[:] = state
        data.qvel[:] = 0
        mujoco.mj_forward(model, data)
        sites = np.zeros((model.nsite, 4))
        for site in range(model.nsite):
            mujoco.mju_mat2Quat(sites[site], data.site_xmat[site])
        positions.append(np.concatenate([data.xpos[1:], data.site_xpos]))
        quaternions.append(np.concatenate([data.xquat[1:], sites]))
        torques.append(data.qfrc_bias.copy())
        jacobians.append([_jacobian(model, data, frame) for frame in frames])
    return np.array(positions), np.array(quaternions), np.array(jacobians), np.array(torques)


def _jacobian(model, data, frame):
    shift, turn = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    bodies = model.nbody - 1
    if frame < bodies:
        mujoco.mj_jacBody(model, data, shift, turn, frame + 1)
    else:
        mujoco.mj_jacSite(model, data, shift, turn, frame - bodies)
    return np.concatenate([turn, shift])


def distance(found, expected):
    """Return the largest norm-wise relative error over a batch, rows flattened."""
    found, expected = (np.asarray(x, float).reshape(len(x), -1) for x in (found, expected))
    scale = np.maximum(np.linalg.norm(expected, axis=1), 1e-3)
    return (np.linalg.norm(found - expected, axis=1) / scale).max()


def same_sign(found, expected):
    """Flip quaternions to the side of the expected ones."""
    return np.asarray(found, float) * np.where(np.sum(np.asarray(found) * expected, -1, keepdims=True) < 0, -1, 1)
