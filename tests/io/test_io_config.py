"""Configs: errors that name file, line and field."""

from typing import Any

import pytest

from jaxest.io import read_config
from jaxest.types import InputError

TEXT = """# a config
method = "orientation"
gain = 1

[noise]
gyro = 0.01
"accel" = 0.1

[columns]
rate = "fs"
[columns."imu0/gyroscope"]
array = "gyr"
"""
SCHEMA = {"method": str, "gain": float, "noise": {"gyro": float, "accel": (float, str)}}


def put(tmp_path, text):
    (tmp_path / "run.toml").write_text(text)
    return tmp_path / "run.toml"


def test_a_config_is_read_and_its_columns_stay_a_table(tmp_path):
    for schema in (SCHEMA, None, {"method": Any, "gain": Any, "*": {"*": float}}):
        data = read_config(put(tmp_path, TEXT), schema)
        assert data["noise"] == {"gyro": 0.01, "accel": 0.1}
        assert data["columns"]["imu0/gyroscope"] == {"array": "gyr"}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gain = 1", "gian = 1", ["line 3", "'gian'", "did you mean 'gain'"]),
        ("gyro = 0.01", "gyroscope = 0.01", ["line 6", "'noise.gyroscope'", "'noise.gyro'"]),
        ("[noise]", "[nose]", ["line 5", "'nose'", "'noise'"]),
        ("gain = 1", 'gain = "high"', ["line 3", "gain is 'high'", "expected float"]),
        ("gain = 1", "gain = true", ["line 3", "gain is True", "expected float"]),
        ('"accel" = 0.1', '"accel" = [1]', ["line 7", "noise.accel is [1]", "float or str"]),
        ("gain = 1", "noise.x = 1", ["line"]),
        ("gain = 1", "gain = ", ["line 3", "not valid TOML"]),
        ("gain = 1", "gain = 1\ngain = 2", ["line 4", "not valid TOML"]),
        ('array = "gyr"', 'aray = "gyr"', ["columns.imu0/gyroscope", "'aray'", "'array'"]),
        ('rate = "fs"', "rate = []", ["line 9", "columns.rate"]),
    ],
)
def test_errors(tmp_path, old, new, words):
    path = put(tmp_path, TEXT.replace(old, new))
    with pytest.raises(InputError) as error:
        read_config(path, SCHEMA)
    for word in ["run.toml", *words]:
        assert word in str(error.value)


def test_tables_where_values_belong_and_the_other_way_round(tmp_path):
    with pytest.raises(InputError, match=r"line 1: noise is 3, expected a table"):
        read_config(put(tmp_path, "noise = 3"), SCHEMA)
    with pytest.raises(InputError, match=r"line 1: columns: expected a table"):
        read_config(put(tmp_path, "columns = 3"), SCHEMA)


def test_no_file_empty_file_and_bytes(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_config(tmp_path / "absent.toml")
    (tmp_path / "b.toml").write_bytes(b"a = '\xff'")
    with pytest.raises(InputError, match="byte 5"):
        read_config(tmp_path / "b.toml")
