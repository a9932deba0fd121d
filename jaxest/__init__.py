"""Estimators of a robot's own body from its own sensors, as pure JAX functions.

Which problem, which module:

* a robot model and its kinematics: `jaxest.kinematics` (`load`, `forward`, `jacobian`, `gravity_torque`);
* a complete estimator for a robot and its sensors: `jaxest.systems`;
* its parts: `jaxest.filters`, `jaxest.manifolds`, `jaxest.metrics`;
* logs and checkpoints, on the host: `jaxest.io`.

Conventions: quaternions `wxyz`; `R_world_imu` maps imu coordinates to world coordinates; tangent vectors are
`[rotation, translation]`, perturbations on the right; SI units and radians. Subpackages load on first use; importing
this package starts no JAX backend.
"""

import importlib
from typing import Any

__version__ = "0.1.0"

_SUBMODULES = (
    "bench",
    "calibration",
    "distributions",
    "filters",
    "io",
    "kinematics",
    "linalg",
    "live",
    "manifolds",
    "mapping",
    "mcmc",
    "metrics",
    "models",
    "parallel",
    "sensors",
    "simulate",
    "systems",
    "tuning",
    "types",
    "viz",
)

__all__ = ["__version__", *_SUBMODULES]


def __getattr__(name: str) -> Any:
    if name in _SUBMODULES:
        return importlib.import_module(f"jaxest.{name}")
    raise AttributeError(f"module 'jaxest' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
