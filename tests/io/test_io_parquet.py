"""Parquet: our own layout bit for bit, other people's columns, and files that are damaged."""

import datetime

import numpy as np
import pytest

from jaxest.io import SensorLog, Stream, propose, read, write
from jaxest.types import InputError

pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

RNG = np.random.default_rng(0)


def example() -> SensorLog:
    rng = np.random.default_rng(3)
    time = np.array([0.0, 0.1, 0.25, 1.0 / 3])
    wild = np.array([np.nan, np.inf, -0.0, 5e-324])
    return SensorLog(
        {
            "imu0/gyroscope": Stream(
                time, rng.normal(size=(4, 3)).astype(np.float32), "rad/s", "imu0", ("x", "y", "z")
            ),
            "map": Stream(time[:2] + 0.01, rng.normal(size=(2, 2, 3)), "m", extra={"rig": {"serial": [3, 1]}}),
            "wild": Stream(time, wild),
            "half": Stream(time, np.array([[0.5, np.nan]] * 4, np.float16)),
            "ticks": Stream(time[1:], np.array([2**63 - 1, -(2**63), 0])),
            "big": Stream(time, np.array([2**64 - 1, 0, 1, 2], np.uint64)),
            "movement": Stream(time[:3], np.array([True, False, True])),
            "row": Stream(time, np.arange(4, dtype=np.uint8)[:, None]),
        }
    )


def assert_same(log, other):
    assert set(log.streams) == set(other.streams)
    for name, item in log.streams.items():
        found = other.streams[name]
        assert found.time.tobytes() == item.time.tobytes(), name
        assert (found.value.dtype, found.value.shape) == (item.value.dtype, item.value.shape), name
        assert found.value.tobytes() == item.value.tobytes(), name
        assert found[2:] == item[2:], name


@pytest.mark.parametrize("suffix", [".parquet", ".h5"])
def test_round_trip_is_exact(tmp_path, suffix):
    pytest.importorskip({".parquet": "pyarrow", ".h5": "h5py"}[suffix])
    path = tmp_path / f"log{suffix}"
    write(example(), path)
    assert_same(example(), read(path))
    with pytest.raises(InputError, match="exists already"):
        write(example(), path)
    write(example(), path, overwrite=True)
    with pytest.raises(InputError, match="own layout"):
        propose(path)


def people(path, **kwargs):
    n = 50
    time = np.arange(n) / 100
    gyr = np.stack([np.sin(time), np.cos(time), time], axis=-1)
    acc = np.array([0.1, 0.2, 9.8]) + 0 * gyr
    columns = {
        "t": time,
        "gyr": pa.array(gyr.tolist()),
        "acc": pa.FixedSizeListArray.from_arrays(pa.array(acc.ravel()), 3),
        "note": ["x"] * n,
        "imu": pa.array([{"mx": 2e-5, "my": 1e-5, "mz": 4e-5}] * n),
    }
    parquet.write_table(pa.table({**columns, **kwargs}), path)
    return time, gyr, acc


def test_other_peoples_lists_and_structs(tmp_path):
    path = tmp_path / "log.parquet"
    time, gyr, acc = people(path)
    log = read(path)
    np.testing.assert_array_equal(log.streams["gyroscope"].time, time)
    np.testing.assert_array_equal(log.streams["gyroscope"].value, gyr)
    np.testing.assert_array_equal(log.streams["accelerometer"].value, acc)
    assert any("note" in line for line in log.notes)
    table = {
        "time": "t",
        "magnetometer": {"columns": ["imu.mx", "imu.my", "imu.mz"], "unit": "T"},
        "imu0/gyroscope": {"array": "gyr", "unit": "deg/s"},
    }
    log = read(path, table)
    np.testing.assert_allclose(log.streams["imu0/gyroscope"].value, np.deg2rad(gyr))
    np.testing.assert_array_equal(log.streams["magnetometer"].value[7], [2e-5, 1e-5, 4e-5])
    with pytest.raises(InputError, match="'gyr'"):
        read(path, {"time": "t", "gyroscope": {"array": "gry"}})


