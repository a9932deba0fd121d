"""Complete estimators, ready to use: the only place that knows a paper.

`jaxest.systems.NAME.build(robot, sensors, **static) -> System`, whose `default_params`, `init`, `step` and `simulate`
are all that is needed; `jaxest.filters.run` drives the step.

* `orientation`: one IMU. `posture`: a robot's joints from IMUs on its links; `posture_pairs` as the paper has it.
* `deflection`: the posture of a robot that bends; `deflection_scatter` says whether its noise is right, `direct_fusion`
  is its baseline by hand.
* `onsite`: the pose of one IMU relative to another on the same link, live; `onsite_batch` for a whole recording,
  `onsite_recording` for one of real IMUs, `onsite_chain` for a robot of modules and sticks, `onsite_drift` for tuning
  what it forgets.
* `slam`: where links are, and the room about them; `slam_inertial` with an IMU on a free root, `slam_chain` as the
  paper has it.
* `torque`: unknown joint torques; their posterior by `torque_sampler`, of a `torque_model` with `torque_settings`, as
  `torque_posterior` collects it; `torque_evidence` for tuning noise.

Each loads on first use. Not here: the filters themselves (`jaxest.filters`), logs and commands.
"""

import importlib
from typing import Any

__all__ = [
    "deflection",
    "deflection_scatter",
    "direct_fusion",
    "onsite",
    "onsite_batch",
    "onsite_chain",
    "onsite_drift",
    "onsite_recording",
    "orientation",
    "posture",
    "posture_pairs",
    "slam",
    "slam_chain",
    "slam_inertial",
    "torque",
    "torque_evidence",
    "torque_model",
    "torque_posterior",
    "torque_sampler",
    "torque_settings",
]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return importlib.import_module(f"jaxest.systems.{name}")
    raise AttributeError(f"module 'jaxest.systems' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
