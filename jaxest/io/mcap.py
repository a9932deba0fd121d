"""MCAP files with ROS 2 messages, written from a log; `jaxest.io.bags` reads them.

`imu0/gyroscope`, `imu0/accelerometer` and `imu0/orientation` become sensor_msgs/Imu on the topic `/imu0` (`/imu` for
streams without a prefix), where a first covariance of -1 marks what a message does not have; `arm/joint_position`,
`joint_velocity`, `joint_torque` sensor_msgs/JointState on `/arm` (`/joint_states`); a magnetometer in T
sensor_msgs/MagneticField; a position and an orientation of equal stamps geometry_msgs/PoseStamped, either alone
PointStamped or QuaternionStamped. What fits none of them is a std_msgs/Float64MultiArray under its own name.
"""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike, refuse_existing, replacing
from jaxest.io.extras import need
from jaxest.io.log import SensorLog, Stream, to_si
from jaxest.types import InputError

_IMU = ("gyroscope", "accelerometer", "orientation")
_JOINTS = ("joint_position", "joint_velocity", "joint_torque")
_LATEST = 2**31  # s; ROS's stamps are 32-bit seconds


class _Topic(NamedTuple):
    """Messages of one type, made from streams of one owner."""

    name: str
    kind: str
    streams: tuple[Stream | None, ...]


def write_log(log: SensorLog, path: PathLike, overwrite: bool = False) -> None:
    """Write a log as MCAP; values become float64, stamps whole nanoseconds.

    Args:
        log: a checked log; streams that state another unit are converted to SI.
        path: where it goes.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: rosbags is not installed, stamps that ROS cannot hold, or the output exists or cannot be written.
    """
    rosbag2, system = need("rosbags.rosbag2", "bags", path), need("rosbags.typesys", "bags", path)
    refuse_existing(path, overwrite)
    log = to_si(log)
    for name, item in log.streams.items():
        if item.time[0] < 0 or item.time[-1] >= _LATEST:
            raise InputError(
                f"{path}: stream {name!r} has stamps from {item.time[0]:.6f} to {item.time[-1]:.6f} s; ROS holds 0 to "
                f"{_LATEST} s"
            )
    store = system.get_typestore(system.Stores.LATEST)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "log"
        with rosbag2.Writer(bag, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
            for topic in _topics(log):
                connection = writer.add_connection(topic.name, topic.kind, typestore=store)
                for stamp, message in _MESSAGES[topic.kind](store.types, topic.streams):
                    writer.write(connection, stamp, store.serialize_cdr(message, topic.kind))
        with replacing(path, overwrite) as out, (bag / "log.mcap").open("rb") as file:
            while piece := file.read(2**24):
                out.write(piece)


def _topics(log: SensorLog) -> list[_Topic]:
    """Sort the streams into topics."""
    found: list[_Topic] = []
    owners: dict[str, dict[str, Stream]] = {}
    for name, item in log.streams.items():
        owner, _, kind = name.rpartition("/")
        owners.setdefault(owner, {})[kind] = item
    for owner, items in owners.items():
        found += _of_owner(owner, dict(items))
    return found


def _of_owner(owner: str, items: dict[str, Stream]) -> list[_Topic]:
    found, root = [], f"/{owner}" if owner else ""
    joints = [k for k in _JOINTS if k in items and items[k].value.ndim == 2]
    imu = any(kind in items for kind in _IMU[:2])
    position, orientation = items.get("position"), items.get("orientation")
    if imu:
        found.append(_Topic(root or "/imu", "sensor_msgs/msg/Imu", tuple(items.pop(k, None) for k in _IMU)))
    elif (
        position is not None
        and orientation is not None
        and position.value.shape[1:] == (3,)
        and np.array_equal(position.time, orientation.time)
    ):
        pair = (items.pop("position"), items.pop("orientation"))
        found.append(_Topic(root or "/pose", "geometry_msgs/msg/PoseStamped", pair))
    if joints and len({items[k].names for k in joints}) == 1 and items[joints[0]].names:
        name = f"{root}/joint_states" if found or not owner else root
        streams = tuple(items.pop(k) if k in joints else None for k in _JOINTS)
        found.append(_Topic(name, "sensor_msgs/msg/JointState", streams))
    for kind, item in items.items():
        message = "std_msgs/msg/Float64MultiArray"
        if kind == "magnetometer" and item.unit in ("T", ""):
            message = "sensor_msgs/msg/MagneticField"
        elif kind == "position" and item.value.shape[1:] == (3,) and item.unit in ("m", ""):
            message = "geometry_msgs/msg/PointStamped"
        elif kind == "orientation":
            message = "geometry_msgs/msg/QuaternionStamped"
        found.append(_Topic(f"{root}/{kind}", message, (item,)))
    return found


def _stamps(time: NDArray[np.float64]) -> list[tuple[int, int]]:
    whole = np.floor(time)
    rest = np.rint((time - whole) * 1e9).astype(np.int64)
    seconds = whole.astype(np.int64) + rest // 10**9
    return list(zip(seconds.tolist(), (rest % 10**9).tolist(), strict=True))


Rows = Iterator[tuple[int, Any]]


def _merged(streams: tuple[Stream | None, ...]) -> Iterator[tuple[tuple[int, int], list[NDArray[Any] | None]]]:
    """Yield each stamp that any of the streams has, with their values there, None where one has none."""
    there = [item for item in streams if item is not None]
    time = np.unique(np.concatenate([item.time for item in there]))
    rows = []
    for item in streams:
        row = np.full(len(time), -1)
        if item is not None:
            row[np.searchsorted(time, item.time)] = np.arange(len(item.time))
        rows.append(row.tolist())
    wide = [None if item is None else item.value.astype(np.float64) for item in streams]
    for i, stamp in enumerate(_stamps(time)):
        yield stamp, [None if w is None or r[i] < 0 else w[r[i]] for w, r in zip(wide, rows, strict=True)]


def _ns(stamp: tuple[int, int]) -> int:
    return stamp[0] * 10**9 + stamp[1]


def _header(types: Any, stamp: tuple[int, int], frame: str) -> Any:
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*stamp), frame)


