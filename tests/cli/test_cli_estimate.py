"""`jaxest estimate --method orientation` on logs whose truth is known."""

import json

import numpy as np
import pytest
from turning_imu import orientation, turning

from jaxest.io import SensorLog, Stream, read, write
from jaxest.metrics import orientation_error

ESTIMATE = ("--method", "orientation", "-o", "out")
PLAIN = "[orientation]\nproportional_gain = 0.74\nintegral_gain = 0.0012\n"  # chooses the complementary filter
FIELDS = {"name", "jaxest", "jax", "mujoco", "devices", "flags", "rows"}


def worst_deg(estimate, truth, part="total"):
    return np.rad2deg(np.max(getattr(orientation_error(estimate, truth), part)))


def test_nine_axes(invoke, tmp_path):
    write(turning(truth=True), tmp_path / "a.npz")
    result = invoke("estimate", "a.npz", *ESTIMATE)
    assert result.exit_code == 0, result.output
    assert "total RMSE" in result.stdout
    assert "orientation in the log" in result.stdout
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"estimate.npz", "report.json", "orientation.png"}
    streams = read(tmp_path / "out" / "estimate.npz").streams
    assert set(streams) == {"orientation", "orientation_covariance", "gyroscope_bias"}
    time = np.arange(200) / 100
    for item in streams.values():
        np.testing.assert_array_equal(item.time, time)
    assert worst_deg(streams["orientation"].value, orientation(time)) < 0.3  # ideal sensors, K_p pulls by < 0.2 deg
    covariance = streams["orientation_covariance"].value
    assert covariance.shape == (200, 3, 3)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert set(report) == FIELDS
    assert {row["metric"] for row in report["rows"]} >= {"samples", "total RMSE", "orientation NEES"}


def test_json_has_standard_output_to_itself(invoke, tmp_path):
    write(turning(truth=True), tmp_path / "a.npz")
    result = invoke("estimate", "a.npz", *ESTIMATE, "--json")
    report = json.loads(result.stdout)
    assert report["name"] == "orientation"
    assert report == json.loads((tmp_path / "out" / "report.json").read_text())


def test_output_is_replaced_only_by_force(invoke, tmp_path):
    write(turning(), tmp_path / "a.npz")
    assert invoke("estimate", "a.npz", *ESTIMATE).exit_code == 0
    before = (tmp_path / "out" / "estimate.npz").read_bytes()
    write(turning(magnetometer=False), tmp_path / "a.npz", overwrite=True)
    assert invoke("estimate", "a.npz", *ESTIMATE).exit_code == 2
    assert (tmp_path / "out" / "estimate.npz").read_bytes() == before
    assert invoke("estimate", "a.npz", *ESTIMATE, "--force").exit_code == 0
    assert (tmp_path / "out" / "estimate.npz").read_bytes() != before


@pytest.mark.parametrize("how", ["log", "option", "config"])
def test_six_axes(invoke, tmp_path, how):
    write(turning(magnetometer=how != "log", truth=True), tmp_path / "a.npz")
    (tmp_path / "a.toml").write_text('[orientation]\nsensors = ["gyroscope", "accelerometer"]\n')
    words = {"log": (), "option": ("--sensors", "gyroscope,accelerometer"), "config": ("-c", "a.toml")}[how]
    result = invoke("estimate", "a.npz", *ESTIMATE, *words)
    assert result.exit_code == 0, result.output
    item = read(tmp_path / "out" / "estimate.npz").streams["orientation"]
    assert item.extra["heading"] == "free"
    assert worst_deg(item.value, orientation(item.time), "inclination") < 0.3
    assert "heading RMSE" not in result.stdout
    compared = json.loads(invoke("compare", "out/estimate.npz", "a.npz", "--json").stdout)
    assert [row["metric"] for row in compared["rows"]] == [
        "inclination RMSE", "inclination NEES", "inclination inside 95 %",
    ]  # fmt: skip


def test_gains_of_the_config_are_used(invoke, tmp_path):
    log = turning()
    gyroscope = log.streams["gyroscope"]
    write(log._replace(streams={**log.streams, "gyroscope": gyroscope._replace(value=gyroscope.value + 0.05)}),
          tmp_path / "a.npz")  # fmt: skip
    worst = {}
    for gain in (0.0, 5.0):
        (tmp_path / "a.toml").write_text(f"[orientation]\nproportional_gain = {gain}\nintegral_gain = 0\n")
        assert invoke("estimate", "a.npz", *ESTIMATE, "-c", "a.toml", "--force").exit_code == 0
        item = read(tmp_path / "out" / "estimate.npz").streams["orientation"]
        worst[gain] = worst_deg(item.value, orientation(item.time))
    drift = np.rad2deg(0.05 * np.sqrt(3) * 1.99)  # nothing holds the biased gyroscope back
    assert worst[0.0] == pytest.approx(drift, rel=0.1)
    assert worst[5.0] < 0.5 * drift


