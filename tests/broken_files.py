"""Good files of every kind that is read, and ways to break them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from jaxest import kinematics, live, models
from jaxest.calibration import imu
from jaxest.io import SensorLog, Stream, config, read, save_state, summarize, write
from jaxest.io.checkpoint import load_state
from jaxest.io.clouds import Cloud, read_cloud, write_cloud

CONFIG = """nan = "missing"
[orientation]
filter = "ekf"
[deflection]
particles = 64
[columns]
rate = 100.0
[columns.gyroscope]
array = "gyr"
unit = "deg/s"
"""
SCHEMA = {"nan": str, "orientation": {"filter": str}, "deflection": {"particles": int}}


class Kind(NamedTuple):
    """A kind of file, or of folder where the suffix is empty."""

    suffix: str
    make: Callable[[Path], Any]
    use: Callable[[Path], Any]
    """Reads it as a person's command would; anything but a result or an `InputError` is a defect."""


def log(rows: int = 30) -> SensorLog:
    random = np.random.default_rng(0)
    time = np.arange(rows) / 100
    return SensorLog(
        {
            "gyroscope": Stream(time, random.normal(size=(rows, 3)), "rad/s", "imu"),
            "accelerometer": Stream(time, random.normal(size=(rows, 3)) + 9.8, "m/s2", "imu"),
            "joints": Stream(time[::2], random.normal(size=(len(time[::2]), 2)), "rad", names=("a", "b")),
        }
    )


def pose_log(rows: int = 30) -> SensorLog:
    unit = np.tile([1.0, 0, 0, 0], (rows, 1))
    time = np.arange(rows) / 100
    return SensorLog({"position": Stream(time, unit[:, :3], "m"), "orientation": Stream(time, unit, "1")})


def look(path: Path) -> None:
    summarize(read(path))


def _put(text: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(text) and None


def _lines() -> str:
    rows = ({"time": i / 100, "gyroscope": [0.1, 0.2, i], "accelerometer": None} for i in range(30))
    return "\n".join(json.dumps(row) for row in rows) + "\n"


def _state() -> Any:
    return {"mean": np.arange(5.0), "count": 3, "covariance": np.eye(3, dtype=np.float32)}


URDF = """<?xml version="1.0"?><robot name="arm"><link name="base"/><link name="upper"><inertial><mass value="1"/>
<origin xyz="0 0 0.1" rpy="0 0 0"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"/><joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint><joint name="b" type="continuous"><parent link="upper"/>
<child link="lower"/><origin xyz="0 0 0.2" rpy="0 1.57 0"/><axis xyz="0 1 0"/></joint></robot>"""


def _imu(store: Any, row: int, **more: Any) -> Any:
    """A message of ROS 1 or 2, by the definitions of the store."""
    kinds = store.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=row, nanosec=5)
    vector = kinds["geometry_msgs/msg/Vector3"](x=0.1, y=float(row), z=9.8)
    return kinds["sensor_msgs/msg/Imu"](
        header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="imu", **more),
        orientation=kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=np.zeros(9),
        angular_velocity=vector,
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector,
        linear_acceleration_covariance=np.zeros(9),
    )


def ros1(path: Path, rows: int = 20) -> None:
    """A ROS 1 bag of chunks that bz2 compressed."""
    rosbag1, typesys = (pytest.importorskip(f"rosbags.{name}") for name in ("rosbag1", "typesys"))
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    writer = rosbag1.Writer(path)
    writer.set_compression(rosbag1.Writer.CompressionFormat.BZ2)
    with writer:
        to = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for row in range(rows):
            writer.write(to, row * 10**9, store.serialize_ros1(_imu(store, row, seq=row), to.msgtype))


def ros2(path: Path, rows: int = 20) -> None:
    """The folder of a ROS 2 bag in SQLite."""
    rosbag2, typesys = (pytest.importorskip(f"rosbags.{name}") for name in ("rosbag2", "typesys"))
    store = typesys.get_typestore(typesys.Stores.LATEST)
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3) as writer:
        to = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for row in range(rows):
            writer.write(to, row * 10**9, store.serialize_cdr(_imu(store, row), to.msgtype))


def lerobot(path: Path, rows: int = 20) -> None:
    """A dataset of one episode."""
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    whole = [*(f"{name}_index" for name in ("frame", "episode", "task")), "index"]
    features = {"observation.state": {"dtype": "float32", "shape": [2], "names": ["a", "b"]},
                "timestamp": {"dtype": "float32", "shape": [1]}, **{n: {"dtype": "int64", "shape": [1]} for n in whole},
                }  # fmt: skip
    (path / "meta").mkdir(parents=True)
    (path / "data" / "chunk-000").mkdir(parents=True)
    info = {"codebase_version": "v2.1", "fps": 30, "total_episodes": 1, "total_frames": rows, "features": features}
    (path / "meta" / "info.json").write_text(json.dumps(info))
    state = arrow.array(np.random.default_rng(0).normal(size=(rows, 2)).astype(np.float32).tolist())
    columns = {"observation.state": state, "timestamp": np.arange(rows, dtype=np.float32) / 30}
    table = arrow.table({**columns, **{name: np.zeros(rows, np.int64) for name in whole}})
    parquet.write_table(table, path / "data" / "chunk-000" / "episode_000000.parquet")


