"""Robots of modules and sticks stand where their parts are."""

import numpy as np
import pytest

from jaxest import kinematics
from jaxest.kinematics import modular
from jaxest.kinematics.modular import Assembly, Module, known
from jaxest.types import InputError

TURN = np.array([np.cos(0.3), 0, 0, np.sin(0.3)])  # 0.6 rad about z
IMU = known(translation=[0.02, 0, 0.01])


def arm(**changes):
    modules = (Module("a", None, IMU, axis=(0, 0, 1)), Module("b", IMU, IMU, limits=(-1, 2)), Module("c", IMU))
    links = (None, known(TURN, [0.3, 0, 0]))
    return Assembly(modules, links, known(translation=[0, 0, 0.5]), known(translation=[0.1, 0, 0]))._replace(**changes)


def test_the_robot_is_its_parts(x64):
    assembly = arm()
    assert assembly.unknown == (0,)
    robot = modular.assemble(assembly, [known(translation=[0.2, 0.1, 0])])
    assert robot.joint_names == ("a", "b", "c")
    np.testing.assert_allclose(robot.limits[1], [-1, 2])
    q = np.array([0.4, 0.0, 0.0])
    found = kinematics.forward(robot, q, ["b_horn", "c_horn", "site:tool", "site:b_before", "site:b_after"])
    c, s = np.cos(0.4), np.sin(0.4)
    r = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    b = [0, 0, 0.5] + r @ [0.2, 0.1, 0]
    along = r @ [np.cos(0.6), np.sin(0.6), 0]
    expected = [
        b,
        b + r @ [0.3, 0, 0],
        b + r @ [0.3, 0, 0] + 0.1 * along,
        b + r @ [0.02, 0, 0.01],
        b + r @ [0.02, 0, 0.01],
    ]
    np.testing.assert_allclose(found.position, expected, atol=1e-12)
    # A joint moves what is behind it and not its housing.
    moved = kinematics.forward(robot, np.add(q, [0, 0.7, 0]), ["b_horn", "site:tool", "site:b_before", "site:b_after"])
    np.testing.assert_allclose(moved.position[2], found.position[3], atol=1e-12)
    assert np.linalg.norm(moved.position[3] - found.position[4]) > 0.01


def test_it_goes_to_files_and_back(tmp_path, x64):
    robot = modular.assemble(arm(), [known(translation=[0.2, 0.1, 0])])
    q = np.array([0.3, 0.8, -0.4])
    for name, site in (("robot.xml", "site:tool"), ("robot.urdf", "tool")):
        kinematics.write(robot, tmp_path / name)
        found = kinematics.load(tmp_path / name)
        there = kinematics.forward(found, q, [site]).position
        np.testing.assert_allclose(there, kinematics.forward(robot, q, ["site:tool"]).position, atol=1e-9)


def test_what_makes_no_robot():
    with pytest.raises(InputError, match="links: got 1 for 3 modules"):
        modular.check(arm(links=(None,)))
    with pytest.raises(InputError, match=r"module 'a': has no IMU after the joint, so that the link from 'a' to 'b'"):
        modular.check(arm(modules=(Module("a"), *arm().modules[1:])))
    with pytest.raises(InputError, match=r"module 'b': has no IMU before the joint"):
        modular.check(arm(modules=(arm().modules[0], Module("b"), Module("c"))))
    with pytest.raises(InputError, match="all different"):
        modular.check(arm(modules=(arm().modules[0],) * 3))
    with pytest.raises(InputError, match=r"links: got 0, expected 1, those that are not known"):
        modular.assemble(arm())
    with pytest.raises(InputError, match="limits"):
        modular.check(arm(modules=(Module("a", None, IMU, limits=(1, 1)), *arm().modules[1:])))
