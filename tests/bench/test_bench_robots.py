"""Benchmarks of robots run, and time what they say they time."""

import jax
import numpy as np
import pytest
from quick_compile import QUICK

from jaxest import bench, kinematics, models
from jaxest.bench.robots import subject, tips
from jaxest.bench.rollouts import mujoco_rollout, simulated


@pytest.mark.slow
@pytest.mark.parametrize("peers", [True, False])
def test_dynamics(peers):
    with jax.numpy_rank_promotion("allow"):  # MJX promotes ranks
        found = list(bench.rows("dynamics", peers=peers, small=True))
    assert all(row.value > 0 for row in found)
    metrics = {row.metric for row in found}
    assert {"forward dynamics", "gradient of forward dynamics", "inverse dynamics", "mass matrix", "rollout"} <= metrics
    beside = {row.reference_name for row in found if row.metric == "rollout"}
    assert beside == ({"mujoco.rollout on 2 threads", "MJX, without fusion emitters"} if peers else {None})


def test_simulations_are_those_of_mujoco(x64):
    pytest.importorskip("mujoco.rollout")
    arm = subject("chain of 3", models.chain(3), 4, peers=False)
    q, v = jax.jit(jax.vmap(simulated(arm, 5)), compiler_options=QUICK)(arm.q, arm.v, arm.tau)
    theirs = mujoco_rollout(arm, 5)()
    np.testing.assert_allclose(q, theirs[:, :, 1:4], atol=1e-12)
    np.testing.assert_allclose(v, theirs[:, :, 4:7], atol=1e-11)
    assert np.abs(q[:, -1] - arm.q).max() > 1e-3


def test_states_of_a_robot_and_its_reading_by_pinocchio():
    pinocchio = pytest.importorskip("pinocchio")
    arm = subject("chain of 4", models.chain(4), 5, peers=True)
    assert arm.q.shape == arm.v.shape == arm.tau.shape == (5, 4)
    data = arm.pinocchio.createData()
    found = pinocchio.aba(arm.pinocchio, data, arm.q[0], arm.v[0], arm.tau[0])
    with jax.enable_x64(True):
        ours = kinematics.forward_dynamics(arm.robot, arm.q[0], arm.v[0], arm.tau[0])
    np.testing.assert_allclose(ours, found, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("peers", [True, False])
def test_inverse_kinematics(peers):
    found = list(bench.rows("inverse_kinematics", peers=peers, small=True))
    shares = [row for row in found if row.metric == "poses solved within limits"]
    assert len(shares) >= 3
    assert all(0 <= row.value <= 100 for row in shares)
    assert all(row.value > 0 for row in found if row.metric in ("inverse kinematics", "compile"))


def test_tips_of_arms():
    assert tips(kinematics.load(models.chain(4))) == ["link4"]
    two = models.chain(7).replace("</worldbody>", "{}</worldbody>")
    other = (
        models.chain(6).split("<worldbody>")[1].split("</worldbody>")[0].replace("link", "left").replace("joint", "j")
    )
    assert tips(kinematics.load(two.format(other.replace("<j ", "<joint ")))) == ["link7", "left6"]