def _cloud(path: Path) -> None:
    write_cloud(Cloud(np.random.default_rng(0).normal(size=(20, 3)), np.ones(20)), path)


def _calibration(path: Path) -> None:
    imu.save({"imu": imu.Calibration(np.zeros(3), 0.01, np.eye(3), np.zeros(3), 0.02)}, path)


PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS 3\nDATA ascii\n1 2 3\n4 5 6\n7 8 9\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 2\n" + "".join(f"property float {n}\n" for n in "xyz")
PLY += "element face 0\nproperty list uchar int vertex_indices\nend_header\n1 2 3\n4 5 6\n"
FOREIGN = "stamp_ms,gyr_x,gyr_y,gyr_z,note\n" + "".join(f"{10 * i},0.1,{i},-3e-2,on\n" for i in range(30))
TABLE = {"time": "stamp_ms", "gyroscope": {"columns": ["gyr_x", "gyr_y", "gyr_z"], "unit": "rad/s"}}

KINDS = {
    "npz": Kind(".npz", lambda path: write(log(), path), look),
    "csv": Kind(".csv", lambda path: write(log(), path), look),
    "parquet": Kind(".parquet", lambda path: write(log(), path), look),
    "hdf5": Kind(".h5", lambda path: write(log(), path), look),
    "mcap": Kind(".mcap", lambda path: write(pose_log(), path), look),
    "tum": Kind(".tum", lambda path: write(pose_log(), path), look),
    "lines": Kind(".jsonl", _put(_lines()), lambda path: list(live.from_file(path, follow=False))),
    "checkpoint": Kind(".npz", lambda path: save_state(path, _state()), lambda path: load_state(path, _state())),
    "config": Kind(".toml", _put(CONFIG), lambda path: config.read_config(path, SCHEMA)),
    "mjcf": Kind(".xml", _put(models.path("rover").read_text()), kinematics.load),
    "urdf": Kind(".urdf", _put(URDF), kinematics.load),
    "foreign": Kind(".csv", _put(FOREIGN), lambda path: read(path, TABLE)),
    "ros1": Kind(".bag", ros1, look),
    "ros2": Kind("", ros2, look),
    "lerobot": Kind("", lerobot, look),
    "ply": Kind(".ply", _cloud, read_cloud),
    "ply_text": Kind(".ply", _put(PLY), read_cloud),
    "pcd": Kind(".pcd", _cloud, read_cloud),
    "pcd_text": Kind(".pcd", _put(PCD), read_cloud),
    "points": Kind(".npz", _cloud, read_cloud),
    "calibration": Kind(".json", _calibration, imu.load),
}


ODD = (b"nan", b"-", b"1e999", b"9" * 23, b"0x1F", b"", b"\x00", "٣".encode(), b"1_0", b"-1", b"true")


def broken(data: bytes, random: np.random.Generator) -> bytes:
    """Break a file in one to four ways."""
    for _ in range(random.integers(1, 5)):
        data = WAYS[random.integers(len(WAYS))](data, random)
    return data


def _span(data: bytes, random: np.random.Generator, longest: int = 40) -> tuple[int, int]:
    start = int(random.integers(len(data) + 1))
    return start, min(len(data), start + int(random.integers(1, longest)))


def _cut(data: bytes, random: np.random.Generator) -> bytes:
    return data[: int(random.integers(len(data) + 1))]


def _drop(data: bytes, random: np.random.Generator) -> bytes:
    start, end = _span(data, random)
    return data[:start] + data[end:]


def _repeat(data: bytes, random: np.random.Generator) -> bytes:
    start, end = _span(data, random)
    return data[:end] + data[start:end] * int(random.integers(1, 20)) + data[end:]


def _noise(data: bytes, random: np.random.Generator) -> bytes:
    start, end = _span(data, random, 8)
    return data[:start] + random.bytes(end - start) + data[end:]


def _flip(data: bytes, random: np.random.Generator) -> bytes:
    out = bytearray(data)
    for at in random.integers(max(len(out), 1), size=3):
        if len(out):
            out[at] ^= 1 << int(random.integers(8))
    return bytes(out)


def _digits(data: bytes, random: np.random.Generator) -> bytes:
    """Put something unlikely where a number stands."""
    places = [i for i, byte in enumerate(data) if 48 <= byte <= 57]
    if not places:
        return data
    at = places[random.integers(len(places))]
    return data[:at] + ODD[random.integers(len(ODD))] + data[at + 1 :]


def _swap(data: bytes, random: np.random.Generator) -> bytes:
    a, b = sorted(int(x) for x in random.integers(len(data) + 1, size=2))
    middle = int(random.integers(a, b + 1))
    return data[:a] + data[middle:b] + data[a:middle] + data[b:]


def _encoding(data: bytes, random: np.random.Generator) -> bytes:
    """Another encoding, or line ends, or a mark in front."""
    ways: tuple[Callable[[bytes], bytes], ...] = (
        lambda x: x.decode("latin1").encode("utf-16"),
        lambda x: x.replace(b"\n", b"\r\n"),
        lambda x: b"\xef\xbb\xbf" + x,
        lambda x: x.replace(b"e", "é".encode("latin1")),
    )
    return ways[random.integers(len(ways))](data)


WAYS = (_cut, _drop, _repeat, _noise, _flip, _digits, _swap, _encoding)
