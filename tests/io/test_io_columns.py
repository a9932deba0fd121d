"""The `[columns]` table: units, clocks, columns of arrays, and every way of getting it wrong."""

import tomllib

import numpy as np
import pytest

from jaxest.io import Column, ColumnTable, read, to_toml
from jaxest.io.columns import parse
from jaxest.io.raw import Raw
from jaxest.io.table_streams import apply
from jaxest.io.units import UNITS, convert, lookup, seconds
from jaxest.types import InputError

N = 4


def raw(**arrays):
    return Raw("run.npz", {name: np.asarray(value) for name, value in arrays.items()})


def stream(table, name="gyroscope", **arrays):
    return apply(raw(**arrays), table).streams[name]


@pytest.mark.parametrize(
    ("name", "unit", "si", "factor"),
    [
        ("gyroscope", "deg/s", "rad/s", np.pi / 180),
        ("gyroscope", "°/s", "rad/s", np.pi / 180),
        ("gyroscope", "dps", "rad/s", np.pi / 180),
        ("accelerometer", "g", "m/s2", 9.80665),
        ("accelerometer", "mg", "m/s2", 9.80665e-3),
        ("accelerometer", "m/s^2", "m/s2", 1.0),
        ("accelerometer", "m / s²", "m/s2", 1.0),
        ("magnetometer", "uT", "T", 1e-6),
        ("magnetometer", "µT", "T", 1e-6),
        ("magnetometer", "gauss", "T", 1e-4),
        ("magnetometer", "mG", "T", 1e-7),
        ("magnetometer", "nT", "T", 1e-9),
        ("range", "mm", "m", 1e-3),
        ("joint_torque", "N m", "Nm", 1.0),
        ("joint_position", "deg", "rad", np.pi / 180),
    ],
)
def test_units_become_si_and_float32_stays(name, unit, si, factor):
    value = np.full((N, 3), 2.5, np.float32)
    found = stream({name: {"array": "a", "unit": unit, "rate": 10}}, name, a=value)
    assert found.unit == si
    assert found.value.dtype == np.float32
    np.testing.assert_allclose(found.value, 2.5 * factor, rtol=1e-7)


def test_every_unit_leads_to_one_that_is_its_own():
    for name, unit in UNITS.items():
        assert UNITS[unit.si] == (unit.si, 1.0, 0.0), name
    assert convert(np.array([25.0]), lookup("degC"))[0] == 298.15


def test_scale_and_offset_come_before_the_unit():
    value = np.array([[100, 200, 300]] * N, np.int16)
    table = {"gyroscope": {"array": "a", "scale": [0.1, 0.2, 0.3], "offset": -1, "unit": "deg/s", "rate": 10}}
    found = stream(table, a=value).value
    np.testing.assert_allclose(found, np.deg2rad([[9, 39, 89]] * N))


def test_stamps_and_columns_inside_one_array():
    data = np.arange(N * 8.0).reshape(N, 8)
    table = {
        "time_unit": "ms",
        "imu0/gyroscope": {"array": "imu0", "columns": [2, 3, 4], "time": 0, "frame": "wrist"},
        "imu0/accelerometer": {"array": "imu0", "columns": [5, 6, 7], "time": 1, "time_unit": "s"},
    }
    log = apply(raw(imu0=data), table)
    np.testing.assert_array_equal(log.streams["imu0/gyroscope"].value, data[:, 2:5])
    np.testing.assert_allclose(log.streams["imu0/gyroscope"].time, data[:, 0] * 1e-3)
    np.testing.assert_array_equal(log.streams["imu0/accelerometer"].time, data[:, 1])
    assert log.streams["imu0/gyroscope"].frame == "wrist"


def test_rates_by_number_or_name_and_a_start():
    a = np.zeros((N, 3))
    np.testing.assert_allclose(stream({"rate": 8, "gyroscope": {"array": "a"}}, a=a).time, np.arange(N) / 8)
    table = {"rate": "fs", "start": 5, "gyroscope": {"array": "a"}}
    np.testing.assert_allclose(stream(table, a=a, fs=[[4.0]]).time, 5 + np.arange(N) / 4)
    own = {"rate": 1, "gyroscope": {"array": "a", "rate": 2.0}}
    np.testing.assert_allclose(stream(own, a=a).time, np.arange(N) / 2)


def test_xyzw_is_turned_round():
    quat = np.array([[1.0, 2, 3, 4]] * N)
    table = {"orientation": {"array": "q", "order": "xyzw", "rate": 1}}
    np.testing.assert_array_equal(stream(table, "orientation", q=quat).value[0], [4, 1, 2, 3])


def test_nanoseconds_since_1970_keep_what_float64_holds():
    stamps = np.array([1_700_000_000_123_456_789, 1_700_000_000_123_956_789])
    np.testing.assert_array_equal(seconds(stamps, "ns"), [1700000000.1234567890, 1700000000.1239567890])
    np.testing.assert_array_equal(seconds(stamps.view("datetime64[ns]"), "s"), seconds(stamps, "ns"))
    np.testing.assert_allclose(seconds(np.array([0.5, 2.0]), "min"), [30, 120])


