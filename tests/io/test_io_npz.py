"""The NPZ form: bit for bit, whole or not at all, never a pickle."""

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxest.io import SensorLog, Stream, read, write
from jaxest.types import InputError

TIME = np.array([0.0, 0.1, 0.25])
DTYPES = ["float64", "float32", "float16", "int64", "int32", "uint8", "uint64", "bool"]


def same(a: SensorLog, b: SensorLog) -> bool:
    """Bit for bit, dtypes and metadata included."""

    def described(log):
        return {n: (s.time.tobytes(), s.value.tobytes(), str(s.value.dtype), np.shape(s.value), *s[2:])
                for n, s in log.streams.items()}  # fmt: skip

    return described(a) == described(b) and list(a.streams) == list(b.streams)


def example() -> SensorLog:
    return SensorLog(
        {
            "imu0/gyroscope": Stream(TIME, np.eye(3, dtype=np.float32), "rad/s", "imu0"),
            "joint_position": Stream(
                TIME[:2], np.array([[1.0], [np.nan]]), "rad", "", ("elbow",), {"robot": "arm", "gear": [1, 2]}
            ),
            "pose/covariance": Stream(TIME, np.arange(12.0).reshape(3, 2, 2)),
            "contact": Stream(TIME, np.array([True, False, True])),
        }
    )


@st.composite
def logs(draw):
    streams = {}
    some = st.sampled_from(["a", "imu0/acc", "b,c", "ü", 'q"', "time"])
    names = draw(st.lists(some, min_size=1, max_size=4, unique=True))
    for name in names:
        n = draw(st.integers(1, 5))
        stamps = st.floats(-1e10, 1e10, allow_nan=False)
        time = np.sort(np.array(draw(st.lists(stamps, min_size=n, max_size=n, unique=True))))
        if (np.diff(time) <= 0).any():  # -0.0 and 0.0
            time = np.arange(n, dtype=np.float64)
        dtype = np.dtype(draw(st.sampled_from(DTYPES)))
        shape = (n, *draw(st.sampled_from([(), (1,), (3,), (2, 2)])))
        count = int(np.prod(shape)) * dtype.itemsize
        raw = draw(st.binary(min_size=count, max_size=count))
        bits = np.frombuffer(raw, np.uint8) & 1 if dtype.kind == "b" else np.frombuffer(raw, np.uint8)
        value = bits.view(dtype).reshape(shape).copy()
        if dtype.kind == "f":
            value[np.isnan(value)] = np.nan  # NaN has one face here
        streams[name] = Stream(time, value, draw(st.sampled_from(["", "rad/s"])), draw(st.text(max_size=3)))
    return SensorLog(streams)


@settings(max_examples=40, deadline=None)
@given(logs(), st.sampled_from([".npz", ".csv"]))
def test_round_trip_of_any_log(tmp_path_factory, log, suffix):
    path = tmp_path_factory.mktemp("round") / f"log{suffix}"
    write(log, path)
    assert same(read(path), log)


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_round_trip_keeps_names_extra_and_shapes(tmp_path, suffix):
    write(example(), tmp_path / f"log{suffix}")
    back = read(tmp_path / f"log{suffix}")
    assert same(back, example())
    assert back.source.endswith(suffix)
    assert back.streams["joint_position"].names == ("elbow",)


def test_layout_is_the_documented_one(tmp_path):
    write(example(), tmp_path / "log.npz")
    with np.load(tmp_path / "log.npz", allow_pickle=False) as arrays:
        assert arrays["imu0/gyroscope/value"].dtype == np.float32
        assert arrays["imu0/gyroscope/time"].dtype == np.float64
        meta = json.loads(str(arrays["joint_position/meta"]))
    assert meta == {"unit": "rad", "frame": "", "names": ["elbow"], "robot": "arm", "gear": [1, 2]}


def test_a_log_that_numpy_wrote_is_read(tmp_path):
    value = np.asfortranarray(np.arange(9.0).reshape(3, 3)).astype(">f4")
    meta = json.dumps({"unit": "m/s2", "frame": "hand", "serial": 7})
    np.savez_compressed(
        tmp_path / "log.npz",
        **{"accelerometer/time": np.arange(3), "accelerometer/value": value, "accelerometer/meta": np.array([meta])},
    )
    stream = read(tmp_path / "log.npz").streams["accelerometer"]
    np.testing.assert_array_equal(stream.value, value)
    assert (stream.unit, stream.frame, stream.extra) == ("m/s2", "hand", {"serial": 7})
    assert stream.time.dtype == np.float64
    assert stream.value.dtype == np.float32


