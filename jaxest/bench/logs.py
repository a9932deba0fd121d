"""Reading a long bag, in messages a second, beside rosbags deserialising the same messages one by one."""

import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxest.bench.harness import Candidate, Progress, compare, find_peer, race
from jaxest.io import bags
from jaxest.io.report import Row

START = 1_700_000_000 * 10**9
JOINTS = tuple(f"joint_{i}" for i in range(1, 8))


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time an MCAP file of a million messages, half of an IMU and half of seven joints.

    rosbags only deserialises each message and keeps nothing; it is a part of jaxest's own reading, too.

    Args:
        peers: whether to run rosbags alone.
        progress: hears what is being measured.
        small: a file of 400 messages.

    Yields:
        The time per message and beside it rosbags', the rate that it means, and by how much the process grows.
    """
    count = 400 if small else 1_000_000
    if find_peer("rosbags") is None:
        yield Row("read", f"MCAP of {count} messages", None, "us", reference_name="rosbags is not installed: "
                  "pip install 'jaxest[bags]'")  # fmt: skip
        return
    with tempfile.TemporaryDirectory() as folder:
        progress(f"writing {count} messages")
        path = record(Path(folder) / "log", count)
        progress("reading")
        candidates = [Candidate("jaxest", lambda: _read(path), count)]
        if peers:
            candidates.append(Candidate("rosbags, deserialised one by one", lambda: _peer(path), count))
        found = race(candidates, repeats=2 if small else 3, min_time=0.0)
        condition = f"MCAP of {count} messages, IMU and 7 joints, per message"
        yield compare("read", condition, found["jaxest"], found.get("rosbags, deserialised one by one"))
        yield Row(
            "rate", f"MCAP of {count} messages", 1 / found["jaxest"].median, "1/s", n=len(found["jaxest"].seconds)
        )
        progress("memory")
        kept = sum(s.time.nbytes + s.value.nbytes for s in bags.read(path).streams.values())
        grown = _growth(path)
        if grown is not None:
            condition = f"peak growth reading {path.stat().st_size / 2**20:.0f} MiB, beside the arrays returned"
            yield Row("memory", condition, grown / 2**20, "MiB", reference=kept / 2**20, reference_name="arrays")


def record(folder: Path, count: int) -> Path:
    """Write a bag of an IMU and joints in turn, at 1000 messages a second.

    Args:
        folder: a folder that does not exist yet.
        count: of messages.

    Returns:
        The MCAP file.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    kinds = ("sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState")
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        places = [writer.add_connection(t, k, typestore=store) for t, k in zip(("/imu", "/arm"), kinds, strict=True)]
        raws = [bytearray(store.serialize_cdr(m, k)) for m, k in zip(_messages(store.types), kinds, strict=True)]
        rng = np.random.default_rng(0)
        for i, value in enumerate(rng.normal(size=count).tolist()):
            stamp, raw = START + i * 1_000_000, raws[i % 2]
            struct.pack_into("<II", raw, 4, *divmod(stamp, 10**9))
            struct.pack_into("<d", raw, len(raw) - 96, value)  # a gyroscope's or a joint's number
            writer.write(places[i % 2], stamp + 200_000, bytes(raw))
    return folder / f"{folder.name}.mcap"


def _messages(types: Any) -> Iterator[Any]:
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "imu_link")
    vector, covariance = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 9.81), np.eye(3).ravel()
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    yield types["sensor_msgs/msg/Imu"](header, turn, covariance, vector, covariance, vector, covariance)
    numbers = np.linspace(-1, 1, len(JOINTS))
    yield types["sensor_msgs/msg/JointState"](header, list(JOINTS), numbers, numbers, numbers)


def _read(path: Path) -> None:
    bags.read(path)


def _peer(path: Path) -> None:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)


def _growth(path: Path) -> float | None:
    """By how many bytes a fresh process's peak memory grows when it reads the file; None where nobody says."""
    # Not ru_maxrss: a child begins with its parent's.
    code = (
        "import re, sys, pathlib; from jaxest.io import bags; import rosbags.rosbag2, rosbags.typesys\n"
        "status = pathlib.Path('/proc/self/status')\n"
        "peak = lambda: int(re.search(r'VmHWM:\\s*(\\d+) kB', status.read_text())[1]) * 1024\n"
        "before = peak(); bags.read(sys.argv[1]); print(peak() - before)"
    )
    if not Path("/proc/self/status").exists():
        return None
    run = [sys.executable, "-c", code, str(path)]
    return float(subprocess.run(run, check=True, capture_output=True, text=True).stdout)
