"""What `--method slam` found: streams, figures, and why not to use it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.cli.methods import SIZE
from jaxest.cli.methods.deflection_joints import KINDS, Joints
from jaxest.io import Stream
from jaxest.io.report import Row

MOST = 0.1  # share of steps with a flag, or of points without room, above which the result must not be used


def streams(time: NDArray[Any], joints: Joints, info: Any, robot: Any, driven: Any = None) -> dict[str, Stream]:
    """Return what was estimated as streams.

    Args:
        time: (T,) s.
        joints: with an encoder.
        info: `slam.Info` of T steps.
        robot: the robot.
        driven: (T,) bool, whether the IMU told how the root moved; None where there is none.

    Returns:
        Joints and slides, where there are such, where each body is, and the status of steps and links.
    """
    bodies = robot.topology.body_names
    streams = {
        "status": Stream(time, info.status, "1"),
        "link_status": Stream(time, info.link_status, "1", names=bodies),
    }
    if driven is not None:
        streams["driven"] = Stream(time, driven, "1")
    for kind, (label, unit, _, _) in KINDS.items():
        mine = np.array([one == kind for one in joints.kinds], bool)
        parts = {label: info.joints, f"{label}_bias": info.bias, f"{label}_deviation": info.bias_deviation}
        for name, value in parts.items() if mine.any() else ():
            streams[name] = Stream(time, value[:, mine].astype(float), unit, names=joints.of(kind))
    for k, body in enumerate(bodies):
        streams[f"{body}/position"] = Stream(time, info.position[:, k].astype(float), "m")
        streams[f"{body}/orientation"] = Stream(time, info.quaternion[:, k].astype(float), "1")
    return streams


def rows(time: NDArray[np.float64], joints: Joints, info: Any, robot: Any, driven: Any = None) -> list[Row]:
    """Return the figures of a run; arguments as in `streams`."""
    from jaxest.systems import slam
    from jaxest.types import NON_FINITE, NOT_CONVERGED, OUT_OF_RANGE

    found = [Row(SIZE[0], "", float(len(time)), "1"), Row(SIZE[1], "", float(time[-1] - time[0]), "s")]
    for j, (name, unit, scale) in enumerate(joints.coordinates):
        bias, deviation = (scale * float(x[-1, j]) for x in (info.bias, info.bias_deviation))
        found.append(Row("bias at the end", name, bias, unit, deviation, len(time)))
    found.append(
        Row("points that fit the map", "mean", 100 * float(np.mean(info.inliers / np.maximum(info.seen, 1))), "%")
    )
    found.append(Row("map", "voxels", float(info.voxels[-1]), "1"))
    found.append(Row("points without room in the map", "", float(info.overflow[-1]), "1"))
    found.append(Row("steps flagged as lost", "", _percent(info.status == slam.LOST), "%"))
    for status, flag in (
        (slam.FULL, "map full"), (NON_FINITE, "not finite"), (OUT_OF_RANGE, "out of range"),
        (NOT_CONVERGED, "not converged"),
    ):  # fmt: skip
        if np.any(info.status == status):
            found.append(Row("steps flagged", flag, _percent(info.status == status), "%"))
    if driven is not None:
        found.append(Row("steps that the IMU drove", "", _percent(driven[1:]), "%"))
    for k, body in enumerate(robot.topology.body_names):
        if np.all(info.link_status[:, k] == slam.UNSEEN):
            found.append(Row("link without sensors", body, None, "1"))
        for status, what in ((slam.FOLLOWS, "kept its prediction"), (slam.LOST, "lost")):
            if np.any(info.link_status[:, k] == status):
                found.append(Row(f"steps, link {what}", body, _percent(info.link_status[:, k] == status), "%"))
    return found


def _percent(there: NDArray[np.bool_]) -> float:
    return 100 * float(np.mean(there)) if len(there) else 0.0


def turns(mounts: Any, placed: Sequence[Any], robot: Any) -> list[Row]:
    """Return how far sensors are found turned from where they are believed to look, where that was asked for."""
    from jaxest.kinematics import frame

    if mounts is None:
        return []
    bodies = [*range(len(robot.topology.body_names)), *robot.topology.site_body]
    _, counts = np.unique([bodies[frame(robot, one.frame)] for one in placed], return_counts=True)
    angle = np.rad2deg(np.linalg.norm(np.asarray(mounts.ring)[:, None] + np.asarray(mounts.turn), axis=2))
    angle = angle[np.arange(angle.shape[1]) < counts[:, None]]  # links with fewer sensors are filled up
    ends = ("mean", float(angle.mean())), ("largest", float(angle.max()))
    return [Row("turn of a sensor", which, value, "deg") for which, value in ends]


def refused(info: Any, points: int) -> list[str]:
    """Return why the estimate must not be used, a line each; `points` of the log could have gone into the map."""
    from jaxest.systems import slam
    from jaxest.types import NON_FINITE, OUT_OF_RANGE

    reasons = []
    if not np.isfinite(info.position).all():
        reasons.append("the estimate is not finite")
    for status, what in (
        (slam.LOST, "points contradict the map"), (OUT_OF_RANGE, "numbers outgrew the precision"),
        (NON_FINITE, "a measurement was not finite"),
    ):  # fmt: skip
        flagged = float(np.mean(info.status == status))
        if flagged > MOST:
            reasons.append(f"{what} in {100 * flagged:.0f} % of the steps")
    if not info.inliers.any():
        reasons.append("no point fitted the map, so that nothing was learned")
    lost = info.overflow[-1] / points
    if lost > MOST:
        reasons.append(f"{100 * lost:.0f} % of the points found no room in the map, expected a larger capacity")
    return reasons


__all__ = ["refused", "rows", "streams", "turns"]