GYRO = {"array": "gyr", "unit": "rad/s"}
ARRAYS = {
    "gyr": np.zeros((N, 3)), "t": np.arange(N), "fs": 100.0, "t5": np.arange(N + 1.0), "names": np.array(["x"] * N),
    "acc": np.zeros((N, 3)),
}  # fmt: skip


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"gyroscope": {"array": "gyro"}, "time": "t"}, ["array 'gyro'", "did you mean 'gyr'"]),
        ({"gyroscope": GYRO, "time": "tt"}, ["array 'tt'", "'t'"]),
        ({"gyroscope": GYRO, "rate": "f"}, ["array 'f'", "'fs'"]),
        ({"gyroscope": GYRO}, ["columns.gyroscope", "`time`", "`rate`"]),
        ({"gyroscope": {**GYRO, "unit": "deg/sek"}, "time": "t"}, ["gyroscope.unit", "'deg/sek'", "'deg/s'"]),
        ({"gyroscope": {**GYRO, "unit": "deg"}, "time": "t"}, ["gyroscope.unit", "'deg'", "deg/s"]),
        ({"gyroscope": GYRO, "time": "t", "time_unit": "m"}, ["time_unit", "'m'", "no unit of time"]),
        ({"gyroscope": GYRO, "time": "t5"}, ["4 rows", "'t5'", "(5,)"]),
        ({"gyroscope": GYRO, "time": "names"}, ["stamps", "<U1"]),
        ({"gyroscope": GYRO, "rate": "t"}, ["rate", "(4,)", "one number"]),
        ({"gyroscope": GYRO, "rate": -5}, ["rate", "-5", "positive"]),
        ({"gyroscope": {**GYRO, "columns": [0, 1, 3]}, "time": "t"}, ["no column 3", "0 to 2"]),
        ({"gyroscope": {**GYRO, "columns": ["x"]}, "time": "t"}, ["columns", "'x'", "column numbers"]),
        ({"gyroscope": {**GYRO, "scale": [1, 2]}, "time": "t"}, ["scale", "2 numbers", "(4, 3)"]),
        ({"gyroscope": {**GYRO, "order": "xyzw"}, "time": "t"}, ["order", "(4, 3)"]),
        ({"gyroscope": {**GYRO, "order": "zyx"}, "time": "t"}, ["order", "'zyx'", "xyzw"]),
        ({"gyroscope": {"array": "fs"}, "time": "t"}, ["'fs'", "one number"]),
        ({"gyroscope": {"array": "names"}, "time": "t"}, ["<U1", "numbers"]),
        ({"gyroscope": {"columns": ["t", "t5"]}, "time": "t"}, ["(4,)", "(5,)", "equal"]),
        ({"gyroscope": {"arrya": "gyr"}}, ["gyroscope", "'arrya'", "did you mean 'array'"]),
        ({"gyroscope": {"unit": "rad/s"}}, ["gyroscope", "`array` or `columns`"]),
        ({"gyroscope": {**GYRO, "unit": 3}}, ["gyroscope.unit", "3", "str"]),
        ({"gyroscope": {**GYRO, "scale": True}}, ["gyroscope.scale", "True"]),
        ({"gyroscope": {**GYRO, "columns": [0.5]}}, ["gyroscope.columns", "0.5"]),
        ({"gyroscope": GYRO, "raet": 3}, ["'raet'", "did you mean 'rate'"]),
        ({"rate": 3}, ["no stream"]),
        ({"gyroscope": GYRO, "time": "t", "rate": 5}, ["both time and rate", "expected"]),
        ({"gyroscope": {**GYRO, "time": "t", "start": 5}}, ["gyroscope", "both time and start"]),
    ],
)
def test_errors_name_the_field_and_the_closest(table, words):
    with pytest.raises(InputError) as error:
        apply(raw(**ARRAYS), table)
    for word in ["run.npz", *words]:
        assert word in str(error.value)


def test_shapes_and_stamps_are_checked_on_read(tmp_path):
    np.savez(tmp_path / "a.npz", gyr=np.zeros((3, N)), t=[0, 2, 1])
    with pytest.raises(InputError, match=r"a\.npz.*\(3, 4\).*\(n, 3\)"):
        read(tmp_path / "a.npz", {"time": "t", "gyroscope": GYRO})
    with pytest.raises(InputError, match=r"a\.npz.*row 2.*earlier"):
        read(tmp_path / "a.npz", {"time": "t", "other": {"array": "gyr"}})


def test_toml_and_back():
    table = ColumnTable(
        {
            "gyroscope": Column("gyr", unit="deg/s", frame='the "hand"', scale=(1.0, 2, 3e-7)),
            "imu 0/ü": Column("imu0", (2, 3), time=0, names=("a", "b\\")),
            "orientation": Column(columns=("w", "x", "y", "z"), rate="fs", start=1.5, order="wxyz", offset=-1),
        },
        time="t",
        time_unit="us",
    )
    assert parse(tomllib.loads(to_toml(table))["columns"]) == table
