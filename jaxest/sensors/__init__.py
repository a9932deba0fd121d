"""Sensors on a robot, one file each: how likely a reading is where the robot stands as it stands.

Each kind is a module with `Params`, `predict`, `log_prob`, `residual`, `rows` (the residual with its derivative, for
filters that look at the measurement before they draw) and `sample`, for one configuration; a reading that is not valid
counts exactly 0. `joint_angle` looks at hinges (n,), `slide_position` at slides, `link_orientation`, `link_position`,
`gravity_direction` and `end_effector_pose` at one frame, `relative_orientation` at two: what
`jaxest.kinematics.forward` gives for them.

`proximity` describes ranging sensors, which are compared with a map (`jaxest.systems.slam`).

`Sensor(kind, name, frames)` describes one on a robot, `measurement_type` what a step of several looks like, and
`check_params` and `check_measurements` find bad numbers on the host before anything runs.

Not here: filters of raw gyroscopes (`jaxest.filters`), estimators (`jaxest.systems`).
"""

from jaxest.sensors import (
    end_effector_pose,
    gravity_direction,
    joint_angle,
    link_orientation,
    link_position,
    relative_orientation,
    slide_position,
)
from jaxest.sensors.spec import KINDS, Sensor, check_measurements, check_params, default_params, measurement_type

__all__ = [
    "KINDS",
    "Sensor",
    "check_measurements",
    "check_params",
    "default_params",
    "end_effector_pose",
    "gravity_direction",
    "joint_angle",
    "link_orientation",
    "link_position",
    "measurement_type",
    "relative_orientation",
    "slide_position",
]
