"""Robots and their kinematics: load a model once, then pure functions of `(robot, q)`.

Start with `load` (MJCF or URDF) and `forward`; then `jacobian`; the dynamics `gravity_torque`, `inverse_dynamics`,
`mass_matrix`, `bias_force`, `forward_dynamics`; `with_parameters` to change or tune a robot's numbers, `expand` for
coupled joints; `inverse_kinematics` for `Target`s, `fit_orientations` for measured orientations of links; `write` for a
file. Each function takes one configuration; batch it with `jax.vmap` and compile it with `jax.jit`. Chains of links are
scans, so that the batch stays fast for 4 to 50 joints, gradients included.

Not here: sensors on the robot (`jaxest.sensors`), estimation of its state (`jaxest.systems`).
"""

from jaxest.kinematics.dynamics import (
    bias_force,
    forward_dynamics,
    gravity_torque,
    inverse_dynamics,
    mass_matrix,
    passive_torque,
)
from jaxest.kinematics.forward import Frames, forward
from jaxest.kinematics.inverse import Solution, Target, inverse_kinematics, search_inverse_kinematics
from jaxest.kinematics.jacobian import jacobian
from jaxest.kinematics.joint_angles import hinge_angle, roll_pitch_yaw, since_zero
from jaxest.kinematics.load import load
from jaxest.kinematics.orientations import Fit, Observed, fit_orientations
from jaxest.kinematics.robot import Robot, Topology, expand, frame, with_parameters
from jaxest.kinematics.write import to_mjcf, to_urdf, write

__all__ = [
    "Fit",
    "Frames",
    "Observed",
    "Robot",
    "Solution",
    "Target",
    "Topology",
    "bias_force",
    "expand",
    "fit_orientations",
    "forward",
    "forward_dynamics",
    "frame",
    "gravity_torque",
    "hinge_angle",
    "inverse_dynamics",
    "inverse_kinematics",
    "jacobian",
    "load",
    "mass_matrix",
    "passive_torque",
    "roll_pitch_yaw",
    "search_inverse_kinematics",
    "since_zero",
    "to_mjcf",
    "to_urdf",
    "with_parameters",
    "write",
]
