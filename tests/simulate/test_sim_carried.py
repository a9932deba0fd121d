"""IMUs that are carried about: what they read belongs to the motion, and motions are what their names say."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest.simulate import carried

PERFECT = carried.Sensor(0, 0, 0, 0, 0, 0)
HZ = 100.0


@pytest.mark.parametrize("name", list(carried.MOTIONS))
def test_perfect_readings_integrate_to_the_truth(name):
    rows, truth = carried.record(name, seed=3, seconds=20, rate_hz=HZ, sensor=PERFECT)
    turns = Rotation.from_rotvec(np.asarray(rows.gyroscope.value, float)[1:] / HZ)
    now = Rotation.from_quat(np.roll(truth.quaternion[0], -1))
    for turn in turns:
        now = now * turn
    last = Rotation.from_quat(np.roll(truth.quaternion[-1], -1))
    assert (last.inv() * now).magnitude() < 1e-4  # float32 readings
    path = Rotation.from_quat(np.roll(truth.quaternion, -1, axis=1))
    force = path.apply(np.asarray(rows.accelerometer.value, float)) - [0, 0, carried.GRAVITY]
    np.testing.assert_allclose(force, truth.acceleration, atol=1e-4)
    np.testing.assert_allclose(path.apply(np.asarray(rows.magnetometer.value, float)), len(path) * [carried.FIELD],
                               atol=1e-9)  # fmt: skip


def test_vehicles_are_fast_and_arms_stay():
    velocity = {}
    for name in ("vehicle", "arm"):
        _, truth = carried.record(name, seed=1, seconds=120, rate_hz=HZ, sensor=PERFECT)
        velocity[name] = np.linalg.norm(np.cumsum(truth.acceleration[:, :2], axis=0) / HZ, axis=1)
    assert velocity["vehicle"].max() > 5
    assert velocity["arm"].max() < 2.5


def test_seeds_differ_and_repeat():
    first, again, other = (carried.record("walk", seed=s, seconds=2)[0] for s in (1, 1, 2))
    np.testing.assert_array_equal(first.gyroscope.value, again.gyroscope.value)
    assert not np.allclose(first.gyroscope.value, other.gyroscope.value)
