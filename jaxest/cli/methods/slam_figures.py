"""What `--method slam` found: streams, figures, and why not to use it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.cli.methods import SIZE
from jaxest.cli.methods.deflection_joints import KINDS, Joints
from jaxest.io import Stream
from jaxest.io.report import Row

LOST = 0.1  # share of steps flagged as lost above which the result must not be used


def streams(time: NDArray[Any], joints: Joints, info: Any, robot: Any) -> dict[str, Stream]:
    """Return what was estimated as streams: joints and slides, where there are such, and where each body is."""
    streams = {}
    for kind, (label, unit, _, _) in KINDS.items():
        mine = np.array([one == kind for one in joints.kinds], bool)
        parts = {label: info.joints, f"{label}_bias": info.bias, f"{label}_deviation": info.bias_deviation}
        for name, value in parts.items() if mine.any() else ():
            streams[name] = Stream(time, value[:, mine].astype(float), unit, names=joints.of(kind))
    for k, body in enumerate(robot.topology.body_names):
        streams[f"{body}/position"] = Stream(time, info.position[:, k].astype(float), "m")
        streams[f"{body}/orientation"] = Stream(time, info.quaternion[:, k].astype(float), "1")
    return streams


def rows(time: NDArray[np.float64], joints: Joints, info: Any, robot: Any) -> list[Row]:
    """Return the figures of a run over steps at `time` (T,) s."""
    from jaxest.systems import slam

    found = [Row(SIZE[0], "", float(len(time)), "1"), Row(SIZE[1], "", float(time[-1] - time[0]), "s")]
    for j, (name, unit, scale) in enumerate(joints.coordinates):
        bias, deviation = (scale * float(x[-1, j]) for x in (info.bias, info.bias_deviation))
        found.append(Row("bias at the end", name, bias, unit, deviation, len(time)))
    found.append(
        Row("points that fit the map", "mean", 100 * float(np.mean(info.inliers / np.maximum(info.seen, 1))), "%")
    )
    found.append(Row("map", "voxels", float(info.voxels[-1]), "1"))
    found.append(Row("points without room in the map", "", float(info.overflow[-1]), "1"))
    flagged = float(np.mean(info.status == slam.LOST))
    found.append(Row("steps flagged as lost", "", 100 * flagged, "%"))
    for k, body in enumerate(robot.topology.body_names):
        if np.all(info.link_status[:, k] == slam.UNSEEN):
            found.append(Row("link without sensors", body, None, "1"))
    return found


def turns(mounts: Any) -> list[Row]:
    """Return how far sensors are found turned from where they are believed to look, where that was asked for."""
    if mounts is None:
        return []
    angle = np.rad2deg(np.linalg.norm(np.asarray(mounts.ring)[:, None] + np.asarray(mounts.turn), axis=2))
    ends = ("mean", float(angle.mean())), ("largest", float(angle.max()))
    return [Row("turn of a sensor", which, value, "deg") for which, value in ends]


def refused(info: Any) -> list[str]:
    """Return why the estimate must not be used, a line each."""
    from jaxest.systems import slam

    reasons = []
    if not np.isfinite(info.position).all():
        reasons.append("the estimate is not finite")
    flagged = float(np.mean(info.status == slam.LOST))
    if flagged > LOST:
        reasons.append(f"points contradict the map in {100 * flagged:.0f} % of the steps")
    return reasons


__all__ = ["refused", "rows", "streams", "turns"]
