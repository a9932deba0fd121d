"""What a sensor's readings must be corrected by, found from a recording; on the host, in float64.

Start with `imu_static.calibrate` (a rest found by itself: gyro bias and noise), then `ellipsoid.fit` on slow turns
(accelerometer or magnetometer: scale, skew of the axes, bias), `alignment.align` for what that leaves open; `imu` does
all of it, applies it and keeps it in a file. `tumble.calibrate` is for what slow turning cannot tell: the gyro's scale,
and how both sensors' axes lie in the case. `clock.offset` is for two IMUs on one link, `mounting` finds the axes of
joints and how sensors sit on their links, `circle` fits one to points. Each says how well it knows, and refuses where
the recording does not tell.

Not here: estimators that find such things along with the motion (`jaxest.filters`, `jaxest.systems`).
"""

from jaxest.calibration import alignment, circle, clock, ellipsoid, imu, imu_static, mounting, tumble

__all__ = ["alignment", "circle", "clock", "ellipsoid", "imu", "imu_static", "mounting", "tumble"]
