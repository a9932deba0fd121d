"""What `--method onsite` says of a pose: streams and rows."""

import math
from typing import Any

import numpy as np

from jaxest.io import Stream
from jaxest.io.report import Row

KEPT = ("position", "orientation", "pose_covariance")


def streams(
    prefix: str, time: Any, position: Any, turn: Any, covariance: Any, frame: str, extra: Any
) -> dict[str, Stream]:
    """Return position, orientation and covariance of a pose through time as streams.

    Args:
        prefix: before the streams' names.
        time: (n,) s.
        position: (n, 3) m.
        turn: (n, 4) wxyz.
        covariance: (n, 6, 6) of [rotation, position], rad and m.
        frame: in which the pose is.
        extra: what else is to be said with each stream.

    Returns:
        The streams by name.
    """
    values = zip(KEPT, (position, turn, covariance), ("m", "1", ""), strict=True)
    return {prefix + name: Stream(time, value, unit, frame, extra=extra) for name, value, unit in values}


def rows(condition: str, position: Any, turn: Any, covariance: Any) -> list[Row]:
    """Return the figures of one pose.

    Args:
        condition: what is in what.
        position: (3,) m.
        turn: (4,) wxyz.
        covariance: (6, 6) of [rotation, position], rad and m.

    Returns:
        Rows of its position and rotation, and how well they are known.
    """
    deviation = 1e3 * np.sqrt(np.maximum(np.diag(covariance)[3:], 0))
    rows = [
        Row(f"position {axis}", condition, 1e3 * float(position[k]), "mm", float(deviation[k]))
        for k, axis in enumerate("xyz")
    ]
    rows += [Row(f"quaternion {axis}", condition, float(turn[k]), "1") for k, axis in enumerate("wxyz")]
    spread = math.degrees(math.sqrt(max(float(np.trace(covariance[:3, :3])), 0.0)))
    return [*rows, Row("rotation, standard deviation", condition, spread, "deg")]


__all__ = ["rows", "streams"]
