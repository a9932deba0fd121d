"""What a log says to `--method slam`, a step a row of its ranges."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.cli import truth
from jaxest.cli.methods.deflection_joints import Joints
from jaxest.io import SensorLog, Stream
from jaxest.io.log import refuse_nan, stream, where
from jaxest.types import InputError, Reading, unknown_name

ODOMETRY = ("travel", "turn")
APART = 1e-3  # s, between the stamps of odometry and of the ranges that belong together


def encoded(robot: Any) -> Joints:
    """Return the joints with an encoder, in the robot's order: hinges and slides that no other joint leads."""
    led = {j for j, _ in robot.topology.couplings}
    pairs = zip(robot.joint_names, robot.topology.joint_kind, strict=True)
    kept = [pair for j, pair in enumerate(pairs) if pair[1] != "free" and j not in led]
    return Joints(tuple(name for name, _ in kept), tuple(kind for _, kind in kept))


def measurements(
    log: SensorLog, settings: Mapping[str, Any], robot: Any, placed: Sequence[Any], nan: str
) -> tuple[Any, Any, bool]:
    """Return times (T,), measurements and whether the root is free; one step a row of `ranges`.

    Raises:
        InputError: a stream is not there or does not fit, none of its values can be used, or the config names one that
            nothing would read.
    """
    from jaxest.systems import slam

    free = robot.topology.joint_kind[:1] == ("free",)
    _refuse_idle(settings, free)
    ranges = stream(log, settings.get("ranges", "ranges"))
    reach, within = _ranges(ranges, placed, f"{where(log)}stream of ranges")
    joints = stream(log, settings.get("joints", "joints"))
    spot = where(log)
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
    if wanted.names and not there.any():
        (a, b), (c, d) = ((x.time[0], x.time[-1]) for x in (joints, ranges))
        raise InputError(
            f"{spot}stream of joints: covers {a:.3f} to {b:.3f} s and says nothing at any of the ranges' times, "
            f"{c:.3f} to {d:.3f} s; expected times in common"
        )
    dt = np.concatenate([[0.0], np.diff(ranges.time)]).astype(np.float32)
    fields: dict[str, Any] = {
        "ranges": Reading(reach, within),  # type: ignore[arg-type]
        "joints": Reading(np.where(there, at, 0).astype(np.float32), there),  # type: ignore[arg-type]
        "dt": dt,
    }
    if free:
        fields |= {name: _odometry(log, settings, name, ranges.time) for name in ODOMETRY}
    return ranges.time, (slam.Free if free else slam.Fixed)(**fields), free


def _ranges(item: Stream, placed: Sequence[Any], spot: str) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return ranges (T, R) m, and which of them are within their sensor's limits."""
    value = np.asarray(item.value, float).reshape(len(item.time), -1)
    each = [len(one.directions) for one in placed]
    if value.shape[1] != sum(each):
        raise InputError(f"{spot} has {value.shape[1]} columns, the config's sensors {sum(each)} zones")
    low, high = (np.repeat(ends, each) for ends in zip(*((one.minimum, one.maximum) for one in placed), strict=True))
    within = (value >= low) & (value <= high)
    if not within.any():
        below, above = int((value < low).sum()), int((value > high).sum())
        raise InputError(
            f"{spot}: none of {value.size} values is within its sensor's limits, {low.min():g} to {high.max():g} m: "
            f"{below} are below, {above} beyond, {value.size - below - above} are no number; expected ranges in m"
        )
    return np.where(within, value, 0).astype(np.float32), within


def _refuse_idle(settings: Mapping[str, Any], free: bool) -> None:
    """Refuse keys of the config that name a stream which nothing would read."""
    imu = "imu" in settings
    for keys, idle, why in (
        ([f"{name}_stream" for name in ODOMETRY], not free, "the robot's root is fixed"),
        ([f"{name}_stream" for name in ODOMETRY], imu, f"the IMU {settings.get('imu')!r} tells how the root moves"),
        (["gyroscope_stream", "accelerometer_stream"], not imu, 'no imu = "FRAME" says where the IMU is'),
    ):
        for key in keys:
            if key in settings and idle:
                raise InputError(f"[slam] {key}: is {settings[key]!r} and would do nothing ({why}); leave it out")


def _odometry(log: SensorLog, settings: Mapping[str, Any], name: str, time: NDArray[np.float64]) -> Reading:
    """Return `travel` or `turn` (T, 3) at the times (T,) of the ranges; none where neither config nor log has it."""
    known, many = settings.get(f"{name}_stream", name), len(time)
    if known == name and name not in log.streams:
        return Reading(np.zeros((many, 3), np.float32), np.zeros(many, bool))  # type: ignore[arg-type]
    item, spot = stream(log, known), f"{where(log)}stream {known!r}"
    if len(item.time) != many or not np.allclose(item.time, time, rtol=0, atol=APART):
        raise InputError(
            f"{spot}: {len(item.time)} rows from {item.time[0]:.3f} to {item.time[-1]:.3f} s, expected one at each of "
            f"the ranges' {many} times, {time[0]:.3f} to {time[-1]:.3f} s"
        )
    value = np.asarray(item.value, np.float32)
    if value.shape != (many, 3):
        raise InputError(f"{spot}: got shape {value.shape}, expected {(many, 3)}: along the root's x, y and z")
    return Reading(np.nan_to_num(value), np.isfinite(value).all(axis=1))  # type: ignore[arg-type]


__all__ = ["ODOMETRY", "encoded", "measurements"]
