"""A robot of modules: links from their IMUs, against the truth, through mountings; the manipulator in MuJoCo."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK

from jaxest import kinematics, models
from jaxest.filters import run
from jaxest.kinematics import modular
from jaxest.manifolds import quaternion as quat
from jaxest.manifolds import se3
from jaxest.simulate import imu, manipulator
from jaxest.systems import onsite_chain
from jaxest.systems.onsite_recording import Imu
from jaxest.types import InputError, Reading

RATE, SHORT = 85, 12.0


@pytest.fixture(scope="module")
def shaken():
    """The manipulator's two links, each shaken by itself for 12 s: final info, truth, system."""
    system = onsite_chain.build(manipulator.draw(3).assembly)
    params = jax.tree.map(lambda x: np.asarray(x, np.float32), system.default_params)
    draw = jax.jit(lambda key: system.simulate(params, key=key, steps=1200), compiler_options=QUICK)
    samples, truth = draw(jax.random.key(1))
    follow = jax.jit(lambda m: run(system.step, params, system.init(params), m)[1])
    return jax.tree.map(np.asarray, follow(samples)), jax.tree.map(np.asarray, truth)


def test_joints_are_found_through_the_mountings(shaken):
    info, truth = shaken
    away = info.position[-1] - truth.translation
    # Twice the standard deviations of the rod at 40 s, for the lever of the mountings, times (40 / 12)^(1/2).
    assert np.linalg.norm(away, axis=1).max() < 2.5e-3
    turn = jax.vmap(quat.local)(info.quaternion[-1], truth.rotation)
    assert np.linalg.norm(turn, axis=1).max() < 2.5e-3
    spread = 2 * np.sqrt(np.trace(info.covariance[-1][:, 3:, 3:], axis1=1, axis2=2))
    np.testing.assert_allclose(info.spread[-1][:, 1], spread, rtol=1e-5)


def test_it_stops_when_the_limits_have_held_for_a_second(shaken):
    info, _ = shaken
    done = int(np.argmax(info.done))
    assert info.done.any()
    near = (info.spread[..., 0] < np.deg2rad(0.1)).all(axis=1) & (info.spread[..., 1] < 0.005).all(axis=1) & info.valid
    assert near[done - 99 : done + 1].all()
    assert not info.done[: np.argmax(near) + 99].any()


def test_the_covariance_is_that_of_the_composed_pose(x64):
    """Moving IMU in IMU a little moves joint in joint as the covariance's factor says: T_front T T_rear^-1."""
    assembly = manipulator.draw(0).assembly
    front, rear = assembly.modules[1].after, assembly.modules[2].before
    random = np.random.default_rng(0)
    q, p = quat.normalize(random.normal(size=4)), random.normal(size=3)
    factor = random.normal(size=(6, 6))
    imus = onsite_chain.onsite.Info(p, q, factor @ factor.T, *[None] * 8)
    mounting = (front.rotation, front.translation, rear.rotation, rear.translation)
    position, quaternion, covariance = onsite_chain._joint_in_joint(imus, *map(jnp.asarray, mounting))

    def joint(d):
        moved = se3.Pose(quat.retract(q, d[:3]), p + d[3:])
        found = se3.compose(se3.compose(front, moved), se3.inverse(rear))
        return jnp.concatenate([quat.local(quaternion, found.rotation), found.translation])

    slope = jax.jacfwd(joint)(jnp.zeros(6))
    np.testing.assert_allclose(joint(jnp.zeros(6)), [0, 0, 0, *position], atol=1e-12)
    np.testing.assert_allclose(covariance, slope @ factor @ factor.T @ slope.T, rtol=1e-9, atol=1e-9)


@pytest.fixture(scope="module")
def swung():
    """One manipulator, perfect IMUs, swinging for 12 s."""
    sticks = manipulator.draw(1)
    return sticks, manipulator.swing(sticks, 1, seconds=SHORT, sensor=imu.perfect())


