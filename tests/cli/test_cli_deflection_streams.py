"""What of a log's encoders reaches the deflection filter."""

import numpy as np

from jaxest import kinematics, models
from jaxest.cli.methods import deflection_joints, deflection_streams
from jaxest.cli.methods.deflection_config import sensors
from jaxest.io import SensorLog, Stream

JOINTS = ("yaw", "shoulder", "elbow", "gripper")
SETTINGS = {
    "sensors": {
        "encoders": {"kind": "joint_angle", "stream": "joint_position"},
        "tip": {"kind": "link_position", "stream": "tip/position", "frame": "site:imu3"},
    }
}


def test_an_encoder_that_is_missing_takes_no_other_with_it():
    """Nor does one that is missing now and then; what is hardly ever there is told."""
    read = np.tile([0.3, 0.7, 0.65, -0.2], (20, 1))
    read[:, 3], read[5, 1] = np.nan, np.nan
    tip = np.zeros((20, 3))
    tip[:15, 2] = np.nan
    log = SensorLog({"joint_position": Stream(np.arange(20) / 50, read, "rad", names=JOINTS),
                     "tip/position": Stream(np.arange(20) / 50, tip, "m")})  # fmt: skip
    robot = kinematics.load(models.path("arm"))
    joints = deflection_joints.chosen(robot, SETTINGS)
    described = [deflection_streams.on_robot(log, robot, joints, one) for one in sensors(SETTINGS)]
    steps, recorded, notes = deflection_streams.measurements(log, robot, joints, described, "missing")
    assert len(steps.time) == 20
    np.testing.assert_array_equal(recorded.encoders.valid, np.isfinite(read))
    np.testing.assert_array_equal(recorded.encoders.value, np.nan_to_num(read).astype(np.float32))
    np.testing.assert_array_equal(recorded.tip.valid, np.arange(20) >= 15)
    assert notes[:2] == ["encoders, gripper: 20 of 20 rows are missing", "tip: 15 of 20 rows are missing"]
    known = deflection_streams.reference(described, recorded, joints)
    np.testing.assert_array_equal(np.isfinite(known), np.isfinite(read))
