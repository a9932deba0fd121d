"""Robots and their kinematics: load a model once, then pure functions of `(robot, q)`.

Start with `load` (MJCF or URDF) and `forward`; then `jacobian`, `gravity_torque`, `with_parameters` to change or tune
a robot's numbers, `expand` for coupled joints. Each function takes one configuration; batch it with `jax.vmap` and
compile it with `jax.jit`. Chains of links are scans, so that the batch stays fast for 4 to 50 joints, gradients
included.

Not here: sensors on the robot (`jaxest.sensors`), estimation of its state (`jaxest.systems`).
"""

from jaxest.kinematics.dynamics import gravity_torque
from jaxest.kinematics.forward import Frames, forward
from jaxest.kinematics.jacobian import jacobian
from jaxest.kinematics.load import load
from jaxest.kinematics.robot import Robot, Topology, expand, frame, with_parameters

__all__ = [
    "Frames",
    "Robot",
    "Topology",
    "expand",
    "forward",
    "frame",
    "gravity_torque",
    "jacobian",
    "load",
    "with_parameters",
]
