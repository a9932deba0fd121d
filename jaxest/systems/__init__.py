"""Complete estimators, ready to use: the only place that knows a paper.

`jaxest.systems.NAME.build(robot, sensors, **static) -> System`, whose `default_params`, `init`, `step` and `simulate`
are all that is needed; `jaxest.filters.run` drives the step. So far: `deflection`, the posture of
a robot that bends, and `direct_fusion`, its baseline by hand; `orientation`, a single IMU; `onsite`, the pose of
one IMU relative to another on the same link, live, with `onsite_batch` for a whole recording; `posture`, a robot's
joints from IMUs on its links, with `posture_pairs` as the paper has it.

Not here: the filters themselves (`jaxest.filters`), logs and commands.
"""

from jaxest.systems import (
    deflection,
    direct_fusion,
    onsite,
    onsite_batch,
    onsite_chain,
    orientation,
    posture,
    posture_pairs,
)

__all__ = [
    "deflection",
    "direct_fusion",
    "onsite",
    "onsite_batch",
    "onsite_chain",
    "orientation",
    "posture",
    "posture_pairs",
]