def test_somebody_elses_layout_and_units(invoke, tmp_path):
    log = turning()
    gyroscope, accelerometer = (log.streams[name].value for name in ("gyroscope", "accelerometer"))
    np.savez(tmp_path / "a.npz", w=np.rad2deg(gyroscope).T.copy().T, f=accelerometer / 9.80665)
    (tmp_path / "a.toml").write_text(
        "[columns]\nrate = 100.0\n[columns.gyroscope]\narray = 'w'\nunit = 'deg/s'\n"
        "[columns.accelerometer]\narray = 'f'\nunit = 'g'\n"
    )
    assert invoke("estimate", "a.npz", *ESTIMATE, "-c", "a.toml").exit_code == 0
    item = read(tmp_path / "out" / "estimate.npz").streams["orientation"]
    assert worst_deg(item.value, orientation(item.time), "inclination") < 0.3


def test_csv(invoke, tmp_path):
    log = turning()
    gyroscope, accelerometer = (log.streams[name].value for name in ("gyroscope", "accelerometer"))
    table = np.column_stack([np.arange(200) * 10, gyroscope, accelerometer])
    header = "time_ms,gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z"
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=header, comments="")
    result = invoke("estimate", "a.csv", *ESTIMATE)
    assert result.exit_code == 0, result.output
    item = read(tmp_path / "out" / "estimate.npz").streams["orientation"]
    assert item.time[-1] == pytest.approx(1.99)
    assert worst_deg(item.value, orientation(item.time), "inclination") < 0.3


def test_own_layout_in_other_units(invoke, tmp_path):
    log = turning()
    item = log.streams["gyroscope"]._replace(value=np.rad2deg(log.streams["gyroscope"].value), unit="deg/s")
    write(log._replace(streams={**log.streams, "gyroscope": item}), tmp_path / "a.npz")
    assert invoke("estimate", "a.npz", *ESTIMATE).exit_code == 0
    item = read(tmp_path / "out" / "estimate.npz").streams["orientation"]
    assert worst_deg(item.value, orientation(item.time)) < 0.3


def test_values_that_do_not_fit_their_unit_are_said(invoke, tmp_path):
    log = turning()
    item = log.streams["accelerometer"]._replace(value=log.streams["accelerometer"].value / 9.81)
    write(log._replace(streams={**log.streams, "accelerometer": item}), tmp_path / "a.npz")
    result = invoke("estimate", "a.npz", *ESTIMATE)
    assert "a.npz: accelerometer: median norm 1" in result.stderr
    assert "is it in g?" in result.stderr
    item = item._replace(unit="g")
    write(log._replace(streams={**log.streams, "accelerometer": item}), tmp_path / "b.npz")
    assert "is it in g?" not in invoke("estimate", "b.npz", *ESTIMATE, "--force").stderr


def test_sensors_of_other_rates_and_stamps(invoke, tmp_path):
    fast, slow = turning(400, 200.0), turning(40, 20.0)
    late = turning(80, 40.0).streams["accelerometer"]
    streams = {
        "gyroscope": fast.streams["gyroscope"],
        "accelerometer": late._replace(time=late.time + 1e-3),
        "magnetometer": slow.streams["magnetometer"],
    }
    write(SensorLog(streams), tmp_path / "a.npz")
    result = invoke("estimate", "a.npz", *ESTIMATE)
    assert result.exit_code == 0, result.output
    item = read(tmp_path / "out" / "estimate.npz").streams["orientation"]
    np.testing.assert_array_equal(item.time, fast.streams["gyroscope"].time)
    known = np.isfinite(item.value).all(axis=1)
    assert known.mean() > 0.97
    assert worst_deg(item.value[known], orientation(item.time[known])) < 1.0  # 1 ms at 0.54 rad/s is 0.03 deg


