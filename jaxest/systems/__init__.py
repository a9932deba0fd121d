"""Complete estimators, ready to use: the only place that knows a paper.

`jaxest.systems.NAME.build(robot, sensors, **static) -> System`, whose `default_params`, `init`, `step` and `simulate`
are all that is needed; `jaxest.filters.run` drives the step. So far: `deflection`, the posture of
a robot that bends, and `direct_fusion`, its baseline by hand; `orientation`, a single IMU; `onsite`, the pose of
one IMU relative to another on the same link, live, with `onsite_batch` for a whole recording.

Not here: the filters themselves (`jaxest.filters`), logs and commands.
"""

from jaxest.systems import deflection, direct_fusion, onsite, onsite_batch, orientation

__all__ = ["deflection", "direct_fusion", "onsite", "onsite_batch", "orientation"]
