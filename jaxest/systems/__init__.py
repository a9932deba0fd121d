"""Complete estimators, ready to use: the only place that knows a paper.

`jaxest.systems.NAME.build(robot, sensors, **static) -> System`, whose `default_params`, `init`, `step` and `simulate`
are all that is needed; `jaxest.filters.run` drives the step. So far: `orientation`, a single IMU.

Not here: the filters themselves (`jaxest.filters`), logs and commands.
"""

from jaxest.systems import orientation

__all__ = ["orientation"]
