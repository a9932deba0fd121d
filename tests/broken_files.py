"""Good files of every kind that is read, and ways to break them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxest import kinematics, live, models
from jaxest.io import SensorLog, Stream, config, read, save_state, summarize, write
from jaxest.io.checkpoint import load_state

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
    """A kind of file."""

    suffix: str
    make: Callable[[Path], None]
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
    odd = (
        b"nan",
        b"-",
        b"1e999",
        b"99999999999999999999999",
        b"0x1F",
        b"",
        b"\x00",
        "٣".encode(),
        b"1_0",
        b"-1",
        b"true",
    )
    return data[:at] + odd[random.integers(len(odd))] + data[at + 1 :]


def _swap(data: bytes, random: np.random.Generator) -> bytes:
    a, b = sorted(int(x) for x in random.integers(len(data) + 1, size=2))
    middle = int(random.integers(a, b + 1))
    return data[:a] + data[middle:b] + data[a:middle] + data[b:]


WAYS = (_cut, _drop, _repeat, _noise, _flip, _digits, _swap)