def test_quick_accelerometer_does_not_stop_the_gyroscope(invoke, tmp_path):
    slow, quick = turning(100, 50.0), turning(400, 200.0)
    streams = {"gyroscope": slow.streams["gyroscope"], "accelerometer": quick.streams["accelerometer"],
               "magnetometer": quick.streams["magnetometer"]}  # fmt: skip
    write(SensorLog(streams), tmp_path / "a.npz")
    (tmp_path / "a.toml").write_text("[orientation]\nproportional_gain = 0\nintegral_gain = 0\n")
    result = invoke("estimate", "a.npz", *ESTIMATE, "-c", "a.toml")
    assert result.exit_code == 0, result.output
    item = read(tmp_path / "out" / "estimate.npz").streams["orientation"]
    assert len(item.time) == 400
    assert worst_deg(item.value, orientation(item.time)) < 0.1


def test_missing_samples(invoke, tmp_path):
    log = turning()
    holes = {name: item._replace(value=item.value.copy()) for name, item in log.streams.items()}
    holes["accelerometer"].value[:20] = np.nan
    holes["magnetometer"].value[50:60, 2] = np.inf
    write(SensorLog(holes), tmp_path / "a.npz")
    (tmp_path / "a.toml").write_text('nan = "missing"\n')
    assert invoke("estimate", "a.npz", *ESTIMATE).exit_code == 2
    result = invoke("estimate", "a.npz", *ESTIMATE, "-c", "a.toml")
    assert result.exit_code == 0, result.output
    item = read(tmp_path / "out" / "estimate.npz").streams["orientation"]
    assert np.isnan(item.value[:20]).all()  # nothing has settled the orientation yet
    assert worst_deg(item.value[20:], orientation(item.time[20:])) < 0.3


def test_result_that_must_not_be_used(invoke, tmp_path):
    log = turning()
    holes = {**log.streams, "accelerometer": log.streams["accelerometer"]._replace(value=np.full((200, 3), np.nan))}
    write(SensorLog(holes), tmp_path / "a.npz")
    (tmp_path / "a.toml").write_text('nan = "missing"\n')
    result = invoke("estimate", "a.npz", *ESTIMATE, "-c", "a.toml", "--json")
    assert result.exit_code == 3
    assert "do not use this estimate: the orientation was never settled" in result.stderr
    assert json.loads(result.stdout)["name"] == "orientation"


def test_steps_that_are_too_long_for_the_covariance(invoke, tmp_path):
    rate, n = np.array([2.0, -1.5, 2.5]), 300
    time, up = np.arange(n) * 10.0, np.tile([0.0, 0.0, 9.81], (n, 1))
    streams = {"gyroscope": Stream(time, np.tile(rate, (n, 1)), "rad/s"), "accelerometer": Stream(time, up, "m/s2")}
    write(SensorLog(streams), tmp_path / "a.npz")
    (tmp_path / "a.toml").write_text('[orientation]\nfilter = "complementary"\n')
    result = invoke("estimate", "a.npz", *ESTIMATE, "-c", "a.toml")
    assert result.exit_code == 3
    assert "its covariance grew out of range: steps of 10 s are too long" in result.stderr


def test_a_gap_is_noted(invoke, tmp_path):
    log = turning(magnetometer=False)
    late = {name: item._replace(time=item.time + 30 * (item.time > 1)) for name, item in log.streams.items()}
    write(SensorLog(late), tmp_path / "a.npz")
    assert "no sample for 30 s until 31.010 s" in invoke("estimate", "a.npz", *ESTIMATE).stderr


def test_the_truth_of_a_camera(invoke, tmp_path):
    log = turning(truth=True)
    log.streams["camera/orientation"] = log.streams.pop("orientation")
    write(log, tmp_path / "a.npz")
    assert "to camera/orientation in the log" in invoke("estimate", "a.npz", *ESTIMATE).stdout


def test_window(invoke, tmp_path):
    write(turning(start=1.7e9), tmp_path / "a.npz")  # seconds since 1970: the window counts from the first sample
    assert invoke("estimate", "a.npz", *ESTIMATE, "--start", "0.495", "--end", "1.5").exit_code == 0
    item = read(tmp_path / "out" / "estimate.npz").streams["orientation"]
    assert len(item.time) == 101
    assert item.time[0] == pytest.approx(1.7e9 + 0.5, abs=1e-6)
    assert worst_deg(item.value, orientation(item.time - 1.7e9)) < 0.3