def broken(tmp_path: Path, **arrays) -> Path:
    np.savez(tmp_path / "log.npz", **arrays)
    return tmp_path / "log.npz"


META = np.array('{"unit": "rad/s", "frame": ""}')


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"x/value": np.zeros(3), "x/meta": META, "y/time": TIME, "y/value": TIME}, ["'x/time'", "missing"]),
        ({"x/time": TIME, "y/time": TIME, "y/value": TIME}, ["'x/value'", "missing"]),
        ({"x/time": TIME, "x/value": TIME, "x/meta": np.array("{")}, ["'x/meta'", "not JSON"]),
        ({"x/time": TIME, "x/value": TIME, "x/meta": np.array("[1]")}, ["'x/meta'", "object"]),
        ({"x/time": TIME, "x/value": TIME, "x/meta": np.zeros(2)}, ["'x/meta'", "text"]),
        ({"x/time": TIME, "x/value": np.array([{}, 1, 2], object)}, ["x/value", "pickled"]),
        ({"x/time": TIME, "x/value": TIME, "x/meta": np.array({}, object)}, ["x/meta", "pickled"]),
        ({"x/time": TIME[::-1], "x/value": TIME}, ["row 1", "earlier"]),
        ({"x/time": TIME, "x/value": np.zeros((2, 3))}, ["(2, 3)", "(3,)"]),
        ({"x/time": TIME, "x/value": np.array(["a", "b", "c"])}, ["<U1"]),
        ({"x/time": np.array(["a", "b", "c"]), "x/value": TIME}, ["time is <U1"]),
        ({"x/time": TIME, "x/value": np.zeros(3, [("a", float)])}, ["x/value", "structured"]),
    ],
)
def test_a_bad_log_is_refused_by_name(tmp_path, arrays, words):
    with pytest.raises(InputError) as error:
        read(broken(tmp_path, **arrays))
    for word in ["log.npz", *words]:
        assert word in str(error.value)


def test_missing_meta_is_noted(tmp_path):
    log = read(broken(tmp_path, **{"x/time": TIME, "x/value": TIME}))
    assert log.streams["x"].unit == ""
    assert "x/meta" in log.notes[0]


def npy(shape, data=b"", descr="<f8") -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})
    return file.getvalue() + data


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ([("readme.txt", b"hello")], ["readme.txt", "not a .npy"]),
        ([("a/time.npy", b"hello there")], ["a/time", ".npy format"]),
        ([("a/time.npy", npy((10**15,)))], ["a/time", "8000000000000000 bytes"]),
        ([("a/time.npy", npy((2**62, 2**62)))], ["a/time"]),
        ([("a/time.npy", npy((-4,), b"\0" * 32))], ["(-4,)"]),
        ([("a/time.npy", npy((3,), b"\0" * 16))], ["a/time", "24 bytes"]),
        ([("a/time.npy", npy((3,), b"\0" * 40))], ["a/time", "another number"]),
        ([("../time.npy", npy((1,), b"\0" * 8)), ("../value.npy", npy((1,), b"\0" * 8))], ["'..'", "usable name"]),
        ([("/etc/time.npy", npy((1,), b"\0" * 8)), ("/etc/value.npy", npy((1,), b"\0" * 8))], ["usable name"]),
        ([], ["empty"]),
    ],
)
def test_absurd_members(tmp_path, members, words):
    path = tmp_path / "log.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members:
            archive.writestr(name, data)
    with pytest.raises(InputError) as error:
        read(path)
    for word in words:
        assert word in str(error.value)


def test_a_member_twice(tmp_path):
    path = tmp_path / "log.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a/time.npy", npy((1,), b"\0" * 8))
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("a/time.npy", npy((1,), b"\0" * 8))
    with pytest.raises(InputError, match="twice"):
        read(path)


def test_a_member_that_claims_to_unpack_to_gigabytes(tmp_path):
    path = tmp_path / "log.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/time.npy", npy((1000,), b"\0" * 8000))
    data = bytearray(path.read_bytes())
    at = data.index(b"PK\x01\x02") + 24  # uncompressed size in the central directory
    data[at : at + 4] = struct.pack("<I", 2**32 - 10)
    path.write_bytes(data)
    with pytest.raises(InputError, match="claims 4294967286 bytes"):
        read(path)


