"""What `--method slam` found: streams, figures, and why not to use it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.cli.methods import SIZE
from jaxest.io import Stream
from jaxest.io.report import Row

LOST = 0.1  # share of steps flagged as lost above which the result must not be used


def streams(time: NDArray[Any], names: tuple[str, ...], info: Any, robot: Any) -> dict[str, Stream]:
    """Return what was estimated as streams: joints, and where each body is."""
    streams = {
        "joints": Stream(time, info.joints.astype(float), "rad", names=names),
        "joints_bias": Stream(time, info.bias.astype(float), "rad", names=names),
        "joints_deviation": Stream(time, info.bias_deviation.astype(float), "rad", names=names),
    }
    for k, body in enumerate(robot.topology.body_names):
        streams[f"{body}/position"] = Stream(time, info.position[:, k].astype(float), "m")
        streams[f"{body}/orientation"] = Stream(time, info.quaternion[:, k].astype(float), "1")
    return streams


def rows(time: NDArray[np.float64], names: tuple[str, ...], info: Any, robot: Any) -> list[Row]:
    """Return the figures of a run over steps at `time` (T,) s."""
    from jaxest.systems import slam

    found = [Row(SIZE[0], "", float(len(time)), "1"), Row(SIZE[1], "", float(time[-1] - time[0]), "s")]
    for j, name in enumerate(names):
        found.append(Row("bias at the end", name, float(np.rad2deg(info.bias[-1, j])), "deg",
                         float(np.rad2deg(info.bias_deviation[-1, j])), len(time)))  # fmt: skip
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
