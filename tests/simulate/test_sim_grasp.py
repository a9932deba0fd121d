"""The gripper in MuJoCo: IMUs agree with its motion, contacts with the disk."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest import kinematics, models
from jaxest.simulate import grasp
from jaxest.simulate.imu import perfect


@pytest.fixture(scope="module")
def held():
    radius = 0.0415
    return radius, grasp.perform(grasp.Scene(radius, (0.0, grasp.DISKS[radius]), rest=0.4, close=1.0, hold=0.4))


def test_contacts_lie_on_the_disk(held):
    radius, found = held
    assert [c.link for c in found.contacts] == ["left_distal", "left_middle", "right_distal", "right_middle", "palm"]
    assert all(c.force > 0 for c in found.contacts)
    palm = found.contacts[-1].point
    assert abs(np.linalg.norm(palm[1:] - found.disk[1:]) - radius) < 2e-4  # MuJoCo's contacts are a little soft


def test_imus_feel_gravity_and_the_motion(held):
    _, found = held
    np.testing.assert_allclose(np.linalg.norm(found.specific_force[300], axis=1), 9.81, atol=0.02)
    # The rates, integrated through closing and the first impacts, lead to the orientations at the end.
    for k in range(7):
        turns = Rotation.from_rotvec((found.rate[400:-1, k] + found.rate[401:, k]) / 2 * 1e-3)
        now = Rotation.from_quat(found.quaternion[400, k], scalar_first=True)
        for turn in turns:
            now = now * turn
        off = now.inv() * Rotation.from_quat(found.quaternion[-1, k], scalar_first=True)
        assert np.rad2deg(off.magnitude()) < 1.0
    # Joints and IMUs are of one moment: the orientations are those of the kinematics.
    robot = kinematics.load(models.path("gripper"))
    for row in (700, 900, -1):
        seen = kinematics.forward(robot, found.q[row].astype("f"), grasp.SITES).quaternion
        same = np.abs(np.sum(np.asarray(seen) * found.quaternion[row], axis=1))
        assert np.rad2deg(2 * np.arccos(np.minimum(same, 1))).max() < 0.1


def test_measurements_are_the_truth_in_the_imus_axes(held):
    _, found = held
    turned = np.zeros((7, 3))
    turned[0] = [0, 0, np.pi / 2]
    plain = grasp.imus(found, perfect(), jax.random.key(0))
    other = grasp.imus(found, perfect(), jax.random.key(0), mounting=turned)
    np.testing.assert_allclose(plain.gyroscope.value, found.rate, atol=1e-6)
    x, y, _ = np.moveaxis(np.asarray(plain.accelerometer.value[:, 0]), -1, 0)
    np.testing.assert_allclose(other.accelerometer.value[:, 0, :2], np.stack([y, -x], -1), atol=1e-5)
    field = np.linalg.norm(np.asarray(plain.magnetometer.value), axis=-1)
    np.testing.assert_allclose(field, np.hypot(18e-6, 41e-6), rtol=1e-5)
