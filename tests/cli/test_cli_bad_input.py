"""Bad input through the entry point: status 2, one message that names the place, no traceback."""

import subprocess
import sys

import numpy as np
import pytest
from turning_imu import turning

from jaxest import bench
from jaxest.io import SensorLog, Stream, write

ESTIMATE = ("--method", "orientation")


def changed(name, **fields):
    log = turning(30)
    return log._replace(streams={**log.streams, name: log.streams[name]._replace(**fields)})


def save(path, log):
    """Write arrays without the check that `write` makes."""
    arrays = {}
    for name, item in log.streams.items():
        arrays |= {f"{name}/time": item.time, f"{name}/value": item.value, f"{name}/meta": np.array('{"unit": "1"}')}
    np.savez(path, **arrays)


@pytest.mark.parametrize("words", [("inspect",), ("estimate", *ESTIMATE), ("compare", "here.npz")])
def test_no_such_file(refused, tmp_path, words):
    write(turning(5, truth=True), tmp_path / "here.npz")
    assert "nowhere.npz: no such file" in refused(*words, "nowhere.npz")


def test_closest_file_is_named(refused, tmp_path):
    write(turning(5), tmp_path / "trial.npz")
    assert "trial.npz" in refused("inspect", "trial.csv")


def test_folder_instead_of_file(refused, tmp_path):
    assert "is a folder, expected a file" in refused("inspect", tmp_path)


def test_no_such_robot(refused, tmp_path):
    write(turning(), tmp_path / "a.npz")
    assert "no.urdf: no such file" in refused("estimate", "a.npz", *ESTIMATE, "--robot", "no.urdf")


def test_empty_file(refused, tmp_path):
    (tmp_path / "a.npz").touch()
    assert "a.npz: the file is empty" in refused("estimate", "a.npz", *ESTIMATE)


@pytest.mark.parametrize("text", ["<html></html>", "<mujoco><worldbody>"])
def test_not_a_robot(refused, tmp_path, text):
    (tmp_path / "page.xml").write_text(text)
    assert "page.xml: " in refused("inspect", "page.xml")


def test_neither_robot_nor_log(refused, tmp_path):
    (tmp_path / "song.mp3").write_bytes(b"ID3")
    assert "song.mp3: neither a robot" in refused("inspect", "song.mp3")


def test_not_a_zip(refused, tmp_path):
    (tmp_path / "a.npz").write_bytes(b"not a zip at all")
    assert "a.npz: not a readable NPZ file" in refused("inspect", "a.npz")


def test_closest_stream_is_named(refused, tmp_path):
    log = turning(30)
    streams = {"gyroscop": log.streams["gyroscope"], "accelerometer": log.streams["accelerometer"]}
    write(SensorLog(streams), tmp_path / "a.npz")
    message = refused("estimate", "a.npz", *ESTIMATE)
    assert "a.npz: stream 'gyroscope' does not exist; did you mean 'gyroscop'?" in message


def test_magnetometer_that_was_asked_for(refused, tmp_path):
    write(turning(30, magnetometer=False), tmp_path / "a.npz")
    words = ("--sensors", "gyroscope,accelerometer,magnetometer")
    assert "stream 'magnetometer' does not exist" in refused("estimate", "a.npz", *ESTIMATE, *words)


def test_wrong_shape(refused, tmp_path):
    save(tmp_path / "a.npz", changed("accelerometer", value=np.zeros((30, 2))))
    message = refused("estimate", "a.npz", *ESTIMATE)
    assert "stream 'accelerometer': value has shape (30, 2), expected (n, 3)" in message


def test_unequal_lengths(refused, tmp_path):
    save(tmp_path / "a.npz", changed("gyroscope", value=np.zeros((29, 3))))
    assert "value has shape (29, 3) and time (30,)" in refused("inspect", "a.npz")


def test_nan(refused, tmp_path):
    value = turning(30).streams["accelerometer"].value.copy()
    value[7, 1] = np.nan
    write(changed("accelerometer", value=value), tmp_path / "a.npz")
    message = refused("estimate", "a.npz", *ESTIMATE)
    assert "stream 'accelerometer': row 7 at 0.070000 s is not finite" in message
    assert 'nan = "missing"' in message


@pytest.mark.parametrize(("second", "words"), [(0.0, "a duplicate of"), (-0.5, "earlier than")])
def test_stamps(refused, tmp_path, second, words):
    time = np.arange(30) / 100
    time[1] = second
    save(tmp_path / "a.npz", changed("gyroscope", time=time))
    for command in (("inspect", "a.npz"), ("estimate", "a.npz", *ESTIMATE)):
        message = refused(*command)
        assert f"stream 'gyroscope': the stamp of row 1, {second:.9f} s, is {words} row 0's" in message


