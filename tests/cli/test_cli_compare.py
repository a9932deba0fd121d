import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from turning_imu import orientation

from jaxest.io import SensorLog, Stream, write


def wxyz(rotation):
    return np.roll(rotation.as_quat(), 1, axis=-1)


def rotation(quaternion):
    return Rotation.from_quat(np.roll(quaternion, -1, axis=-1))


def save(path, time, quaternion, **more):
    streams = {"orientation": Stream(time, quaternion, "1")} | {name: Stream(time, v) for name, v in more.items()}
    write(SensorLog(streams), path)


def compared(invoke, *words):
    result = invoke("compare", *words, "--json")
    assert result.exit_code == 0, result.output
    return {row["metric"]: row for row in json.loads(result.stdout)["rows"]}


def test_errors_by_hand(invoke, tmp_path):
    time = np.arange(100) / 50
    true = orientation(time)
    heading, tilt = 3.0, 4.0
    wrong = Rotation.from_euler("Z", heading, degrees=True) * Rotation.from_euler("X", tilt, degrees=True)
    estimate = wxyz(wrong * rotation(true))
    estimate[80:] = wxyz(Rotation.from_euler("X", 90, degrees=True) * rotation(true[80:]))
    true[::10] = np.nan
    save(tmp_path / "a.npz", time, -estimate)  # the sign of a quaternion means nothing
    save(tmp_path / "b.npz", time, true, movement=np.arange(100) < 80)
    rows = compared(invoke, "a.npz", "b.npz")
    assert rows["heading RMSE"]["value"] == pytest.approx(heading, abs=1e-6)
    assert rows["inclination RMSE"]["value"] == pytest.approx(tilt, abs=1e-6)
    assert rows["total RMSE"]["value"] == pytest.approx(np.rad2deg(wrong.magnitude()), abs=1e-6)
    assert rows["total RMSE"]["n"] == 72
    assert "orientation NEES" not in rows
    assert "heading RMSE" in invoke("compare", "a.npz", "b.npz").stdout


def test_truth_at_other_stamps_is_interpolated(invoke, tmp_path):
    time = np.arange(100) / 50
    other = np.arange(37) / 20 + 0.013
    true = orientation(other)
    true[10] = np.nan
    save(tmp_path / "a.npz", time, orientation(time))
    save(tmp_path / "b.npz", other, true)
    rows = compared(invoke, "a.npz", "b.npz")
    assert rows["total RMSE"]["value"] < 1e-6  # a constant rate is interpolated exactly
    between = (time > other[9]) & (time < other[11])
    inside = (time >= other[0]) & (time <= other[-1])
    assert rows["total RMSE"]["n"] == (inside & ~between).sum()


def test_consistency(invoke, tmp_path):
    rng = np.random.default_rng(5)
    n, covariance = 2000, np.diag([1e-3, 4e-3, 2e-2]) ** 2
    time = np.arange(n) / 100
    true = orientation(time)
    noise = rng.multivariate_normal(np.zeros(3), covariance, n)
    estimate = wxyz(rotation(true) * Rotation.from_rotvec(-noise))
    save(tmp_path / "a.npz", time, estimate, orientation_covariance=np.tile(covariance, (n, 1, 1)))
    save(tmp_path / "b.npz", time, true)
    rows = compared(invoke, "a.npz", "b.npz")
    assert rows["orientation NEES"]["value"] == pytest.approx(3, abs=5 * np.sqrt(6 / n))  # variance of chi-square: 6
    assert rows["orientation NEES"]["reference"] == 3
    assert rows["orientation inside 95 %"]["value"] == pytest.approx(95, abs=500 * np.sqrt(0.05 * 0.95 / n))


def test_inclination_alone_is_judged_by_two_degrees_of_freedom(invoke, tmp_path):
    rng = np.random.default_rng(6)
    n, covariance = 2000, np.diag([1e-3, 4e-3, 2e-3]) ** 2
    time = np.arange(n) / 100
    true = orientation(time)
    noise = rng.multivariate_normal(np.zeros(3), covariance, n)
    turned = Rotation.from_euler("Z", 100, degrees=True) * rotation(true)  # another north
    streams = {
        "orientation": Stream(time, wxyz(turned * Rotation.from_rotvec(-noise)), "1", extra={"heading": "free"}),
        "orientation_covariance": Stream(time, np.tile(covariance, (n, 1, 1)), "rad2"),
    }
    write(SensorLog(streams), tmp_path / "a.npz")
    save(tmp_path / "b.npz", time, true)
    rows = compared(invoke, "a.npz", "b.npz")
    assert rows["inclination NEES"]["value"] == pytest.approx(2, abs=5 * np.sqrt(4 / n))
    assert set(rows) == {"inclination RMSE", "inclination NEES", "inclination inside 95 %"}


def test_somebody_elses_layout(invoke, tmp_path):
    time = np.arange(50) / 50
    true = orientation(time)
    np.savez(tmp_path / "b.npz", t=time, attitude=np.roll(true, -1, axis=-1))
    (tmp_path / "b.toml").write_text(
        "[columns]\ntime = 't'\n[columns.orientation]\narray = 'attitude'\norder = 'xyzw'\n"
    )
    save(tmp_path / "a.npz", time, true)
    assert compared(invoke, "a.npz", "b.npz", "-c", "b.toml")["total RMSE"]["value"] < 1e-6


def test_one_of_several(invoke, tmp_path):
    time = np.arange(50) / 50
    streams = {"hand/orientation": Stream(time, orientation(time), "1"),
               "arm/orientation": Stream(time, orientation(-time), "1")}  # fmt: skip
    write(SensorLog(streams), tmp_path / "a.npz")
    save(tmp_path / "b.npz", time, orientation(time))
    assert invoke("compare", "a.npz", "b.npz").exit_code == 2
    assert compared(invoke, "a.npz", "b.npz", "--stream", "hand/orientation")["total RMSE"]["value"] < 1e-6


@pytest.mark.parametrize("order", [("six.npz", "nine.npz"), ("nine.npz", "six.npz")])
def test_a_free_heading_on_either_side_is_not_judged(invoke, tmp_path, order):
    time = np.arange(50) / 50
    turned = wxyz(Rotation.from_euler("Z", 40, degrees=True) * rotation(orientation(time)))
    save(tmp_path / "nine.npz", time, orientation(time))
    six = Stream(time, turned, "1", extra={"heading": "free"})
    write(SensorLog({"orientation": six}), tmp_path / "six.npz")
    rows = compared(invoke, *order)
    assert set(rows) == {"inclination RMSE"}
    assert rows["inclination RMSE"]["value"] < 1e-6
