"""Motions and sensors to try an estimator on before there is a log.

`trajectories.random_motion` moves a robot within its limits, `imu.record` tells what an IMU on one of its frames reads
meanwhile, with the truth beside it, `deflection.simulate` what encoders, IMUs and markers on a robot say that bends.
`along.readings` says what an IMU reads on a motion that is known at samples only. `rooms` and `proximity` put a
structure with ranging sensors into a room and cast their rays through MuJoCo; `boxes` does it in JAX. `manipulator` is
an arm of modules and sticks with their IMUs, `grasp` a gripper that closes on a disk.
"""

from jaxest.simulate import along, boxes, deflection, grasp, imu, manipulator, proximity, rooms, trajectories

__all__ = ["along", "boxes", "deflection", "grasp", "imu", "manipulator", "proximity", "rooms", "trajectories"]