@pytest.mark.parametrize("cut", [10, 200, -30])
def test_truncated_text_and_empty_files(tmp_path, cut):
    path = tmp_path / "log.npz"
    write(example(), path)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(InputError, match="not a readable NPZ"):
        read(path)


def test_a_flipped_bit_is_noticed(tmp_path):
    path = tmp_path / "log.npz"
    write(example(), path)
    data = bytearray(path.read_bytes())
    at = data.index(np.eye(3, dtype=np.float32).tobytes())
    data[at] ^= 1
    path.write_bytes(data)
    with pytest.raises(InputError, match="CRC"):
        read(path)


def test_no_such_file_text_empty_folder_and_suffix(tmp_path):
    (tmp_path / "log.csv").write_text("time\n1\n")
    with pytest.raises(InputError, match=r"no such file; beside it: log\.csv"):
        read(tmp_path / "log.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(InputError, match="not a readable NPZ"):
        read(tmp_path / "text.npz")
    (tmp_path / "empty.npz").touch()
    with pytest.raises(InputError, match="empty"):
        read(tmp_path / "empty.npz")
    with pytest.raises(InputError, match="folder"):
        read(tmp_path)
    (tmp_path / "log.dat").write_text("x")
    with pytest.raises(InputError, match=r"read as \.npz, \.csv, .*\.bag.*, not \.dat"):
        read(tmp_path / "log.dat")
    with pytest.raises(InputError, match=r"written as \.npz, \.csv, .*, not \.bag"):
        write(example(), tmp_path / "log.bag")
    with pytest.raises(InputError, match=r"written as \.npz, \.csv, .*, not without suffix"):
        write(example(), tmp_path / "log")


@pytest.mark.parametrize("name", ["log.npz", "log.csv"])
def test_nothing_is_overwritten_unasked(tmp_path, name):
    path = tmp_path / name
    path.write_text("precious")
    with pytest.raises(InputError, match="--force"):
        write(example(), path)
    assert path.read_text() == "precious"
    write(example(), path, overwrite=True)
    assert same(read(path), example())
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_a_failed_write_leaves_nothing_behind(tmp_path, monkeypatch):
    path = tmp_path / "log.npz"
    path.write_text("precious")

    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np.lib.format, "write_array", full)
    with pytest.raises(InputError, match="No space left"):
        write(example(), path, overwrite=True)
    assert path.read_text() == "precious"
    assert [p.name for p in tmp_path.iterdir()] == ["log.npz"]


def test_unwritable_output(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="does not exist"):
        write(example(), tmp_path / "absent" / "log.npz")
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        write(example(), tmp_path / "folder.npz", overwrite=True)
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(InputError, match="permission denied"):
        write(example(), tmp_path / "log.npz")


def test_bad_logs_and_metadata_are_not_written(tmp_path):
    path = tmp_path / "log.npz"
    with pytest.raises(InputError, match="duplicate"):
        write(SensorLog({"x": Stream(np.zeros(2), np.zeros(2))}), path)
    with pytest.raises(InputError, match="JSON"):
        write(SensorLog({"x": Stream(TIME, TIME, extra={"a": {1, 2}})}), path)
    assert not path.exists()


def test_pickled_members_hurt_only_who_asks(tmp_path):
    path = broken(tmp_path, gyr=np.zeros((3, 3)), t=TIME, info=np.array({"subject": 1}, object))
    log = read(path)
    assert log.streams["gyroscope"].value.shape == (3, 3)
    assert any("info" in note and "pickled" in note for note in log.notes)
    with pytest.raises(InputError, match="'info' holds pickled"):
        read(path, {"time": "t", "x": {"array": "info"}})
    (tmp_path / "only").mkdir()
    with pytest.raises(InputError, match="'info' holds pickled"):
        read(broken(tmp_path / "only", info=np.array({"subject": 1}, object)))


def test_a_table_for_another_file_is_passed_over(tmp_path):
    path = tmp_path / "log.npz"
    write(example(), path)
    assert same(read(path, {"time": "t", "gyroscope": {"array": "gyr"}}), example())
    table = {"time": "contact/time", "touch": {"array": "contact/value"}}
    assert list(read(path, table).streams) == ["touch"]
    with pytest.raises(InputError, match="'tiem'"):
        read(path, {"tiem": "t", "gyroscope": {"array": "gyr"}})
