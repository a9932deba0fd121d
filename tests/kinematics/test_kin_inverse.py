"""Inverse kinematics: share of reachable poses solved, limits, several targets, every kind of joint, statuses."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK
from robots import source

from jaxest import kinematics, models
from jaxest.kinematics import Target
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, InputError

ARMS = [
    ("ur5e.xml", "right_hand", 250),
    pytest.param("ur5e.xml", "right_hand", 1000, marks=pytest.mark.slow),
    pytest.param("baxter.xml", "left_hand", 1000, marks=pytest.mark.slow),
    pytest.param("panda.xml", "right_hand", 1000, marks=pytest.mark.slow),
    pytest.param("iiwa.xml", "right_hand", 1000, marks=pytest.mark.slow),
    pytest.param("baxter.xml", "right_hand", 1000, marks=pytest.mark.slow),
]


def reachable(robot, name, count, seed=0):
    """Draw poses of a frame within the limits."""
    q = np.random.default_rng(seed).uniform(*np.clip(robot.limits, -np.pi, np.pi).T, (count, robot.nq))
    frames = jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q, (name,))), compiler_options=QUICK)(q)
    return frames.position[:, 0], frames.quaternion[:, 0]


def solved(robot, name, solution, position, rotation, tolerance=1e-6):
    """Judge solutions by forward kinematics and the limits, not by what they say of themselves."""
    frames = jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q, (name,))), compiler_options=QUICK)(solution.q)
    shift = np.linalg.norm(frames.position[:, 0] - position, axis=1)
    turn = 2 * np.arccos(np.clip(np.abs(np.sum(frames.quaternion[:, 0] * rotation, axis=1)), 0, 1))
    chord = np.linalg.norm(
        frames.quaternion[:, 0] * np.sign(np.sum(frames.quaternion[:, 0] * rotation, 1, keepdims=True)) - rotation,
        axis=1,
    )
    turn = np.minimum(turn, 2 * chord + (chord > 0.1))  # the arccosine resolves 1e-8 only
    q = np.asarray(solution.q)
    inside = ((q >= robot.limits[:, 0] - 1e-12) & (q <= robot.limits[:, 1] + 1e-12)).all(axis=1)
    return (shift < tolerance) & (turn < tolerance) & inside


@pytest.mark.recorded
@pytest.mark.parametrize(("file", "name", "poses"), ARMS)
def test_share_of_reachable_poses_solved(file, name, poses, shared, x64):
    robot = kinematics.load(source(file, shared))
    position, rotation = reachable(robot, name, poses)

    def one(position, rotation):
        return kinematics.inverse_kinematics(robot, {name: Target(position, rotation)}, robot.home)

    found = jax.jit(jax.vmap(one), compiler_options=QUICK)(position, rotation)
    ok = solved(robot, name, found, position, rotation)
    assert ok.mean() >= 0.90
    np.testing.assert_array_equal(ok, (found.position_error < 1e-6) & (found.rotation_error < 1e-6))
    assert ok[np.asarray(found.status) == OK].all()  # the default tolerance is finer
    assert (found.status == OK).mean() >= 0.90

    def sixteen(position, rotation, key):
        return kinematics.search_inverse_kinematics(robot, {name: Target(position, rotation)}, robot.home, key=key)

    keys = jax.random.split(jax.random.key(0), poses)
    found = jax.jit(jax.vmap(sixteen), compiler_options=QUICK)(position, rotation, keys)
    assert solved(robot, name, found, position, rotation).mean() >= 0.995


def test_a_mobile_robot_with_balls_slides_and_coupled_joints_meets_two_targets(x64):
    robot = kinematics.load(models.path("rover"))
    home = jnp.asarray(robot.home)
    rng = np.random.default_rng(1)
    free = home[np.array(robot.topology.free)]
    goal = kinematics.expand(
        robot, free.at[:7].add(0.2 * rng.normal(size=7)).at[9:].add(0.05 * rng.normal(size=len(free) - 9))
    )
    wanted = kinematics.forward(robot, goal, ("left_tip", "site:head_imu"))
    targets = {
        "left_tip": Target(wanted.position[0], wanted.quaternion[0]),
        "site:head_imu": Target(wanted.position[1]),
    }
    found = jax.jit(lambda t: kinematics.inverse_kinematics(robot, t, home, restarts=0), compiler_options=QUICK)(
        targets
    )
    assert found.status == OK
    reached = kinematics.forward(robot, found.q, tuple(targets))
    np.testing.assert_allclose(reached.position, wanted.position, atol=1e-7)
    assert abs(reached.quaternion[0] @ wanted.quaternion[0]) == pytest.approx(1, abs=1e-14)
    np.testing.assert_allclose(kinematics.expand(robot, found.q[np.array(robot.topology.free)]), found.q, atol=1e-12)
    np.testing.assert_allclose(jnp.linalg.norm(found.q[3:7]), 1, atol=1e-12)
    still = [robot.joint_names.index(name) for name in ("left_wheel", "right_wheel")]  # they move neither frame
    at = np.array([robot.topology.joint_q[j] for j in still])
    np.testing.assert_array_equal(found.q[at], home[at])


def test_statuses_weights_and_limits(dtype):
    robot = kinematics.load(models.path("arm"))
    home = robot.home.astype(dtype)
    tip = "site:end_effector"
    near = kinematics.forward(robot, home + np.asarray(0.1, dtype), (tip,)).position[0]
    position = jnp.stack([near, jnp.asarray([3.0, 0, 0.5], dtype), jnp.asarray([jnp.nan, 0, 0], dtype)])
    many = jax.vmap(lambda p: kinematics.inverse_kinematics(robot, {tip: Target(p)}, home))
    found = jax.jit(many, compiler_options=QUICK)(position)
    np.testing.assert_array_equal(found.status, [OK, NOT_CONVERGED, NON_FINITE])
    assert found.q.dtype == dtype
    assert np.isfinite(found.q[:2]).all()
    q = np.asarray(found.q[:2], float)
    assert ((q >= robot.limits[:, 0] - 1e-6) & (q <= robot.limits[:, 1] + 1e-6)).all()
    # Out of reach, the tip comes as close as the arm is long: it points at the target.
    frames = kinematics.forward(robot, found.q[1], ("link1", tip)).position
    assert found.position_error[1] == pytest.approx(np.linalg.norm(frames[1] - position[1]), rel=1e-4)
    assert found.position_error[0] < (1e-7 if dtype == np.float64 else 2e-5)


def test_a_coupled_joint_beyond_its_limits_is_no_solution():
    robot = kinematics.load(
        '<mujoco><compiler angle="radian"/><worldbody><body><joint name="a" axis="0 0 1"/><geom size=".1"/><body>'
        '<joint name="b" axis="0 0 1" range="-.5 .5"/><geom size=".1"/><site name="tip" pos="1 0 0"/></body></body>'
        '</worldbody><equality><joint joint1="b" joint2="a" polycoef="0 0 1 0 0"/></equality></mujoco>'
    )

    @partial(jax.jit, compiler_options=QUICK)
    def status(turn):
        target = Target(jnp.stack([jnp.cos(turn + turn**2), jnp.sin(turn + turn**2), jnp.zeros_like(turn)]))
        q0 = jnp.stack([turn, turn**2])
        return kinematics.inverse_kinematics(robot, {"site:tip": target}, q0, restarts=0).status

    assert [status(0.6), status(1.2)] == [OK, NOT_CONVERGED]


def test_a_heavier_target_is_met_closer(x64):
    robot = kinematics.load(models.chain(3))

    def ends(weight):
        targets = {
            "link3": Target(jnp.array([0.3, 0.3, 0.0]), position_weight=weight),
            "link2": Target(jnp.array([0.0, -0.2, 0.1])),
        }
        found = kinematics.inverse_kinematics(robot, targets, np.array([0.3, 0.2, 0.1]), restarts=0)
        reached = kinematics.forward(robot, found.q, ("link3",)).position[0]
        return jnp.linalg.norm(reached - targets["link3"].position), found.status

    distance, status = jax.jit(jax.vmap(ends), compiler_options=QUICK)(jnp.array([0.1, 1.0, 10.0]))
    assert distance[0] > 1.5 * distance[1] > 2 * distance[2]
    np.testing.assert_array_equal(status, NOT_CONVERGED)


def test_bad_arguments():
    robot = kinematics.load(models.path("arm"))
    goal = Target(np.zeros(3))
    with pytest.raises(InputError, match="frame 'hnad' does not exist; did you mean 'hand'"):
        kinematics.inverse_kinematics(robot, {"hnad": goal}, robot.home)
    with pytest.raises(ValueError, match="targets: none given"):
        kinematics.inverse_kinematics(robot, {}, robot.home)
    with pytest.raises(ValueError, match=r"targets\['hand'\].quaternion: shape \(3,\), expected \(4,\)"):
        kinematics.inverse_kinematics(robot, {"hand": Target(np.zeros(3), np.zeros(3))}, robot.home)
    with pytest.raises(ValueError, match=r"q: shape \(3,\), expected \(4,\)"):
        kinematics.inverse_kinematics(robot, {"hand": goal}, np.zeros(3))
    with pytest.raises(ValueError, match="starts: 0, expected at least 1"):
        kinematics.search_inverse_kinematics(robot, {"hand": goal}, robot.home, key=jax.random.key(0), starts=0)