def test_empty_log(refused, tmp_path):
    save(tmp_path / "a.npz", SensorLog({"gyroscope": Stream(np.zeros(0), np.zeros((0, 3)), "rad/s")}))
    assert "stream 'gyroscope' is empty" in refused("estimate", "a.npz", *ESTIMATE)


def test_existing_output_is_kept(refused, tmp_path):
    write(turning(30), tmp_path / "a.npz")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.json").write_text("mine")
    message = refused("estimate", "a.npz", *ESTIMATE, "-o", "out")
    assert "report.json exists already" in message
    assert "--force" in message
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["report.json"]
    assert (tmp_path / "out" / "report.json").read_text() == "mine"


@pytest.mark.parametrize("out", ["file", "file/below"])
def test_unwritable_output(refused, tmp_path, out):
    write(turning(30), tmp_path / "a.npz")
    (tmp_path / "file").write_text("mine")
    assert "file" in refused("estimate", "a.npz", *ESTIMATE, "-o", out, "--force")
    assert (tmp_path / "file").read_text() == "mine"


def test_unknown_method(refused, tmp_path):
    write(turning(30), tmp_path / "a.npz")
    assert "did you mean 'orientation'" in refused("estimate", "a.npz", "-m", "orientaton")


def test_options_that_a_method_does_not_have_are_refused_rather_than_ignored(refused, tmp_path):
    write(turning(30), tmp_path / "a.npz")
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    message = refused("estimate", "a.npz", *ESTIMATE, "--robot", "arm.xml")
    assert "--robot arm.xml: the method 'orientation' knows no robot" in message.replace("\n", " ")
    words = ("estimate", "a.npz", "-m", "posture", "-o", "out", "--sensors", "gyroscope")
    assert "--sensors: the method 'posture' uses the sensors that [posture] names" in refused(*words).replace("\n", " ")


def test_unknown_sensor(refused, tmp_path):
    write(turning(30), tmp_path / "a.npz")
    message = refused("estimate", "a.npz", *ESTIMATE, "--sensors", "gyroscope,acelerometer")
    assert "did you mean 'accelerometer'" in message


@pytest.mark.parametrize("window", [("--start", "5"), ("--start", "0.2", "--end", "0.1")])
def test_window_without_samples(refused, tmp_path, window):
    write(turning(30), tmp_path / "a.npz")
    assert "the log lasts 0.290 s" in refused("estimate", "a.npz", *ESTIMATE, *window)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[orientation]\nproportional_gian = 1.0\n", "a.toml, line 2"),
        ("[orientation]\nlambda_acc = 'much'\n", "expected float"),
        ("[orientation]\nlambda_acc = -1.0\n", "lambda_acc: got -1.0, expected a number, 0 or more"),
        ("[orientation.noise]\ngyroscpe = 1.0\n", "'orientation.noise.gyroscope'"),
        ("[orientation]\nupdate = 'eponential'\n", "did you mean 'exponential'"),
        ("[orientation]\nfilter = 'efk'\n", "did you mean 'ekf'"),
        ("[orientation]\nfilter = 'ekf'\nlambda_mag = 1.0\n", "lambda_mag: does not belong to the filter 'ekf'"),
        ("[orientation]\nfilter = 'madgwick'\n[orientation.ekf]\nspeed = 1.0\n", "ekf: does not belong to the filter"),
        ("[orientation]\nfilter = 'decoupled'\nsmooth = true\n", "'decoupled' has no smoother"),
        ("[orientation.ekf.rest]\nrate = -1.0\n", "[orientation.ekf.rest] rate: got -1.0"),
        ("[orientation.ekf]\nsped = 1.0\n", "'orientation.ekf.speed'"),
        ("[orientation]\nsensors = ['gyroscope']\n", "needs gyroscope and accelerometer"),
        ("[orientation]\nsensors = [1]\n", "sensor '1' does not exist"),
        ("nan = 'mising'\n", "did you mean 'missing'?"),
        ("nan = [\n", "not valid TOML"),
    ],
)
def test_config(refused, tmp_path, text, expected):
    write(turning(30), tmp_path / "a.npz")
    (tmp_path / "a.toml").write_text(text)
    assert expected in refused("estimate", "a.npz", *ESTIMATE, "-c", "a.toml")


def test_column_that_does_not_exist(refused, tmp_path):
    np.savez(tmp_path / "a.npz", gyr=np.zeros((5, 3)), acc=np.ones((5, 3)))
    (tmp_path / "a.toml").write_text("[columns]\nrate = 100.0\n[columns.gyroscope]\narray = 'gry'\n")
    assert "did you mean 'gyr'?" in refused("estimate", "a.npz", *ESTIMATE, "-c", "a.toml")


