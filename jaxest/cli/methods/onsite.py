"""`--method onsite`: the pose of one IMU in another on an unknown link, or all links of a robot of joint modules."""

from collections.abc import Mapping
from typing import Any

from jaxest.cli.methods import Outcome, Request, onsite_config, onsite_pair, onsite_robot
from jaxest.cli.methods.onsite_config import schema
from jaxest.io import SensorLog, to_si


def files(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the files that are written beside the estimate: of a robot, its MJCF and URDF."""
    return onsite_robot.FILES if "modules" in settings else ()


def estimate(log: SensorLog, request: Request) -> Outcome:
    """Estimate where IMUs or joints are on unknown links.

    Args:
        log: a log with a gyroscope and an accelerometer for each IMU.
        request: the config's table `[onsite]`, see `onsite_config`.

    Returns:
        Of two IMUs the streams `position`, `orientation` and `pose_covariance` of the second in the first, one row from
        the whole recording, and the same with `live/` before them as they were known at each sample. Of a robot these
        streams with the next joint's name before them, of joint in joint, and the robot as MJCF and URDF.

    Raises:
        InputError: streams are missing, sensors or clocks are not fit, IMUs are not on one rigid link, or the motion
            does not determine a component; which is said.
    """
    log, settings = to_si(log), request.settings
    onsite_config.refuse_idle(settings)
    kind = onsite_robot if "modules" in settings else onsite_pair
    return kind.estimate(log, settings, request.nan)


__all__ = ["estimate", "files", "schema"]
