"""Motions and sensors to try an estimator on before there is a log.

`trajectories.random_motion` moves a robot within its limits, `imu.record` tells what an IMU on one of its frames reads
meanwhile, with the truth beside it.
"""

from jaxest.simulate import imu, trajectories

__all__ = ["imu", "trajectories"]
