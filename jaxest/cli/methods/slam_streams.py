"""What a log says to `--method slam`, a step a row of its ranges."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxest.cli import truth
from jaxest.cli.methods.deflection_joints import Joints
from jaxest.io import SensorLog
from jaxest.io.log import refuse_nan, stream, where
from jaxest.types import InputError, unknown_name


def encoded(robot: Any) -> Joints:
    """Return the joints with an encoder, in the robot's order: hinges and slides that no other joint leads."""
    led = {j for j, _ in robot.topology.couplings}
    pairs = zip(robot.joint_names, robot.topology.joint_kind, strict=True)
    kept = [pair for j, pair in enumerate(pairs) if pair[1] != "free" and j not in led]
    return Joints(tuple(name for name, _ in kept), tuple(kind for _, kind in kept))


def measurements(
    log: SensorLog, settings: Mapping[str, Any], robot: Any, zones: int, nan: str
) -> tuple[Any, Any, bool]:
    """Return times (T,), measurements and whether the root is free; one step a row of `ranges`."""
    from jaxest.systems import slam
    from jaxest.types import Reading

    ranges = stream(log, settings.get("ranges", "ranges"))
    joints = stream(log, settings.get("joints", "joints"))
    spot = where(log)
    value = np.asarray(ranges.value, float).reshape(len(ranges.time), -1)
    if value.shape[1] != zones:
        raise InputError(f"{spot}stream of ranges has {value.shape[1]} columns, the config's sensors {zones} zones")
    wanted = encoded(robot)
    angles = np.asarray(joints.value, float).reshape(len(joints.time), -1)
    given = list(joints.names) or list(wanted.names)
    for name in wanted.names:
        if name not in given:
            raise unknown_name(f"{spot}stream of joints: column", name, given)
    if angles.shape[1] != len(given):
        raise InputError(f"{spot}stream of joints has {angles.shape[1]} columns, expected {len(given)}: {given}")
    columns = [given.index(name) for name in wanted.names]
    if nan == "error":
        refuse_nan(joints, f"{spot}stream of joints", 'nan = "missing" in a config')
    at = truth.joints(joints, dict(enumerate(columns)), wanted.hinges, ranges.time)
    there = np.isfinite(at)
    dt = np.concatenate([[0.0], np.diff(ranges.time)]).astype(np.float32)
    fields: dict[str, Any] = {
        "ranges": Reading(np.nan_to_num(value).astype(np.float32), np.isfinite(value)),
        "joints": Reading(np.where(there, at, 0).astype(np.float32), there),  # type: ignore[arg-type]
        "dt": dt,
    }
    free = robot.topology.joint_kind[:1] == ("free",)
    for name in ("travel", "turn") if free else ():
        known = settings.get(f"{name}_stream", name)
        moved, seen = np.zeros((len(dt), 3), np.float32), np.zeros(len(dt), bool)
        if known in log.streams:
            item = stream(log, known)
            if len(item.time) != len(dt) or not np.allclose(item.time, ranges.time):
                raise InputError(f"{spot}stream {known!r}: expected a row at each of the ranges' {len(dt)} times")
            moved, seen = np.asarray(item.value, np.float32), np.isfinite(item.value).all(axis=1)
            moved = np.nan_to_num(moved)
        fields[name] = Reading(moved, seen)  # type: ignore[arg-type]
    return ranges.time, (slam.Free if free else slam.Fixed)(**fields), free


__all__ = ["encoded", "measurements"]
