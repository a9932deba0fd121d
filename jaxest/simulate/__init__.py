"""Motions and sensors to try an estimator on before there is a log.

`trajectories.random_motion` moves a robot within its limits, `imu.record` tells what an IMU on one of its frames reads
meanwhile, with the truth beside it, `deflection.simulate` what
encoders, IMUs and markers on a robot say that bends.
"""

from jaxest.simulate import deflection, grasp, imu, trajectories

__all__ = ["deflection", "grasp", "imu", "trajectories"]
