"""Robots written as MJCF and URDF are the robots that were written."""

import dataclasses

import numpy as np
import pytest
from robots import SHARED, source

from jaxest import kinematics, models
from jaxest.kinematics.urdf_frames import matrix, roll_pitch_yaw, turned
from jaxest.types import InputError

TREES = ["baxter.xml", "baxter_left_arm.urdf", "iiwa.xml", "panda.xml", "sawyer_arm.urdf", "ur5e.xml"]


def same(found, robot):
    """Equal in every number, to rounding, and in every name."""
    assert dataclasses.replace(found.topology, notes=(), name="") == dataclasses.replace(
        robot.topology, notes=(), name=""
    )
    for field in dataclasses.fields(robot):
        if field.name != "topology":
            a, b = (np.asarray(getattr(each, field.name)) for each in (found, robot))
            if "quaternion" in field.name:
                a, b = (x * np.sign(x[:, :1] + (x[:, :1] == 0)) for x in (a, b))
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12, err_msg=field.name)


@pytest.mark.parametrize("name", [*models.names(), "chain5"])
def test_mjcf_holds_every_number(name):
    robot = kinematics.load(source(name))
    same(kinematics.load(kinematics.to_mjcf(robot)), robot)


@pytest.mark.recorded
@pytest.mark.parametrize("name", SHARED)
def test_mjcf_of_other_peoples_robots(name, shared):
    robot = kinematics.load(source(name, shared))
    found = kinematics.load(kinematics.to_mjcf(robot))
    # MuJoCo diagonalises inertias anew.
    same(dataclasses.replace(found, body_inertia=robot.body_inertia), robot)
    scale = np.abs(robot.body_inertia).max()
    np.testing.assert_allclose(found.body_inertia, robot.body_inertia, atol=1e-9 * scale)


def stands_alike(robot, text, coordinates):
    """Frames of a URDF are where the robot's are, for coordinates (n, nq) and at gravity's torque."""
    found = kinematics.load(text)
    assert found.joint_names == robot.joint_names
    names = [n.removeprefix("site:") for n in robot.frame_names]
    names = [n if n not in names[:i] else f"{n}_site" for i, n in enumerate(names)]
    for q in coordinates:
        a, b = kinematics.forward(robot, q), kinematics.forward(found, q, names)
        np.testing.assert_allclose(b.position, a.position, atol=1e-9)
        np.testing.assert_allclose(np.abs(np.sum(a.quaternion * b.quaternion, axis=1)), 1, atol=1e-12)
    np.testing.assert_allclose(found.limits, robot.limits)
    if not robot.topology.massless:
        np.testing.assert_allclose(kinematics.gravity_torque(found, q), kinematics.gravity_torque(robot, q), atol=1e-8)


@pytest.mark.parametrize("name", ["arm", "chain5"])
def test_urdf_stands_as_the_robot_does(name, x64):
    robot = kinematics.load(source(name))
    stands_alike(robot, kinematics.to_urdf(robot), np.random.default_rng(0).uniform(-2, 2, (3, robot.nq)))


@pytest.mark.recorded
@pytest.mark.parametrize("name", TREES)
def test_urdf_of_other_peoples_robots(name, shared, x64):
    robot = kinematics.load(source(name, shared))
    q = np.random.default_rng(1).uniform(-1, 1, (2, len(robot.topology.free)))
    stands_alike(robot, kinematics.to_urdf(robot), [np.asarray(kinematics.expand(robot, x)) for x in q])


HARD = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
<body name="a" pos="0 0 1" quat="0.5 0.5 -0.5 0.5"><joint name="turn" axis="1 2 3" ref="0.4" range="-1 2"/>
<geom size="0.1"/><body name="b" pos="0.1 0 0"><joint name="push" type="slide" axis="0 1 0" ref="0.2" range="-1 1"/>
<geom size="0.1"/><site name="b" pos="0 0 0.1" quat="0 1 0 0"/>
<body name="c" pos="0 0.2 0"><joint name="slave" axis="0 0 1"/><geom size="0.1"/></body></body></body></worldbody>
<equality><joint joint1="slave" joint2="turn" polycoef="0.3 -2 0 0 0"/></equality></mujoco>"""


def test_references_slides_and_mimics(x64):
    robot = kinematics.load(HARD)
    same(kinematics.load(kinematics.to_mjcf(robot)), robot)
    free = np.array([[0.3, -0.2], [1.0, 0.5]])
    text = kinematics.to_urdf(robot)
    stands_alike(robot, text, [np.asarray(kinematics.expand(robot, x)) for x in free])
    found = kinematics.load(text)
    np.testing.assert_allclose(kinematics.expand(found, free[0]), kinematics.expand(robot, free[0]), atol=1e-12)


def test_what_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match=r"moves by .* expected at most one hinge or slide"):
        kinematics.to_urdf(kinematics.load(models.path("rover")))
    robot = kinematics.load(models.chain(2))
    away = dataclasses.replace(robot, joint_anchor=np.add(robot.joint_anchor, [[0, 0, 0], [0, 0, 0.1]]))
    with pytest.raises(InputError, match=r"body 'link2': its joint is at 0.0 0.0 0.1 in it, expected at its origin"):
        kinematics.to_urdf(away)
    with pytest.raises(InputError, match=r"expected a name that ends in \.xml, \.mjcf, \.urdf"):
        kinematics.write(robot, tmp_path / "robot.txt")
    with pytest.raises(InputError, match="not linear"):
        kinematics.to_urdf(kinematics.load(HARD.replace("0.3 -2 0", "0.3 -2 1")))
    for name in ("robot.xml", "robot.urdf"):
        kinematics.write(robot, tmp_path / name)
        assert kinematics.load(tmp_path / name).joint_names == robot.joint_names


def test_roll_pitch_yaw_also_straight_up():
    random = np.random.default_rng(3)
    for q in [*random.normal(size=(50, 4)), [1, 0, 1, 0], [1, 0, -1, 0], [1, 1, 1, 1]]:
        r = matrix(np.array(q, float))
        roll, pitch, yaw = roll_pitch_yaw(r)
        back = turned(np.eye(3)[2], yaw) @ turned(np.eye(3)[1], pitch) @ turned(np.eye(3)[0], roll)
        np.testing.assert_allclose(back, r, atol=1e-8)
