"""Attitude filters: the orientation of one IMU, with or without a magnetometer. All take `imu.Imu`.

| which | for |
|---|---|
| `ekf` | the most accurate online: error-state Kalman filter with gyro bias and scale, and honest covariance |
| `smooth` | recordings: the same model, forward and backward |
| `decoupled` | many filters at once: low-pass in the gyroscope's frame, heading and bias apart, ten times lighter |
| `madgwick` | gradient descent, as others use it |

Each file has `Params`, `State`, `Info`, `init` and `step`, driven by `jaxest.filters.run`; the passive complementary
filter is `jaxest.filters.complementary`. Not here: relative orientation of several IMUs.
"""

from jaxest.filters.attitude import decoupled, ekf, madgwick
from jaxest.filters.attitude.smoother import smooth

__all__ = ["decoupled", "ekf", "madgwick", "smooth"]