def _frame(streams: tuple[Stream | None, ...]) -> str:
    return next((item.frame for item in streams if item is not None and item.frame), "")


def _xyz(types: Any, value: NDArray[Any] | None, kind: str = "Vector3") -> Any:
    return types[f"geometry_msgs/msg/{kind}"](*((0.0, 0.0, 0.0) if value is None else value.tolist()))


def _wxyz(types: Any, value: NDArray[Any] | None) -> Any:
    w, x, y, z = (1.0, 0.0, 0.0, 0.0) if value is None else value.tolist()
    return types["geometry_msgs/msg/Quaternion"](x, y, z, w)


def _imu(types: Any, streams: tuple[Stream | None, ...]) -> Rows:
    known, absent, frame = np.zeros(9), np.array([-1.0, *[0.0] * 8]), _frame(streams)
    make = types["sensor_msgs/msg/Imu"]
    for stamp, parts in _merged(streams):
        gyr, acc, quat = parts
        marks = [absent if part is None else known for part in parts]
        yield _ns(stamp), make(
            _header(types, stamp, frame), _wxyz(types, quat), marks[2], _xyz(types, gyr), marks[0], _xyz(types, acc),
            marks[1],
        )  # fmt: skip


def _joints(types: Any, streams: tuple[Stream | None, ...]) -> Rows:
    names = next(list(item.names) for item in streams if item is not None)
    none, frame, make = np.zeros(0), _frame(streams), types["sensor_msgs/msg/JointState"]
    for stamp, parts in _merged(streams):
        yield _ns(stamp), make(_header(types, stamp, frame), names, *(none if p is None else p for p in parts))


def _pose(types: Any, streams: tuple[Stream | None, ...]) -> Rows:
    frame, make = _frame(streams), types["geometry_msgs/msg/PoseStamped"]
    for stamp, (position, quat) in _merged(streams):
        pose = types["geometry_msgs/msg/Pose"](_xyz(types, position, "Point"), _wxyz(types, quat))
        yield _ns(stamp), make(_header(types, stamp, frame), pose)


def _magnetic(types: Any, streams: tuple[Stream | None, ...]) -> Rows:
    make, frame = types["sensor_msgs/msg/MagneticField"], _frame(streams)
    for stamp, (value,) in _merged(streams):
        yield _ns(stamp), make(_header(types, stamp, frame), _xyz(types, value), np.zeros(9))


def _point(types: Any, streams: tuple[Stream | None, ...]) -> Rows:
    make, frame = types["geometry_msgs/msg/PointStamped"], _frame(streams)
    for stamp, (value,) in _merged(streams):
        yield _ns(stamp), make(_header(types, stamp, frame), _xyz(types, value, "Point"))


def _quaternion(types: Any, streams: tuple[Stream | None, ...]) -> Rows:
    make, frame = types["geometry_msgs/msg/QuaternionStamped"], _frame(streams)
    for stamp, (value,) in _merged(streams):
        yield _ns(stamp), make(_header(types, stamp, frame), _wxyz(types, value))


def _numbers(types: Any, streams: tuple[Stream | None, ...]) -> Rows:
    of = {name: types[f"std_msgs/msg/{name}"] for name in ("Float64MultiArray", "MultiArrayLayout",
                                                           "MultiArrayDimension")}  # fmt: skip
    for stamp, (value,) in _merged(streams):
        assert value is not None
        sizes = value.shape
        strides = [int(np.prod(sizes[i:])) for i in range(len(sizes))]
        dims = [of["MultiArrayDimension"]("", n, s) for n, s in zip(sizes, strides, strict=True)]
        yield _ns(stamp), of["Float64MultiArray"](of["MultiArrayLayout"](dims, 0), np.atleast_1d(value).ravel())


_MESSAGES: dict[str, Callable[[Any, tuple[Stream | None, ...]], Rows]] = {
    "sensor_msgs/msg/Imu": _imu,
    "sensor_msgs/msg/JointState": _joints,
    "sensor_msgs/msg/MagneticField": _magnetic,
    "geometry_msgs/msg/PoseStamped": _pose,
    "geometry_msgs/msg/PointStamped": _point,
    "geometry_msgs/msg/QuaternionStamped": _quaternion,
    "std_msgs/msg/Float64MultiArray": _numbers,
}