def test_one_of_several_imus(invoke, tmp_path):
    log = turning(truth=True)
    other = Stream(log.streams["gyroscope"].time, np.zeros((200, 3)), "rad/s")
    streams = {f"hand/{name}": item for name, item in log.streams.items()} | {"arm/gyroscope": other}
    write(SensorLog(streams), tmp_path / "a.npz")
    (tmp_path / "a.toml").write_text('[orientation]\nimu = "hand"\n')
    result = invoke("estimate", "a.npz", *ESTIMATE, "-c", "a.toml")
    assert result.exit_code == 0, result.output
    assert "hand/orientation in the log" in result.stdout


def test_no_picture_without_matplotlib(invoke, tmp_path, monkeypatch):
    find = __import__("importlib.util").util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "matplotlib" else find(name))
    write(turning(), tmp_path / "a.npz")
    result = invoke("estimate", "a.npz", *ESTIMATE)
    assert result.exit_code == 0
    assert "pip install 'jaxest[viz]'" in result.stderr
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"estimate.npz", "report.json"}


@pytest.mark.parametrize("name", ["ekf", "decoupled", "madgwick", "complementary"])
def test_every_filter(invoke, tmp_path, name):
    write(turning(truth=True), tmp_path / "a.npz")
    (tmp_path / "a.toml").write_text(f"[orientation]\nfilter = '{name}'\n")
    result = invoke("estimate", "a.npz", *ESTIMATE, "-c", "a.toml")
    assert result.exit_code == 0, result.output
    assert f"by the filter {name}, online" in result.stderr
    streams = read(tmp_path / "out" / "estimate.npz").streams
    known = {"orientation", "orientation_covariance", "gyroscope_bias"}
    assert set(streams) == ({"orientation"} if name == "madgwick" else known)
    assert streams["orientation"].extra["filter"] == name
    limit = 0.4 if name == "madgwick" else 0.3  # Madgwick is pulled to where it was a sample ago, 0.31 deg
    assert worst_deg(streams["orientation"].value, orientation(np.arange(200) / 100)) < limit


def test_smoothed(invoke, tmp_path):
    write(turning(truth=True), tmp_path / "a.npz")
    (tmp_path / "a.toml").write_text("[orientation]\nsmooth = true\n[orientation.ekf.rest]\ntime = 2.0\n")
    result = invoke("estimate", "a.npz", *ESTIMATE, "-c", "a.toml")
    assert result.exit_code == 0, result.output
    item = read(tmp_path / "out" / "estimate.npz").streams["orientation"]
    assert item.extra["smoothed"] is True
    assert worst_deg(item.value, orientation(item.time)) < 0.3


@pytest.mark.recorded
def test_broad_trial(invoke, shared, tmp_path):
    """One trial by the complementary filter with its constant gains, and by the default."""
    trial = shared / "recordings" / "broad" / "04_undisturbed_slow_rotation_with_breaks_A.npz"
    (tmp_path / "a.toml").write_text(PLAIN)
    rows = json.loads(invoke("estimate", trial, *ESTIMATE, "-c", "a.toml", "--json").stdout)["rows"]
    found = {row["metric"]: row["value"] for row in rows}
    assert found["total RMSE"] == pytest.approx(5.08, abs=0.05)
    again = json.loads(invoke("compare", "out/estimate.npz", trial, "--json").stdout)["rows"]
    assert {row["metric"]: row["value"] for row in again}["total RMSE"] == pytest.approx(found["total RMSE"], rel=1e-6)
    rows = json.loads(invoke("estimate", trial, *ESTIMATE, "--force", "--json").stdout)["rows"]
    assert {row["metric"]: row["value"] for row in rows}["total RMSE"] < 1.0


@pytest.mark.slow
@pytest.mark.recorded
def test_broad(invoke, shared, tmp_path):
    """The benchmark's means with constant gains, on which two independent implementations agree."""
    (tmp_path / "a.toml").write_text(PLAIN)
    total, inclination = [], []
    for trial in sorted((shared / "recordings" / "broad").glob("*.npz")):
        for sensors, kept, metric in (
            ("gyroscope,accelerometer", inclination, "inclination RMSE"),
            ("gyroscope,accelerometer,magnetometer", total, "total RMSE"),
        ):
            result = invoke("estimate", trial, *ESTIMATE, "-c", "a.toml", "--sensors", sensors, "--force", "--json")
            assert result.exit_code == 0, result.stderr
            kept += [row["value"] for row in json.loads(result.stdout)["rows"] if row["metric"] == metric]
    assert len(total) == len(inclination) == 20
    assert np.mean(inclination) == pytest.approx(2.82, abs=0.1)
    assert np.mean(total) == pytest.approx(7.3, abs=0.1)
