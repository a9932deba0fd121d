import json
import tomllib

import numpy as np
import pytest
from turning_imu import turning

from jaxest.io import SensorLog, read, write

ARM = """<mujoco model="arm"><worldbody><site name="table"/><body name="base"><body name="upper" pos="0 0 .1">
  <joint name="shoulder" axis="0 1 0" range="-60 90"/><inertial pos="0 0 .1" mass="2" diaginertia=".1 .1 .1"/>
  <site name="tip" pos="0 0 .2"/><body name="slider"><joint name="s" type="slide" axis="0 0 2"/>
  <geom type="sphere" size=".01" mass=".5"/></body></body></body>
  <body name="ball"><joint name="b" type="ball"/><geom type="sphere" size=".01" mass=".5"/></body>
  </worldbody></mujoco>"""


def test_robot(invoke, tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    result = invoke("inspect", "arm.xml")
    assert result.exit_code == 0, result.output
    for part in ("upper  hinge shoulder", "base  fixed", "site:tip", "site:table", "6 coordinates, 5 velocities, 3 kg",
                 "-1.047 .. 1.571 rad", "1 0 0 0"):  # fmt: skip
        assert part in result.stdout


def test_robot_as_json(invoke, tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    result = invoke("inspect", "arm.xml", "--json")
    found = json.loads(result.stdout)
    robot = found["robot"]
    assert {row["metric"]: row["value"] for row in found["rows"]} == {
        "nq": 6, "nv": 5, "mass": pytest.approx(3), "bodies": 4, "joints": 3, "frames": 6,
    }  # fmt: skip
    shoulder, slide, ball = robot["joints"]
    assert (shoulder["name"], shoulder["kind"], shoulder["body"]) == ("shoulder", "hinge", "upper")
    assert shoulder["limits"] == pytest.approx(np.deg2rad([-60, 90]))
    assert slide["axis"] == [0, 0, 1]
    assert slide["limits"] == [None, None]
    assert (ball["axis"], ball["home"], ball["q"]) == (None, [1, 0, 0, 0], 2)
    assert robot["frames"][-2:] == ["site:table", "site:tip"]


def test_what_was_dropped_is_said_once(invoke, tmp_path):
    text = ARM.replace("<worldbody>", '<asset><mesh name="m" file="no.stl"/></asset><worldbody>').replace(
        '<site name="tip"', '<geom type="mesh" mesh="m" mass="0"/><site name="tip"'
    )
    (tmp_path / "arm.xml").write_text(text)
    result = invoke("inspect", "arm.xml")
    assert result.exit_code == 0, result.output
    assert result.stdout.count("no.stl") == 1
    assert json.loads(invoke("inspect", "arm.xml", "--json").stdout)["robot"]["notes"]


def test_log(invoke, tmp_path):
    log = turning(100)
    gyroscope = log.streams["gyroscope"]
    keep = ~np.isin(np.arange(100), (50, 51))
    value = gyroscope.value[keep] + np.linspace(0, 1, 98)[:, None]
    value[3] = np.nan
    item = gyroscope._replace(time=gyroscope.time[keep] + 0.002, value=value)
    acceleration = log.streams["accelerometer"]
    write(SensorLog({"gyroscope": item, "accelerometer": acceleration._replace(value=acceleration.value / 9.81)}),
          tmp_path / "a.npz")  # fmt: skip
    result = invoke("inspect", "a.npz")
    assert result.exit_code == 0, result.output
    assert "1 (to 0.0300 s)" in result.stdout
    assert "is it in g?" in result.stdout
    assert "0.002 s" in result.stdout
    assert "[columns]" not in result.stdout
    found = json.loads(invoke("inspect", "a.npz", "--json").stdout)
    rows = {(row["metric"], row["condition"]): row["value"] for row in found["rows"]}
    assert rows["rate", "gyroscope"] == pytest.approx(100)
    assert rows["gaps", "gyroscope"] == 1
    assert rows["longest gap", "gyroscope"] == pytest.approx(0.03)
    assert rows["missing rows", "gyroscope"] == 1
    assert rows["samples", "accelerometer"] == 100
    assert any("is it in g?" in line for line in found["warnings"])


def test_proposed_config_reads_the_log(invoke, tmp_path):
    log = turning(100)
    np.savez(tmp_path / "a.npz", t=log.streams["gyroscope"].time, gyr=log.streams["gyroscope"].value,
             acc=log.streams["accelerometer"].value / 9.81)  # fmt: skip
    result = invoke("inspect", "a.npz")
    assert result.exit_code == 0, result.output
    config = result.stdout[result.stdout.index("\n#") :]
    (tmp_path / "a.toml").write_text(config)
    streams = read(tmp_path / "a.npz", tomllib.loads(config)["columns"]).streams
    np.testing.assert_allclose(streams["accelerometer"].value, log.streams["accelerometer"].value, rtol=1e-3)
    again = invoke("inspect", "a.npz", "-c", "a.toml")
    assert again.exit_code == 0
    assert "[columns]" not in again.stdout
    assert json.loads(invoke("inspect", "a.npz", "--json").stdout)["config"].strip() == config.strip()


def foreign(tmp_path, imus):
    """A CSV of some IMUs, with a missing reading."""
    log = turning(magnetometer=False)
    readings = {kind: log.streams[kind].value.copy() for kind in ("gyroscope", "accelerometer")}
    readings["gyroscope"][7, 1] = np.nan
    names, columns = ["t"], [log.streams["gyroscope"].time]
    for imu in imus:
        for kind, value in readings.items():
            names += [f"{imu}{kind[:3]}_{axis}" for axis in "xyz"]
            columns += list(value.T)
    np.savetxt(tmp_path / "theirs.csv", np.stack(columns, axis=-1), delimiter=",", header=",".join(names), comments="")
    return "theirs.csv"


@pytest.mark.parametrize("imus", [[""], ["left_", "right_"]])
def test_proposed_config_makes_estimate_work(invoke, tmp_path, imus):
    file = foreign(tmp_path, imus)
    assert invoke("estimate", file, "-m", "orientation").exit_code == 2
    config = json.loads(invoke("inspect", file, "--json").stdout)["config"]
    assert config.strip() in invoke("inspect", file).stdout
    (tmp_path / "config.toml").write_text(config)
    result = invoke("estimate", file, "-m", "orientation", "-c", "config.toml")
    assert result.exit_code == 0, result.output


def test_the_config_of_our_own_layout(invoke, tmp_path):
    log = turning(magnetometer=False)
    write(log, tmp_path / "a.npz")
    assert tomllib.loads(json.loads(invoke("inspect", "a.npz", "--json").stdout)["config"]) == {}
    for name in ("gyroscope", "accelerometer"):
        log.streams[f"imu0/{name}"], log.streams[f"imu1/{name}"] = log.streams[name], log.streams.pop(name)
    write(log, tmp_path / "b.npz")
    found = json.loads(invoke("inspect", "b.npz", "--json").stdout)["config"]
    assert tomllib.loads(found) == {"orientation": {"imu": "imu0"}, "onsite": {"first": "imu0", "second": "imu1"}}


def test_stamps_that_cannot_be_are_shown_with_lines_that_mend_them(refused, tmp_path):
    """Two samples share a stamp; by their rate instead the log can be read."""
    time = np.arange(200) / 100
    time[50] = time[49]
    rows = np.c_[time, np.zeros((200, 3)), np.tile([0, 0, 9.8], (200, 1))].tolist()
    text = "\n".join(["t,gx,gy,gz,ax,ay,az", *(",".join(map(repr, row)) for row in rows)])
    (tmp_path / "log.csv").write_text(text)
    message = refused("inspect", "log.csv")
    assert "is a duplicate of row 49's" in message
    lines = message[message.index("# gyroscope") :]
    assert 'time = "t"\ntime_unit = "s"' in lines
    mended = tomllib.loads(lines.replace('time = "t"\ntime_unit = "s"', "rate = 100.0"))
    np.testing.assert_allclose(read("log.csv", mended["columns"]).streams["gyroscope"].time, np.arange(200) / 100)


def test_open_layout_is_shown_with_lines_to_paste(invoke, tmp_path):
    np.savez(tmp_path / "a.npz", gyr=np.zeros((5, 3)), acc=np.ones((5, 3)))
    result = invoke("inspect", "a.npz")
    assert result.exit_code == 0, result.output
    assert "# open: gyroscope: no stamps of 5 rows and no sampling rate" in result.stdout
    assert "[columns.gyroscope]" in result.stdout
    found = json.loads(invoke("inspect", "a.npz", "--json").stdout)
    assert any("no sampling rate" in line for line in found["open"])
    assert found["rows"] == []


@pytest.mark.recorded
@pytest.mark.parametrize("name", ["panda.xml", "baxter_arm.urdf", "inspire_left_hand.xml", "humanoid/humanoid.xml"])
def test_real_robots(invoke, shared, name):
    result = invoke("inspect", shared / "robots" / name)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""


@pytest.mark.recorded
def test_real_logs(invoke, shared):
    assert "285.7 Hz" in invoke("inspect", shared / "recordings/broad/24_disturbed_tapping_A.npz").stdout
    two = invoke("inspect", shared / "recordings/two_imus_200mm/twoimus_200mm_sample.npz")
    assert two.exit_code == 0
    assert "imu1/accelerometer" in two.stdout