def test_ambiguous_log_is_answered_with_lines_to_paste(refused, tmp_path):
    np.savez(tmp_path / "a.npz", gyr=np.zeros((5, 3)), acc=np.full((5, 3), 5.6))
    message = refused("estimate", "a.npz", *ESTIMATE)
    assert "no sampling rate" in message
    assert "[columns.gyroscope]\n" in message


def test_several_imus_are_answered_with_lines_to_paste(refused, tmp_path):
    streams = {f"{imu}/{name}": item for imu in ("hand", "arm") for name, item in turning(30).streams.items()}
    write(SensorLog(streams), tmp_path / "a.npz")
    message = refused("estimate", "a.npz", *ESTIMATE)
    assert '[orientation]\nimu = "hand"\nimu = "arm"' in message


def test_comparison_without_orientation(refused, tmp_path):
    write(turning(30), tmp_path / "a.npz")
    write(turning(30, truth=True), tmp_path / "b.npz")
    assert "a.npz: stream 'orientation' does not exist" in refused("compare", "a.npz", "b.npz")
    assert "a.npz: stream 'orientation' does not exist" in refused("compare", "b.npz", "a.npz")


def test_comparison_of_other_times(refused, tmp_path):
    write(turning(30, truth=True), tmp_path / "a.npz")
    write(turning(30, truth=True, start=100.0), tmp_path / "b.npz")
    assert "expected times in common" in refused("compare", "a.npz", "b.npz")


def test_comparison_of_what_is_no_rotation(refused, tmp_path):
    log = turning(30, truth=True)
    write(log, tmp_path / "a.npz")
    item = log.streams["orientation"]
    write(log._replace(streams={"orientation": item._replace(value=2 * item.value)}), tmp_path / "b.npz")
    assert "stream 'orientation': row 0 has length 2, expected unit quaternions" in refused("compare", "b.npz", "a.npz")


def test_covariance_that_does_not_fit(refused, tmp_path):
    log = turning(30, truth=True)
    write(log, tmp_path / "a.npz")
    item = log.streams["orientation"]
    odd = Stream(item.time, np.ones((30, 3)), "rad2")
    write(SensorLog({"orientation": item, "orientation_covariance": odd}), tmp_path / "b.npz")
    assert "shape (30, 3), expected (30, 3, 3)" in refused("compare", "b.npz", "a.npz")


def test_truth_that_is_nowhere_known(refused, tmp_path):
    log = turning(30, truth=True)
    write(log, tmp_path / "a.npz")
    item = log.streams["orientation"]
    write(SensorLog({"orientation": item._replace(value=np.full((30, 4), np.nan))}), tmp_path / "b.npz")
    assert "no sample is both known and moving" in refused("compare", "a.npz", "b.npz")


def test_unknown_benchmark(refused):
    said = refused("bench", "orientatio")
    assert [name for name in bench.CASES if f" {name}" not in said] == []


def test_verbose_shows_where(invoke):
    result = invoke("inspect", "nowhere.npz", "-v")
    assert result.exit_code == 2
    assert "Traceback" in result.stderr
    assert result.stderr.splitlines()[-1].startswith("error: ")


def test_a_bug_keeps_its_traceback(invoke, monkeypatch):
    def broken():
        raise KeyError("bug")

    monkeypatch.setattr("jaxest.cli.doctor.examine", broken)
    with pytest.raises(KeyError, match="bug"):
        invoke("doctor")


def test_as_a_process(tmp_path):
    words = [sys.executable, "-m", "jaxest.cli", "estimate", "nowhere.npz", *ESTIMATE]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "error: nowhere.npz: no such file\n")
    assert list(tmp_path.iterdir()) == []


def test_help_is_quick_and_loads_no_jax():
    code = "import sys, jaxest.cli.app; assert not {'jax', 'numpy', 'mujoco', 'matplotlib'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_reader_that_has_seen_enough_is_no_error(tmp_path):
    chain = "".join('<body pos="0 0 .1"><joint axis="0 1 0"/><geom size=".02"/>' for _ in range(200)) + "</body>" * 200
    (tmp_path / "long.xml").write_text(f"<mujoco><worldbody>{chain}</worldbody></mujoco>")
    command = [sys.executable, "-m", "jaxest.cli", "inspect", str(tmp_path / "long.xml")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert "200 coordinates" in process.stdout.readline()
        process.stdout.close()
        assert process.stderr is not None
        assert "Traceback" not in process.stderr.read()
        assert process.wait() == 0


def test_what_to_do_next_is_said_where_the_message_does_not(refused, tmp_path):
    (tmp_path / "log.csv").write_text("time,a\n")
    assert "; `jaxest inspect log.csv` shows what is in it" in refused("estimate", "log.csv", "-m", "orientation")
    assert "jaxest estimate" not in refused("estimate", "log.csv", "-m", "orientaton")
