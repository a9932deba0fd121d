"""`jaxest estimate --method posture`: what may be wrong with a config for a person's arm."""

import re

import jax
import numpy as np
import pytest

from jaxest import kinematics, models
from jaxest.io import SensorLog, Stream, write
from jaxest.systems import posture

SITES = ("imu_trunk", "imu_upper_arm", "imu_forearm", "imu_hand")
HZ, STEPS = 40.0, 200


@pytest.fixture(scope="module")
def arm():
    """A log of an arm that moves for 10 s, with its joints, and the robot."""
    robot = kinematics.load(models.path("human_arm"))
    system = posture.build(robot, [f"site:{name}" for name in SITES], magnetic=True)
    params = jax.tree.map(np.float32, system.default_params)
    measurements, truth = system.simulate(params, key=jax.random.key(4), steps=STEPS, rate_hz=HZ)
    time = np.arange(STEPS) / HZ
    streams = {}
    units = {"gyroscope": "rad/s", "accelerometer": "m/s2", "magnetometer": "T"}
    for kind, unit in units.items():
        value = np.asarray(getattr(measurements, kind).value, float)
        streams |= {f"{name}/{kind}": Stream(time, value[:, k], unit) for k, name in enumerate(SITES)}
    names = robot.joint_names[1:]
    streams["joints"] = Stream(time, np.asarray(truth.q, float)[:, 4:], "rad", names=names)
    return SensorLog(streams), names


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ('[posture.imus]\nimu_trunk = "chest"', r"\[posture.imus\] imu_trunk.*'chest'"),
        ('[posture]\nfilter = "efk"', "did you mean 'ekf'"),
        ("[posture]\nzero_posture = [2.0, 1.0]", "expected two times in s"),
        ("[posture]\nzero_posture = [1.0, 3.0]", "imu_trunk moves in|imu_upper_arm moves in"),
        ('[posture.imus]\nbelt = "trunk"', "belt"),
    ],
)
def test_wrong_configs_are_named(refused, arm, tmp_path, config, message):
    write(arm[0], tmp_path / "log.npz")
    (tmp_path / "c.toml").write_text(config)
    words = ("estimate", "log.npz", "-m", "posture", "--robot", models.path("human_arm"), "-c", "c.toml", "-o", "out")
    said = refused(*words)
    assert re.search(message, said.replace("\n", " ")), said


def test_a_robot_is_needed(refused, arm, tmp_path):
    write(arm[0], tmp_path / "log.npz")
    assert "needs a robot: --robot FILE" in refused("estimate", "log.npz", "-m", "posture", "-o", "out")
