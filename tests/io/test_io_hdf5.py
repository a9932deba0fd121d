"""HDF5: other people's datasets, and files that are damaged; the round trip is tested beside Parquet's."""

import numpy as np
import pytest

from jaxest.io import SensorLog, Stream, read, write
from jaxest.types import InputError

h5py = pytest.importorskip("h5py")
N = 60
TIME = np.arange(N) / 200
GYR = np.stack([np.sin(TIME), np.cos(TIME), TIME], axis=-1).astype(np.float32)
ACC = (np.array([0.1, 0.2, 9.8]) + 0 * GYR).astype(">f4")


def people(path):
    with h5py.File(path, "w") as file:
        file.attrs["fs"] = 200.0
        file.attrs["author"] = "somebody"
        group = file.create_group("imu")
        group["gyr"], group["acc"] = GYR, ACC
        group["label"] = ["walk"] * N
        pairs = np.zeros(N // 2, [("stamp_us", "<i8"), ("q1", "<f8"), ("word", "S3")])
        pairs["stamp_us"], pairs["q1"] = (
            (TIME * 1e6).round()[::2],
            np.arange(N // 2) / 10,
        )  # an angle in rad, by its size
        file["samples"] = pairs
        file["link"] = h5py.ExternalLink("elsewhere.h5", "/x")


def test_other_peoples_datasets(tmp_path):
    people(tmp_path / "log.h5")
    log = read(tmp_path / "log.h5")
    np.testing.assert_array_equal(log.streams["gyroscope"].value, GYR)
    np.testing.assert_array_equal(log.streams["accelerometer"].value, ACC)
    assert log.streams["accelerometer"].value.dtype == np.dtype("=f4")
    np.testing.assert_allclose(log.streams["gyroscope"].time, TIME)
    assert any("imu/label" in line and "text" in line for line in log.notes)


def test_a_table_names_datasets_members_and_attributes(tmp_path):
    people(tmp_path / "log.hdf5")
    table = {
        "gyroscope": {"array": "imu/gyr", "rate": "@fs", "unit": "deg/s"},
        "joint_position": {"array": "samples.q1", "time": "samples.stamp_us", "time_unit": "us", "unit": "deg"},
    }
    log = read(tmp_path / "log.hdf5", table)
    np.testing.assert_allclose(log.streams["gyroscope"].value, np.deg2rad(GYR), rtol=1e-6)
    np.testing.assert_allclose(log.streams["joint_position"].value, np.deg2rad(np.arange(N // 2) / 10))
    np.testing.assert_allclose(log.streams["joint_position"].time, TIME[::2])
    with pytest.raises(InputError, match="dataset 'imu/gry' does not exist; did you mean 'imu/gyr'"):
        read(tmp_path / "log.hdf5", {"rate": 1.0, "gyroscope": {"array": "imu/gry"}})
    with pytest.raises(InputError, match="does not hold numbers"):
        read(tmp_path / "log.hdf5", {"rate": 1.0, "x": {"array": "samples.word"}})


def test_truncated_and_damaged(tmp_path):
    path = tmp_path / "log.h5"
    rows = np.random.default_rng(1).normal(size=(3000, 3))
    stamps = np.arange(3000.0)
    write(SensorLog({"gyroscope": Stream(stamps, rows), "other": Stream(stamps, rows[:, 0])}), path)
    good = path.read_bytes()
    path.write_bytes(good[:-2000])
    with pytest.raises(InputError, match=r"log\.h5: not a readable HDF5 file.*truncated"):
        read(path)
    place = good.index(rows[1500, :1].tobytes())
    path.write_bytes(good[:place] + bytes([good[place] ^ 1]) + good[place + 1 :])
    with pytest.raises(InputError, match=r"'gyroscope/value' cannot be read .*; \d other datasets can be read"):
        read(path)
    path.write_bytes(b"no HDF5 at all")
    with pytest.raises(InputError, match="not a readable HDF5"):
        read(path)
    with h5py.File(path, "w"):
        pass
    with pytest.raises(InputError, match="empty"):
        read(path)


def test_a_dataset_that_claims_more_than_there_is(tmp_path):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("huge", (2**40,), "f8", chunks=(2**16,))
        file["t"], file["gyr"] = TIME, GYR
    with pytest.raises(InputError, match="'huge' claims 8796093022208 bytes"):
        read(path)
    log = read(path, {"time": "t", "gyroscope": {"array": "gyr"}})
    np.testing.assert_array_equal(log.streams["gyroscope"].value, GYR)