def test_null_cells_are_no_samples_and_dates_are_stamps(tmp_path):
    n = 5
    start = datetime.datetime(2026, 5, 1, tzinfo=datetime.UTC)
    stamps = [start + datetime.timedelta(milliseconds=10 * i) for i in range(n)]
    columns = {
        "time": stamps,
        "q1": [1, None, 3, 4, None],
        "q2": [10, 20, None, 40, None],
        "n": [[1.0], [1.0, 2.0], None, [], []],
    }
    parquet.write_table(pa.table(columns), tmp_path / "log.parquet")
    log = read(tmp_path / "log.parquet", {"time": "time", "joint_position": {"columns": ["q1", "q2"], "unit": "deg"}})
    item = log.streams["joint_position"]
    np.testing.assert_allclose(item.time, start.timestamp() + np.arange(4) / 100, atol=1e-6)
    np.testing.assert_allclose(np.rad2deg(item.value), [[1, 10], [np.nan, 20], [3, np.nan], [4, 40]])
    with pytest.raises(InputError, match="lists of 0 to 2 numbers"):
        read(tmp_path / "log.parquet", {"time": "time", "x": {"array": "n"}})


def test_stamps_in_nanoseconds_with_gaps_stay_whole(tmp_path):
    stamps = [1_700_000_000_123_456_789, None, 1_700_000_000_223_456_789]
    parquet.write_table(pa.table({"stamp": stamps, "x": [1.0, None, 3.0]}), tmp_path / "log.parquet")
    log = read(tmp_path / "log.parquet", {"time": "stamp", "time_unit": "ns", "x": {"array": "x"}})
    np.testing.assert_array_equal(log.streams["x"].time, [1_700_000_000 + 0.123456789, 1_700_000_000 + 0.223456789])


def test_truncated_and_damaged(tmp_path):
    path = tmp_path / "log.parquet"
    n = 20_000
    table = pa.table({"t": np.arange(n) / 100.0, "x": RNG.normal(size=n)})
    parquet.write_table(table, path, row_group_size=5000, write_page_checksum=True, compression="none")
    good = path.read_bytes()
    path.write_bytes(good[: len(good) // 2])
    with pytest.raises(InputError, match=r"log\.parquet.*truncated one nothing can be read"):
        read(path)
    bad = bytearray(good)
    bad[int(0.6 * len(good))] ^= 0xFF
    path.write_bytes(bad)
    with pytest.raises(InputError, match=r"damaged behind row 10000 of 20000 .*the 10000 rows before can be read"):
        read(path)
    path.write_text("t,x\n1,2\n")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        read(path)


def test_metadata_that_do_not_fit(tmp_path):
    path = tmp_path / "log.parquet"
    write(example(), path)
    table = parquet.read_table(path)
    for text, words in (
        (b"{", "not JSON"),
        (b"[]", "object for each stream"),
        (b'{"gone": {"shape": [], "dtype": "float64"}}', "'gone' is missing"),
        (b'{"wild": {"shape": [2], "dtype": "float64"}}', "its metadata say"),
        (b'{"wild": {"shape": []}}', "shape and dtype"),
    ):
        parquet.write_table(table.replace_schema_metadata({b"jaxest-log": text}), path)
        with pytest.raises(InputError, match=words):
            read(path)


@pytest.mark.parametrize(
    ("name", "module"),
    [("x.parquet", "pyarrow"), ("x.h5", "h5py"), ("x.mcap", "rosbags"), ("x.bag", "rosbags")],
)
def test_an_extra_that_is_missing_is_named(tmp_path, monkeypatch, name, module):
    monkeypatch.setitem(__import__("sys").modules, module, None)
    for part in ("parquet", "rosbag1", "rosbag2", "typesys"):
        monkeypatch.setitem(__import__("sys").modules, f"{module}.{part}", None)
    extra = {"pyarrow": "parquet", "h5py": "hdf5", "rosbags": "bags"}[module]
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(InputError, match=rf"{name}: needs {module}.*pip install 'jaxest\[{extra}\]'"):
        read(tmp_path / name)
    if not name.endswith(".bag"):
        with pytest.raises(InputError, match=rf"pip install 'jaxest\[{extra}\]'"):
            write(example(), tmp_path / f"new{name}")
        assert not (tmp_path / f"new{name}").exists()