def test_the_simulation_is_one_robot(swung):
    """Rates of the two ends of a link are one rate, turned as the drawn link says."""
    sticks, recorded = swung
    for k in range(2):
        module, behind = sticks.assembly.modules[k + 1], sticks.assembly.modules[k + 2]
        truth = se3.compose(se3.compose(se3.inverse(module.after), sticks.links[k]), behind.before)
        a, p = (np.stack([np.interp(np.arange(1, 12, 0.01), recorded.time[k][e], column)
                          for column in recorded.gyroscope[k][e].T], axis=1) for e in (0, 1))  # fmt: skip
        turned = p @ np.asarray(quat.to_matrix(truth.rotation)).T
        assert np.sqrt(np.mean(a**2)) > 0.2
        assert np.sqrt(np.mean((turned - a) ** 2)) < 0.02 * np.sqrt(np.mean(a**2))
    assert set(recorded.swung) <= {0, 1, 2}
    rest = recorded.time[0][0] < manipulator.REST - 0.1
    np.testing.assert_allclose(recorded.gyroscope[0][0][rest][-50:], 0, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(recorded.accelerometer[1][1][rest][-50:], axis=1), 9.81, atol=0.01)


def test_the_packaged_sticks_are_the_simulated_ones(swung):
    """The file is one assembly as `manipulator` has it: every link and IMU where it was drawn."""
    sticks, _ = swung
    packaged = kinematics.load(models.path("sticks"))
    own = kinematics.load(manipulator.model(sticks))
    assert packaged.frame_names == own.frame_names
    q = np.array([0.3, -0.4, 0.7, 0.2])
    for one, other in zip(kinematics.forward(packaged, q), kinematics.forward(own, q), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_lost_packets_and_bad_sensors():
    sticks = manipulator.draw(2)
    recorded = manipulator.swing(sticks, 2, seconds=4.0)
    time = recorded.time[0][1]
    assert np.diff(time).max() > 1.5 / RATE  # some samples are lost
    assert np.diff(time).std() > 1e-4
    found, samples = onsite_chain.samples(
        [tuple(Imu(*(part[k][e] for part in recorded[:3])) for e in (0, 1)) for k in (0, 1)]
    )
    assert samples.gyroscope.value.shape == (len(found), 2, 2, 3)
    assert samples.gyroscope.valid.mean() > 0.97
    np.testing.assert_allclose(np.cumsum(samples.dt), found - found[0])


def test_a_ball_falls_into_the_box_and_beside_it():
    sticks = manipulator.draw(0)
    robot = modular.assemble(sticks.assembly, sticks.links)
    q = np.array([0.5, -0.3, 0.6, 0.3])
    target = np.asarray(kinematics.forward(robot, q, ["site:tool"]).position[0], float)
    box = target - [0, 0, manipulator.ABOVE + manipulator.BOX[2]]
    good = manipulator.drop(sticks, q, box)
    assert good.inside
    assert np.linalg.norm(good.gripper - target) < 0.01  # the servos' sag
    assert abs(good.ball[2] - box[2] - 0.01) < 0.003
    assert not manipulator.drop(sticks, q, np.add(box, [0.08, 0, 0])).inside


def test_rebuilding_needs_every_link(shaken):
    info, truth = shaken
    assembly = manipulator.draw(3).assembly
    final = jax.tree.map(lambda x: x[-1], info)
    robot = onsite_chain.rebuild(assembly, final)
    assert robot.joint_names == ("joint0", "joint1", "joint2", "joint3")
    known = modular.assemble(
        assembly, [modular.known(q, p) for q, p in zip(truth.rotation, truth.translation, strict=True)]
    )
    q = np.array([0.1, 0.4, -0.3, 0.2])
    apart = kinematics.forward(robot, q, ["site:tool"]).position - kinematics.forward(known, q, ["site:tool"]).position
    assert np.linalg.norm(apart) < 5e-3
    early = jax.tree.map(lambda x: x[5], info)
    with pytest.raises(
        InputError, match=r"the link from 'joint1' to 'joint2' is not determined: the rotation about \["
    ):
        onsite_chain.rebuild(assembly, early)


def test_bad_input():
    assembly = manipulator.draw(0).assembly
    with pytest.raises(InputError, match="all are known"):
        onsite_chain.build(assembly._replace(links=(modular.STILL,) * 3))
    system = onsite_chain.build(assembly)
    params = system.default_params
    bad = onsite_chain.Sample(
        Reading(np.zeros((3, 2, 3)), np.ones((3, 2), bool)), Reading(np.zeros((3, 2, 3)), True), 0.01
    )
    one = partial(system.step, params, system.init(params))
    with pytest.raises(ValueError, match=r"measurement: got shapes .* expected those of 2 links with two IMUs each"):
        one(bad)
    with pytest.raises(InputError, match="do not overlap"):
        t = np.arange(100) / 85
        still = Imu(t, np.zeros((100, 3)), np.zeros((100, 3)))
        onsite_chain.samples([(still, still._replace(time=t + 50))])
