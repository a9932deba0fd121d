"""CSV: our own layout, and precise errors for what people's files have."""

import numpy as np
import pytest

from jaxest.io import SensorLog, Stream, propose, read, write
from jaxest.types import InputError


def put(tmp_path, text, name="log.csv"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_layout_is_the_documented_one(tmp_path):
    log = SensorLog(
        {
            "gyroscope": Stream(np.array([0.0, 0.5]), np.array([[1, 2, 3], [np.nan, 0.1, 6]], np.float32), "rad/s"),
            "contact": Stream(np.array([0.5, 1.0]), np.array([True, False])),
        }
    )
    write(log, tmp_path / "log.csv")
    lines = (tmp_path / "log.csv").read_text().splitlines()
    assert lines[0].startswith('# jaxest-log {"gyroscope": {"unit": "rad/s", "frame": "", "dtype": "float32"')
    assert lines[1:] == [
        "time,gyroscope/0,gyroscope/1,gyroscope/2,contact",
        "0.0,1.0,2.0,3.0,",
        "0.5,nan,0.1,6.0,1",
        "1.0,,,,0",
    ]


OWN = '# jaxest-log {"x": {"unit": "", "frame": "", "dtype": "DTYPE", "shape": [2]}}\ntime,x/0,x/1\n0,1,2\n1,3,4\n'


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("3,4", "3,four", ["line 4", "'x/1'", "'four'", "number"]),
        ("3,4", "3,", ["line 4", "'x/1'", "''"]),
        ("3,4", "3", ["line 4", "2 cells", "expected 3"]),
        ("1,3,4", "0,3,4", ["row 1", "duplicate"]),
        ("x/1", "y/1", ["line 1", "'x/1'"]),
        ('"shape": [2]', '"size": [2]', ["line 1", "shape"]),
        ('{"x"', '"x"', ["line 1", "not JSON"]),
        ("DTYPE", "float128x", ["line 1", "dtype"]),
        ("[2]", "[0]", ["line 1", "header"]),
    ],
)
def test_bad_cells_of_our_own_layout(tmp_path, old, new, words):
    with pytest.raises(InputError) as error:
        read(put(tmp_path, OWN.replace(old, new).replace("DTYPE", "float64")))
    for word in ["log.csv", *words]:
        assert word in str(error.value)


def test_integers_are_exact_and_in_range(tmp_path):
    text = OWN.replace("DTYPE", "int64").replace("3,4", f"{2**53 + 1},4")
    assert read(put(tmp_path, text)).streams["x"].value[1, 0] == 2**53 + 1
    with pytest.raises(InputError, match=r"'1\.5' is not an integer"):
        read(put(tmp_path, OWN.replace("DTYPE", "int32").replace("3,4", "1.5,4")))
    with pytest.raises(InputError, match="uint8"):
        read(put(tmp_path, OWN.replace("DTYPE", "uint8").replace("3,4", "300,4")))


FOREIGN = "t,gyr_x,gyr_y,gyr_z,label\n0.0,1,2,3,walk\n0.1,4,5,6,run\n"


@pytest.mark.parametrize("delimiter", [",", ";", "\t", ", "])
def test_other_peoples_columns(tmp_path, delimiter):
    log = read(put(tmp_path, "\ufeff" + FOREIGN.replace(",", delimiter)))
    stream = log.streams["gyroscope"]
    np.testing.assert_array_equal(stream.value, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(stream.time, [0.0, 0.1])
    assert any("label" in note for note in log.notes)


def test_a_file_without_header_is_read_by_column_numbers(tmp_path):
    path = put(tmp_path, "0.0,1,2,3\n0.1,4,5,6\n")
    log = read(path, {"time": 0, "gyroscope": {"columns": [1, 2, 3], "unit": "deg/s"}})
    np.testing.assert_allclose(log.streams["gyroscope"].value, np.deg2rad([[1, 2, 3], [4, 5, 6]]))
    with pytest.raises(InputError, match=r"no column 4, expected 0 to 3"):
        read(path, {"time": 0, "gyroscope": {"columns": [1, 2, 4]}})


def test_empty_cells_are_no_sample(tmp_path):
    text = "time,gx,gy,gz,mx,my,mz\n0,1,2,3,,,\n1,4,5,6,7,8,9\n2,,,,10,11,\n"
    log = read(put(tmp_path, text), {
        "time": "time",
        "gyroscope": {"columns": ["gx", "gy", "gz"]},
        "magnetometer": {"columns": ["mx", "my", "mz"]},
    })  # fmt: skip
    np.testing.assert_array_equal(log.streams["gyroscope"].time, [0, 1])
    np.testing.assert_array_equal(log.streams["magnetometer"].value, [[7, 8, 9], [10, 11, np.nan]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FOREIGN.replace("5,6", "5,six"), ["line 3", "'gyr_z'", "'six'"]),
        (FOREIGN.replace("5,6", "5"), ["line 3", "4 cells", "expected 5"]),
        (FOREIGN.replace("gyr_y", "gyr_x"), ["line 1", "'gyr_x'", "twice"]),
        (FOREIGN.replace("0.1", "0.0"), ["row 1", "duplicate"]),
        ("t,gyr_x\n", ["empty", "no rows"]),
        ("# only a comment\n\n", ["empty"]),
        ('a,"b\n1,2', ["log.csv"]),
        ("name,colour\nx,red\ny,blue\n", ["nothing here looks like a stream", "colour"]),
    ],
)
def test_bad_files(tmp_path, text, words):
    with pytest.raises(InputError) as error:
        read(put(tmp_path, text))
    for word in ["log.csv", *words]:
        assert word in str(error.value)


def test_not_text(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"time,x\n\xff\xfe\n")
    with pytest.raises(InputError, match="byte 7 is not text"):
        read(path)


def test_a_damaged_column_hurts_only_who_asks(tmp_path):
    path = put(tmp_path, FOREIGN.replace("5,6", "5,six"))
    log = read(path, {"time": "t", "height": {"array": "gyr_x", "unit": "m"}})
    np.testing.assert_array_equal(log.streams["height"].value, [1, 4])
    with pytest.raises(InputError, match=r"line 3, column 'gyr_z'"):
        read(path, {"time": "t", "gyroscope": {"columns": ["gyr_x", "gyr_y", "gyr_z"]}})
    with pytest.raises(InputError, match=r"column 'gyr_w' does not exist; did you mean 'gyr_"):
        read(path, {"time": "t", "height": {"array": "gyr_w"}})


def test_a_stream_without_columns_needs_npz(tmp_path):
    with pytest.raises(InputError, match="no columns"):
        write(SensorLog({"x": Stream(np.arange(2.0), np.zeros((2, 0)))}), tmp_path / "log.csv")
    with pytest.raises(InputError, match="own layout"):
        propose(put(tmp_path, OWN.replace("DTYPE", "float64")))
