"""Recursive estimators, each one step written for one item, and the driver that scans them.

Start with `run`: it drives every estimator over T measurements and keeps what `full`, `last` or `every(k)` ask for.
An estimator is a file: parameters, state, measurement and `init` / `step` live there; batches are the caller's `vmap`.
`imu` is the measurement of one IMU, `complementary` gives its orientation, `complementary_covariance` how well that is
known, `pair` the rotation between two IMUs. `attitude` holds more accurate filters of one IMU, and a smoother. `kalman`
makes both of any model on a product manifold.

`savitzky_golay` smooths and differentiates on real time stamps, `bingham_linear` finds the rotation between two gyros,
`rls` solves for three unknowns as observations come. `particle` follows any noise and any likelihood with particles,
which `resampling` chooses.

Not here: sensors and robots (a filter is handed functions), and complete estimators for a robot, which are in
`jaxest.systems`.
"""

from jaxest.filters import (
    attitude,
    bingham_linear,
    complementary,
    complementary_covariance,
    imu,
    kalman,
    pair,
    particle,
    resampling,
    rls,
    savitzky_golay,
)
from jaxest.filters.run import Every, Last, Sampled, every, full, last, run

__all__ = [
    "Every",
    "Last",
    "Sampled",
    "attitude",
    "bingham_linear",
    "complementary",
    "complementary_covariance",
    "every",
    "full",
    "imu",
    "kalman",
    "last",
    "pair",
    "particle",
    "resampling",
    "rls",
    "run",
    "savitzky_golay",
]
