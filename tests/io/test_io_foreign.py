"""Logs as people have them: their separators, encodings, headers, clocks and gaps."""

import tomllib

import numpy as np
import pytest

from jaxest.io import propose, read, summarize, to_toml
from jaxest.types import InputError

HEADER = ["t", "gx", "gy", "gz", "ax", "ay", "az"]
N = 40


def samples(n=N):
    time = np.arange(n) / 100
    gyr = 0.5 * np.stack([np.sin(time), np.cos(time), np.ones(n)], axis=-1)
    acc = np.array([0.25, 0.5, 9.75]) + 0 * gyr
    return np.column_stack([time, gyr, acc])


def text(header, rows, separator=","):
    lines = [separator.join(header)] if header else []
    return "\n".join([*lines, *(separator.join(f"{x:.6f}" for x in row) for row in rows)]) + "\n"


def put(tmp_path, content, encoding="utf-8"):
    path = tmp_path / "log.csv"
    path.write_bytes(content.encode(encoding))
    return path


def assert_read(log, rows=None, start=0.0):
    rows = samples() if rows is None else rows
    np.testing.assert_allclose(log.streams["gyroscope"].time, start + rows[:, 0], atol=1e-6)
    np.testing.assert_allclose(log.streams["gyroscope"].value, rows[:, 1:4], atol=1e-6)
    np.testing.assert_allclose(log.streams["accelerometer"].value, rows[:, 4:], atol=1e-6)


SPREADSHEET = text(HEADER, samples(), ";").replace(".", ",")
UNITS = ["s", *["rad/s"] * 3, *["[m/s^2]"] * 3]


@pytest.mark.parametrize(
    ("content", "encoding"),
    [
        (text(HEADER, samples(), ";"), "utf-8"),
        (SPREADSHEET, "utf-8"),
        (text(HEADER, samples(), "|"), "utf-8"),
        (text(HEADER, samples(), " "), "utf-8"),
        (text(HEADER, samples()).replace("\n", "\r\n"), "utf-8-sig"),
        (text(HEADER, samples()), "utf-16"),
        (text(["t (s)", "gx", "gy", "gz", *(f"a{x} (m/s²)" for x in "xyz")], samples()), "latin-1"),
        (text(HEADER, samples()).replace("\n", ",\n"), "utf-8"),
        (text(HEADER, samples()).replace("\n", ",\n").replace(",\n", "\n", 1), "utf-8"),
        ("// made by a vendor's program\n% rate: 100 Hz\n\n" + text(HEADER, samples()), "utf-8"),
        ("#" + text(HEADER, samples()), "utf-8"),
        ("# " + text(HEADER, samples(), " "), "utf-8"),
        (text(HEADER, samples()).replace("\n", f"\n{','.join(UNITS)}\n", 1), "utf-8"),
        (text(["", *HEADER], np.column_stack([np.arange(N), samples()])), "utf-8"),
        (text(["seconds_elapsed", *HEADER[1:]], samples()), "utf-8"),
        (text(["millis", *HEADER[1:]], samples() * ([1000] + [1] * 6)), "utf-8"),
    ],
)
def test_peoples_csv_is_read_without_a_config(tmp_path, content, encoding):
    assert_read(read(put(tmp_path, content, encoding)))


def test_the_header_of_euroc(tmp_path):
    axes = [f"w_RS_S_{x} [rad s^-1]" for x in "xyz"] + [f"a_RS_S_{x} [m s^-2]" for x in "xyz"]
    lines = [",".join(["#timestamp [ns]", *axes])]
    rows = samples()
    for row in rows:
        lines.append(",".join([str(1_400_000_000_000_000_000 + round(row[0] * 1e9)), *(f"{x:.6f}" for x in row[1:])]))
    log = read(put(tmp_path, "\n".join(lines)))
    found = {name.rsplit("/", 1)[-1]: item for name, item in log.streams.items()}
    assert_read(log._replace(streams=found), start=1.4e9)


@pytest.mark.parametrize(
    ("zone", "offset"), [("", 0), ("Z", 0), ("+00:00", 0), (" UTC", 0), ("+02:00", -7200), ("-0330", 12600)]
)
def test_dates_are_stamps(tmp_path, zone, offset):
    rows = samples()
    stamps = np.datetime64("2026-05-01T12:00:00.000") + np.round(rows[:, 0] * 1000).astype("timedelta64[ms]")
    lines = [",".join(HEADER)]
    for stamp, row in zip(stamps, rows, strict=True):
        lines.append(f"{str(stamp).replace('T', ' ')}{zone},{','.join(f'{x:.6f}' for x in row[1:])}")
    start = float(np.datetime64("2026-05-01T12:00:00").astype(np.int64)) + offset
    assert_read(read(put(tmp_path, "\n".join(lines))), start=start)


