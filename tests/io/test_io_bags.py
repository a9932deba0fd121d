"""Bags of ROS 1 and ROS 2: what rosbags' own deserialiser says, types by type, and files that break off."""

import itertools
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from jaxest.io import SensorLog, Stream, bag_layout, bag_scan, bags, read, write
from jaxest.types import InputError

pytest.importorskip("rosbags")
from rosbags import rosbag1, rosbag2
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NS = 10**9
START = 1_700_000_000 * NS
JOINTS = ["shoulder", "elbow", "wrist"]
ONE, TWO = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.LATEST)


def make(store, kind, /, **fields):
    return store.types[kind](**fields)


def header(store, stamp, frame="imu_link"):
    time = make(store, "builtin_interfaces/msg/Time", sec=stamp // NS, nanosec=stamp % NS)
    more = {"seq": 7} if store is ONE else {}
    return make(store, "std_msgs/msg/Header", stamp=time, frame_id=frame, **more)


def xyz(store, value, kind="Vector3"):
    return make(store, f"geometry_msgs/msg/{kind}", **dict(zip("xyz", map(float, value), strict=True)))


def xyzw(store, value):
    return make(store, "geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, value), strict=True)))


def imu(store, stamp, rng, frame="imu_link", absent=()):
    marks = {k: np.array([-1.0 if k in absent else 0.25, *[0.0] * 8]) for k in ("orientation", "angular_velocity",
                                                                             "linear_acceleration")}  # fmt: skip
    return make(
        store, "sensor_msgs/msg/Imu", header=header(store, stamp, frame), orientation=xyzw(store, rng.normal(size=4)),
        angular_velocity=xyz(store, rng.normal(size=3)), linear_acceleration=xyz(store, rng.normal(size=3)),
        **{f"{k}_covariance": mark for k, mark in marks.items()},
    )  # fmt: skip


def joints(store, stamp, rng, names=JOINTS, velocity=True):
    n = len(names)
    return make(
        store, "sensor_msgs/msg/JointState", header=header(store, stamp, ""), name=list(names),
        position=rng.normal(size=n), velocity=rng.normal(size=n if velocity else 0), effort=np.zeros(0),
    )  # fmt: skip


def magnetic(store, stamp, rng):
    field = xyz(store, 1e-5 * rng.normal(size=3))
    return make(
        store, "sensor_msgs/msg/MagneticField", header=header(store, stamp), magnetic_field=field,
        magnetic_field_covariance=np.zeros(9),
    )  # fmt: skip


def pose(store, stamp, rng):
    inner = make(store, "geometry_msgs/msg/Pose", position=xyz(store, rng.normal(size=3), "Point"),
                 orientation=xyzw(store, rng.normal(size=4)))  # fmt: skip
    return make(store, "geometry_msgs/msg/PoseStamped", header=header(store, stamp, "map"), pose=inner)


def cloud(store, stamp, points, big=False, extra=True, shape=None):
    """A cloud with an intensity between y and z, and padding behind each point."""
    order = ">" if big else "<"
    kind = np.dtype({"names": ["x", "y", "i", "z"], "formats": [order + "f4"] * 4, "offsets": [0, 4, 8, 12],
                     "itemsize": 20 if extra else 16})  # fmt: skip
    data = np.zeros(len(points), kind)
    for i, axis in enumerate("xyz"):
        data[axis] = points[:, i]
    fields = [make(store, "sensor_msgs/msg/PointField", name=n, offset=o, datatype=7, count=1)
              for n, o in (("x", 0), ("y", 4), ("i", 8), ("z", 12))]  # fmt: skip
    height, width = shape or (1, len(points))
    return make(
        store, "sensor_msgs/msg/PointCloud2", header=header(store, stamp, "lidar"), height=height, width=width,
        fields=fields, is_bigendian=big, point_step=kind.itemsize, row_step=kind.itemsize * width,
        data=np.frombuffer(data.tobytes(), np.uint8), is_dense=True,
    )  # fmt: skip


def text(store, stamp, rng):
    del stamp, rng
    return make(store, "std_msgs/msg/String", data="hello")


def messages(store, n=40, late=1_500_000):
    """(topic, type, the bag's stamp, message) of an IMU, joints, a magnetometer, a pose, clouds and text."""
    rng = np.random.default_rng(0)
    for i in range(n):
        stamp = START + i * 10_000_000
        yield "/imu/data", "sensor_msgs/msg/Imu", stamp + late, imu(store, stamp, rng)
        yield "/joint_states", "sensor_msgs/msg/JointState", stamp + late, joints(store, stamp, rng)
        yield "/imu/mag", "sensor_msgs/msg/MagneticField", stamp + late, magnetic(store, stamp, rng)
        yield "/tool/pose", "geometry_msgs/msg/PoseStamped", stamp + late, pose(store, stamp, rng)
        if i % 10 == 0:
            yield (
                "/lidar/points",
                "sensor_msgs/msg/PointCloud2",
                stamp + late,
                cloud(store, stamp, rng.normal(size=(4 + i // 10, 3)), big=i == 20),
            )
        yield "/chatter", "std_msgs/msg/String", stamp + late, text(store, stamp, rng)


def record(path: Path, what, plugin="mcap", compression=None):
    """Write a bag of ROS 1 for `.bag`, a folder of ROS 2 otherwise; `.mcap` and `.db3` are taken out of it."""
    one = path.suffix == ".bag"
    store = ONE if one else TWO
    if one:
        writer = rosbag1.Writer(path)
        if compression:
            writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    else:
        plugin = {".mcap": "mcap", ".db3": "sqlite3"}.get(path.suffix, plugin)
        folder = path.with_suffix(".folder") if path.suffix else path
        writer = rosbag2.Writer(folder, version=9, storage_plugin=rosbag2.StoragePlugin[plugin.upper()])
        if compression:
            writer.set_compression(rosbag2.CompressionMode[compression], rosbag2.CompressionFormat.ZSTD)
    with writer:
        known = {}
        for topic, kind, stamp, message in what:
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            raw = message if isinstance(message, bytes) else (store.serialize_ros1 if one else store.serialize_cdr)(
                message, kind
            )  # fmt: skip
            writer.write(known[topic], stamp, raw)
    if path.suffix in (".mcap", ".db3"):
        next(folder.glob(f"*{path.suffix}")).rename(path)
    return path


def by_rosbags(path):
    """Messages by topic, deserialised one by one."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, stamp, raw in reader.messages():
            found.setdefault(connection.topic, []).append((stamp, reader.deserialize(raw, connection.msgtype)))
    return found


def vector(item, axes="xyz"):
    return [getattr(item, axis) for axis in axes]


def assert_as_rosbags(log, found):
    s = log.streams
    cases = {
        "imu/data/gyroscope": ("/imu/data", lambda m: vector(m.angular_velocity)),
        "imu/data/accelerometer": ("/imu/data", lambda m: vector(m.linear_acceleration)),
        "imu/data/orientation": ("/imu/data", lambda m: vector(m.orientation, "wxyz")),
        "joint_states/joint_position": ("/joint_states", lambda m: m.position),
        "joint_states/joint_velocity": ("/joint_states", lambda m: m.velocity),
        "imu/mag/magnetometer": ("/imu/mag", lambda m: vector(m.magnetic_field)),
        "tool/pose/position": ("/tool/pose", lambda m: vector(m.pose.position)),
        "tool/pose/orientation": ("/tool/pose", lambda m: vector(m.pose.orientation, "wxyz")),
    }
    assert set(s) == {*cases, "lidar/points"}
    for name, (topic, value) in cases.items():
        np.testing.assert_array_equal(s[name].value, [value(m) for _, m in found[topic]], err_msg=name)
        stamps = [m.header.stamp.sec + m.header.stamp.nanosec / 1e9 for _, m in found[topic]]
        np.testing.assert_array_equal(s[name].time, stamps)
        assert s[name].frame == found[topic][0][1].header.frame_id
    assert s["joint_states/joint_position"].names == tuple(JOINTS)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("log.bag", {}),
        ("log.bag", {"compression": "BZ2"}),
        ("log.bag", {"compression": "LZ4"}),
        ("folder", {"plugin": "mcap"}),
        ("folder", {"plugin": "sqlite3"}),
        ("folder", {"plugin": "sqlite3", "compression": "MESSAGE"}),
        ("folder", {"plugin": "sqlite3", "compression": "FILE"}),
        ("folder", {"plugin": "mcap", "compression": "STORAGE"}),
        ("log.mcap", {}),
        ("log.db3", {}),
    ],
)
def test_every_kind_of_bag_reads_as_rosbags_reads_it(tmp_path, name, options):
    store = ONE if name.endswith(".bag") else TWO
    path = record(tmp_path / name, messages(store), **options)
    log = read(path)
    assert_as_rosbags(log, by_rosbags(path))
    notes = "\n".join(log.notes)
    assert "left out: /chatter (std_msgs/msg/String, 40 messages)" in notes
    assert "/imu/data: the bag's own stamps are +0.0015 s from the header's in the median" in notes
    clouds = log.streams["lidar/points"].value
    assert (clouds.shape, clouds.dtype) == ((4, 7, 3), np.float32)
    assert [int(np.isfinite(c).all(axis=1).sum()) for c in clouds] == [4, 5, 6, 7]
    assert "clouds of 4 to 7 points" in notes


def test_clouds_of_one_size_and_of_rows(tmp_path):
    rng = np.random.default_rng(1)
    points = rng.normal(size=(3, 6, 3)).astype(np.float32)
    what = []
    for i, part in enumerate(points):
        stamp = START + i * NS
        message = cloud(TWO, stamp, part, big=i == 1, extra=i != 2, shape=(2, 3))
        what.append(("/c", "sensor_msgs/msg/PointCloud2", stamp, message))
    log = read(record(tmp_path / "log.mcap", what))
    np.testing.assert_array_equal(log.streams["c/points"].value, points)
    small = cloud(TWO, START, points[0])
    small.width = 100
    with pytest.raises(InputError, match=r"/c \(sensor_msgs/msg/PointCloud2\).*100 points of 20 bytes do not fit"):
        read(record(tmp_path / "bad.mcap", [("/c", "sensor_msgs/msg/PointCloud2", START, small)]))


def test_layouts_follow_every_length_of_text(tmp_path):
    """Alignment: names of all lengths, an empty sequence between, frames that come and go."""
    rng = np.random.default_rng(2)
    what = []
    for i, (a, b) in enumerate(itertools.product(range(5), range(9))):
        names = ["j" * a + str(k) for k in range(b)]
        message = joints(TWO, START + i * NS, rng, names, velocity=a != 3)
        message.header.frame_id = "f" * (i % 11)
        what.append((message, names))
    for store, cdr in ((TWO, True), (ONE, False)):
        defs = store.fielddefs
        for message, names in what:
            message = make(store, "sensor_msgs/msg/JointState", header=header(store, START, message.header.frame_id),
                           name=message.name, position=message.position, velocity=message.velocity,
                           effort=message.effort)  # fmt: skip
            raw = bytes((store.serialize_cdr if cdr else store.serialize_ros1)(message, "sensor_msgs/msg/JointState"))
            found = bag_layout.layout(raw, "sensor_msgs/msg/JointState", defs, cdr)
            block = np.frombuffer(raw, np.uint8)[None]
            assert bag_layout.matching(block, found).all()
            for field in ("position", "velocity", "effort"):
                np.testing.assert_array_equal(bag_layout.values(block, found, field)[0], getattr(message, field))
            assert [t for p, t in found.texts.items() if p.startswith("name.")] == names
            with pytest.raises(ValueError, match="expected"):
                bag_layout.layout(raw[: len(raw) - 9], "sensor_msgs/msg/JointState", defs, cdr)


def test_big_endian_messages(tmp_path):
    rng = np.random.default_rng(3)
    message = imu(TWO, START, rng)
    raw = bytes(TWO.serialize_cdr(message, "sensor_msgs/msg/Imu", little_endian=False))
    log = read(record(tmp_path / "log.mcap", [("/imu", "sensor_msgs/msg/Imu", START, raw)]))
    np.testing.assert_array_equal(log.streams["imu/gyroscope"].value[0], vector(message.angular_velocity))
    assert log.streams["imu/gyroscope"].time[0] == START / NS


def test_absent_readings_are_no_samples(tmp_path):
    rng = np.random.default_rng(4)
    what = []
    for i in range(6):
        absent = ("orientation", "angular_velocity") if i % 2 else ("orientation",)
        what.append(("/imu", "sensor_msgs/msg/Imu", START + i * NS, imu(TWO, START + i * NS, rng, absent=absent)))
    log = read(record(tmp_path / "log.mcap", what))
    assert {n: len(s.time) for n, s in log.streams.items()} == {"imu/gyroscope": 3, "imu/accelerometer": 6}
    np.testing.assert_array_equal(log.streams["imu/gyroscope"].time, START / NS + np.array([0, 2, 4]))


def test_several_frames_and_sets_of_joints(tmp_path):
    rng = np.random.default_rng(5)
    what = []
    for i in range(8):
        stamp = START + i * NS
        names = [JOINTS, JOINTS[::-1], ["finger"]][i % 3]
        what.append(("/joint_states", "sensor_msgs/msg/JointState", stamp, joints(TWO, stamp, rng, names)))
        what.append(("/imu", "sensor_msgs/msg/Imu", stamp, imu(TWO, stamp, rng, frame=["left", "right"][i % 2])))
    log = read(record(tmp_path / "log.mcap", what))
    arm, hand = log.streams["joint_states/0/joint_position"], log.streams["joint_states/1/joint_position"]
    assert (arm.names, hand.names, len(arm.time), len(hand.time)) == (tuple(JOINTS), ("finger",), 6, 2)
    reversed_ = what[2][3]  # in another order, the same joints
    np.testing.assert_array_equal(arm.value[1], reversed_.position[::-1])
    assert [log.streams[f"imu/{i}/gyroscope"].frame for i in (0, 1)] == ["left", "right"]
    assert any("several frames or sets of joints" in line and "finger" in line for line in log.notes)


def test_clock_and_topics(tmp_path):
    path = record(tmp_path / "log.mcap", messages(TWO, 10))
    log = bags.read(path, clock="bag", topics=["imu/data"])
    assert set(log.streams) == {f"imu/data/{k}" for k in ("gyroscope", "accelerometer", "orientation")}
    np.testing.assert_allclose(log.streams["imu/data/gyroscope"].time[0] - START / NS, 0.0015, atol=1e-6)
    with pytest.raises(InputError, match="'/imu/dta' does not exist; did you mean '/imu/data'"):
        bags.read(path, topics=["/imu/dta"])
    with pytest.raises(InputError, match=r"none of its topics can be read: .*/chatter \(std_msgs/msg/String\)"):
        bags.read(path, topics=["/chatter"])
    with pytest.raises(ValueError, match="clock"):
        bags.read(path, clock="header ")


def test_stamps_of_headers_that_nobody_set(tmp_path):
    rng = np.random.default_rng(6)
    what = [("/imu", "sensor_msgs/msg/Imu", START + i * NS, imu(TWO, 0, rng)) for i in range(3)]
    log = read(record(tmp_path / "log.mcap", what))
    np.testing.assert_array_equal(log.streams["imu/gyroscope"].time, START / NS + np.arange(3))
    assert any("all headers are 0" in line for line in log.notes)
    what[2][3].header.stamp.sec = 5
    with pytest.raises(InputError, match=r"duplicate.*clock='bag'"):
        read(record(tmp_path / "twice.mcap", what))
    assert len(bags.read(tmp_path / "twice.mcap", clock="bag").streams["imu/gyroscope"].time) == 3


def test_a_table_renames_streams(tmp_path):
    path = record(tmp_path / "log.mcap", messages(TWO, 10))
    where = "imu/data/gyroscope"
    log = read(path, {"gyroscope": {"array": f"{where}/value", "time": f"{where}/time", "frame": "imu"}})
    np.testing.assert_array_equal(log.streams["gyroscope"].value, read(path).streams[where].value)


def test_custom_definitions_and_types_that_nobody_knows(tmp_path):
    """A bag's own definition counts; a type that cannot even be parsed is only listed."""
    rng = np.random.default_rng(7)
    path = record(tmp_path / "log.bag", messages(ONE, 5))
    log = read(path)
    assert log.streams["imu/data/gyroscope"].value.shape == (5, 3)
    own = get_types_from_msg("float64 x\nmy_msgs/Unknown y\n", "my_msgs/msg/Mine")
    assert own
    folder = tmp_path / "folder"
    with rosbag2.Writer(folder, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        odd = writer.add_connection("/odd", "my_msgs/msg/Mine", msgdef="this is ( no definition", rihs01="RIHS01_0")
        good = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=TWO)
        writer.write(odd, START, b"\0\1\0\0")
        raw = TWO.serialize_cdr(imu(TWO, START, rng), "sensor_msgs/msg/Imu")
        writer.write(good, START, raw)
    log = read(folder)
    assert "imu/gyroscope" in log.streams
    assert "left out: /odd (my_msgs/msg/Mine, 1 messages)" in log.notes


def gyroscope(path, **options):
    return bags.read(path, **options).streams["imu/data/gyroscope"]


@pytest.mark.parametrize("name", ["log.bag", "log.mcap", "folder"])
def test_truncated(tmp_path, name):
    """Beyond a chunk's end, in the middle of a record, and where only the index is gone."""
    store = ONE if name.endswith(".bag") else TWO
    n = 4000
    rng = np.random.default_rng(8)
    what = [("/imu/data", "sensor_msgs/msg/Imu", START + i * NS, imu(store, START + i * NS, rng)) for i in range(n)]
    path = record(tmp_path / name, what)
    file = next(path.glob("*.mcap")) if path.is_dir() else path
    whole, data = gyroscope(path), file.read_bytes()
    kept = []
    for share in (0.7, 0.95, 1 - 30 / len(data)):
        file.write_bytes(data[: int(share * len(data))])
        with pytest.raises(
            InputError, match=rf"{name}: .*(byte \d+|index).*\d+ messages can be read, until \d+"
        ) as error:
            read(path)
        with pytest.raises(InputError, match="partial=True"):
            bags.read(path)
        log = bags.read(path, partial=True)
        part = log.streams["imu/data/gyroscope"]
        kept.append(len(part.time))
        np.testing.assert_array_equal(part.value, whole.value[: kept[-1]])
        np.testing.assert_array_equal(part.time, whole.time[: kept[-1]])
        assert f" {kept[-1]} messages can be read" in str(error.value)
        assert "incomplete" in log.notes[0]
    assert 0 < kept[0] < n
    assert kept[-1] == n
    file.write_bytes(data[:3])
    with pytest.raises(InputError, match="no message can be read"):
        read(path)


def with_checksums(data):
    """An MCAP file whose chunks state their checksums, which rosbags does not write."""
    data, at = bytearray(data), 8
    while at + 9 < len(data):
        op, length = struct.unpack_from("<BQ", data, at)
        if op == 0x06:
            (size,) = struct.unpack_from("<I", data, at + 9 + 28)
            struct.pack_into("<I", data, at + 9 + 24, zlib.crc32(data[at + 9 + 40 + size : at + 9 + length]))
        at += 9 + length
    return bytes(data)


@pytest.mark.parametrize("name", ["log.bag", "log.mcap"])
def test_a_damaged_chunk(tmp_path, name):
    store, compression = (ONE, "BZ2") if name == "log.bag" else (TWO, None)
    n = 5000
    rng = np.random.default_rng(9)
    what = [("/imu/data", "sensor_msgs/msg/Imu", START + i * NS, imu(store, START + i * NS, rng)) for i in range(n)]
    path = record(tmp_path / name, what, compression=compression)
    whole, data = gyroscope(path), path.read_bytes()
    data = with_checksums(data) if name == "log.mcap" else data
    path.write_bytes(data)
    np.testing.assert_array_equal(gyroscope(path).value, whole.value)
    place = int({"log.bag": 0.85, "log.mcap": 0.8}[name] * len(data))
    path.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
    with pytest.raises(InputError, match=r"the chunk at byte \d+ is damaged.*\d+ messages can be read"):
        read(path)
    part = gyroscope(path, partial=True)
    assert 0 < len(part.time) < n
    np.testing.assert_array_equal(part.value, whole.value[: len(part.time)])


def test_a_damaged_index(tmp_path):
    path = record(tmp_path / "log.bag", messages(ONE))
    data = path.read_bytes()
    place = data.rindex(b"conn=")
    path.write_bytes(data[:place] + b"nonc=" + data[place + 5 :])
    with pytest.raises(InputError, match=r"has an index that cannot be used .*; 164 messages can be read"):
        read(path)
    assert_as_rosbags(bags.read(path, partial=True), by_rosbags(record(tmp_path / "good.bag", messages(ONE))))


def test_a_truncated_database(tmp_path):
    rng = np.random.default_rng(10)
    what = [("/imu/data", "sensor_msgs/msg/Imu", START + i * NS, imu(TWO, START + i * NS, rng)) for i in range(2000)]
    path = record(tmp_path / "log.db3", what)
    whole, data = gyroscope(path), path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=r"malformed|corrupt|not a database"):
        read(path)
    part = gyroscope(path, partial=True)
    assert 0 < len(part.time) < 2000
    np.testing.assert_array_equal(part.value, whole.value[: len(part.time)])


@pytest.mark.parametrize("name", ["log.bag", "log.mcap", "log.db3"])
def test_the_scan_finds_what_rosbags_finds(tmp_path, name):
    path = record(tmp_path / name, messages(ONE if name.endswith(".bag") else TWO))
    found = []
    for source in (bag_scan.indexed, bag_scan.scan):
        channels = {}
        found.append(sorted((channels[k].topic, channels[k].kind, t, raw) for k, t, raw in
                            source(path, channels, lambda channel: True)))  # fmt: skip
    assert found[0] == found[1]
    assert len(found[0]) == 204


def test_written_mcap_reads_back(tmp_path):
    time = 1_700_000_000 + np.arange(5) * 0.25
    rng = np.random.default_rng(11)
    quat = rng.normal(size=(5, 4))
    log = SensorLog(
        {
            "imu0/gyroscope": Stream(time, rng.normal(size=(5, 3)), "rad/s", "imu0"),
            "imu0/accelerometer": Stream(time[1:] - 0.125, rng.normal(size=(4, 3)), "m/s2", "imu0"),
            "imu0/magnetometer": Stream(time, 1e-5 * rng.normal(size=(5, 3)), "T", "imu0"),
            "arm/joint_position": Stream(time, rng.normal(size=(5, 2)), "rad", "", ("a", "b")),
            "arm/joint_torque": Stream(time[::2], rng.normal(size=(3, 2)), "Nm", "", ("a", "b")),
            "tool/position": Stream(time, rng.normal(size=(5, 3)), "m", "map"),
            "tool/orientation": Stream(time, quat, "1", "map"),
            "orientation": Stream(time, quat, "1"),
            "tip/position": Stream(time, rng.normal(size=(5, 3)), "m", "map"),
            "covariance": Stream(time, rng.normal(size=(5, 3, 3))),
            "battery": Stream(time, rng.normal(size=5)),
        }
    )
    write(log, tmp_path / "log.mcap")
    found = read(tmp_path / "log.mcap")
    assert set(found.streams) == set(log.streams)
    for name, item in log.streams.items():
        other = found.streams[name]
        np.testing.assert_array_equal(other.time, item.time, err_msg=name)
        np.testing.assert_array_equal(other.value, item.value, err_msg=name)
        assert other[2:5] == item[2:5], name
    types = {topic: m[0][1].__msgtype__ for topic, m in by_rosbags(tmp_path / "log.mcap").items()}
    assert types["/imu0"] == "sensor_msgs/msg/Imu"
    assert types["/arm"] == "sensor_msgs/msg/JointState"
    assert types["/tool"] == "geometry_msgs/msg/PoseStamped"
    assert types["/battery"] == "std_msgs/msg/Float64MultiArray"


def test_written_mcap_is_in_si_and_refuses_what_ros_cannot_hold(tmp_path):
    time = np.arange(3.0)
    degrees = Stream(time, np.full((3, 3), 180.0), "deg/s")
    write(SensorLog({"gyroscope": degrees}), tmp_path / "log.mcap")
    np.testing.assert_allclose(read(tmp_path / "log.mcap").streams["imu/gyroscope"].value, np.pi)
    with pytest.raises(InputError, match="exists already"):
        write(SensorLog({"gyroscope": degrees}), tmp_path / "log.mcap")
    with pytest.raises(InputError, match="stamps from -1"):
        write(SensorLog({"gyroscope": degrees._replace(time=time - 1)}), tmp_path / "new.mcap")
    assert not (tmp_path / "new.mcap").exists()