def test_dates_as_a_german_spreadsheet_has_them(tmp_path):
    """Day before month, points between them, a decimal comma behind the seconds."""
    rows = samples()
    stamps = np.datetime64("2026-05-01T12:00:00.000") + np.round(rows[:, 0] * 1000).astype("timedelta64[ms]")
    lines = [";".join(["Datum", *HEADER[1:]])]
    for stamp, row in zip(stamps.astype("O"), rows, strict=True):
        date = f"{stamp:%d.%m.%Y %H:%M:%S},{stamp.microsecond // 1000:03d}"
        lines.append(";".join([date, *(f"{x:.6f}".replace(".", ",") for x in row[1:])]))
    assert_read(
        read(put(tmp_path, "\n".join(lines))), start=float(np.datetime64("2026-05-01T12:00:00").astype(np.int64))
    )


def test_a_date_that_is_none_is_no_stamp(tmp_path):
    content = text(HEADER, samples()).replace("\n0.000000", "\n2026-02-31 12:00:00", 1)
    with pytest.raises(InputError, match=r"line 2, column 't': '2026-02-31 12:00:00'"):
        read(put(tmp_path, content))


@pytest.mark.parametrize("word", ["NA", "null", "nan", "N/A"])
def test_a_word_for_a_missing_value_is_nan(tmp_path, word):
    content = text(HEADER, samples()).replace("9.750000", word, 1)
    value = read(put(tmp_path, content)).streams["accelerometer"].value
    assert np.isnan(value[0, 2])
    assert np.isfinite(value[1:]).all()


def test_thousands_are_not_taken_for_decimals(tmp_path):
    content = text(HEADER, samples(), ";").replace("9.750000", "1,234", 1)
    with pytest.raises(InputError, match="'1,234' is not a number"):
        read(put(tmp_path, content))


def test_a_transposed_array_is_asked_about_and_then_read(tmp_path):
    rows = samples()
    np.savez(tmp_path / "log.npz", t=rows[:, 0], gyr=rows[:, 1:4].T, acc=rows[:, 4:].T)
    with pytest.raises(InputError, match=r"gyr \(3, 40\): seems transposed, expected \(n, 3\)"):
        read(tmp_path / "log.npz")
    table = tomllib.loads(to_toml(propose(tmp_path / "log.npz")))["columns"]
    assert_read(read(tmp_path / "log.npz", table))


def test_arrays_without_rows_are_an_empty_log(tmp_path):
    np.savez(tmp_path / "log.npz", t=np.zeros(0), gyr=np.zeros((0, 3)), acc=np.zeros((0, 3)))
    with pytest.raises(InputError, match="empty"):
        read(tmp_path / "log.npz")


def test_a_date_that_is_not_there_is_no_time(tmp_path):
    stamps = np.datetime64("2026-05-01", "ns") + np.arange(N) * np.timedelta64(10, "ms")
    stamps[3] = np.datetime64("NaT")
    np.savez(tmp_path / "log.npz", t=stamps, gyr=samples()[:, 1:4])
    with pytest.raises(InputError, match="row 3 is nan"):
        read(tmp_path / "log.npz")


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 1e300])
def test_one_absurd_value_does_not_spoil_the_guess(tmp_path, value):
    rows = samples(400)
    rows[7, 4] = rows[9, 1] = value
    np.savez(tmp_path / "log.npz", t=rows[:, 0], gyr=rows[:, 1:4], acc=rows[:, 4:] / 9.80665)
    log = read(tmp_path / "log.npz")
    np.testing.assert_allclose(log.streams["accelerometer"].value[20:], rows[20:, 4:])
    assert summarize(log).streams[0].missing == (0 if np.isfinite(value) else 1)


def test_nothing_to_go_by_says_what_to_write(tmp_path):
    path = put(tmp_path, text(None, samples()))
    with pytest.raises(InputError, match="nothing here looks like a stream") as error:
        read(path)
    lines = str(error.value).partition("which is which:\n")[2]
    table = tomllib.loads(lines)["columns"]
    np.testing.assert_allclose(read(path, table).streams["gyroscope"].value, samples()[:, 1:4], atol=1e-6)
