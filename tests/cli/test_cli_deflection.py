"""`jaxest estimate --method deflection`: a bent arm's log, and all that may be wrong with one."""

import json
import tomllib

import numpy as np
import pytest
from deflection_models import CRANE
from scipy.spatial.transform import Rotation

from jaxest import models, tuning
from jaxest.cli.methods import deflection_config
from jaxest.io import SensorLog, Stream, read, write
from jaxest.types import InputError

JOINTS = ("yaw", "shoulder", "elbow", "gripper")
BENT = np.array([0.3, 0.8, 0.7, -0.2])  # how the arm stands
READ = np.array([0.3, 0.7, 0.65, -0.2])  # what the encoders say
CONFIG = """
[deflection]
particles = 64

[deflection.sensors.encoders]
kind = "joint_angle"
stream = "joint_position"
concentration = 15.0

[deflection.sensors.imu2]
kind = "link_orientation"
stream = "imu2/orientation"
frame = "site:imu2"

[deflection.sensors.imu3]
kind = "link_orientation"
stream = "imu3/orientation"
frame = "site:imu3"
lam = [0, -800, -800, 0]
"""


def tilted(yaw, pitch, n):
    """A link turned about z, then about its own y, (n, 4) wxyz."""
    c, s, d, t = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(pitch / 2), np.sin(pitch / 2)
    return np.tile([c * d, -s * t, c * t, s * d], (n, 1))


def bent(n=40):
    """Streams of the arm at rest, without noise; the yaw of one IMU is off by a rad."""
    time = np.arange(n) / 10
    return {
        "joint_position": Stream(time, np.tile(READ, (n, 1)), "rad", names=JOINTS),
        "imu2/orientation": Stream(time, tilted(1.3, 0.8, n), "1"),
        "imu3/orientation": Stream(time + 0.01, tilted(0.3, 1.5, n), "1"),
        "joints": Stream(time, np.tile(BENT, (n, 1)), "rad", names=JOINTS),
    }


@pytest.fixture
def log(tmp_path):
    """Write a log and a config, and return the words of the command."""

    def make(config=CONFIG, **changes):
        streams = bent()
        for name, (field, value) in changes.items():
            streams[name.replace("__", "/")] = streams[name.replace("__", "/")]._replace(**{field: value})
        write(SensorLog(streams), tmp_path / "log.npz", overwrite=True)
        (tmp_path / "c.toml").write_text(config)
        robot = models.path("arm")
        return ("estimate", "log.npz", "-m", "deflection", "--robot", robot, "--config", "c.toml", "-o", "out")

    return make


def test_a_particle_filter_has_no_consistency(refused, log):
    assert "likelihood or relaxed" in refused("tune", *log()[1:-2], "--objective", "consistency")


def test_windows_count_once_the_arm_is_found(refused, log, monkeypatch):
    """They are cut anywhere, and the prior is of a log's beginning: a sharp one made sensors worse than they are."""

    def begun(problem, *given, **options):
        raise InputError(f"{problem.windows}")

    monkeypatch.setattr(tuning, "minimise", begun)
    assert "Windows(recordings=1, length=40, settle=6)" in refused("tune", *log()[1:-2], "--starts", 1)


@pytest.mark.slow
def test_a_relaxed_filter_is_tuned_with_few_particles(invoke, log, tmp_path):
    """Not how far: of an arm that stands still the score scatters, and goes up with some seeds and down with others."""
    words = log()[1:-2]
    result = invoke("tune", *words, "--objective", "relaxed", "--free", "walk", "--starts", 1, "--evaluations", 3,
                    "-o", "tuned.toml", "--json")  # fmt: skip
    assert result.exit_code == 0, result.output
    tuned = tomllib.loads((tmp_path / "tuned.toml").read_text())["deflection"]
    objective = json.loads(result.stdout)["rows"][0]
    assert objective["reference_name"] == "start"
    assert np.isfinite([objective["value"], objective["reference"]]).all()
    assert 3 < tuned["walk"] < 8
    assert tuned["walk"] != 5  # the default
    assert tuned["particles"] == 64


def test_a_bent_arm_is_known_better_than_by_its_encoders(invoke, log, tmp_path):
    result = invoke(*log(), "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    rows = {(row["metric"], row["condition"]): row["value"] for row in found["rows"]}
    assert rows["from the reading, RMS", "shoulder"] > 4  # it is 5.7 deg away
    assert rows["error to joints, RMS", "shoulder"] < 1.5  # posterior 3 deg, of 64 particles' mean 0.4
    assert rows["error to joints, RMS", "elbow"] < 2
    assert rows["truth inside 95 % interval", "all joints"] > 99
    assert rows["effective sample size", "mean"] > 32
    estimate = read(tmp_path / "out" / "estimate.npz").streams
    assert estimate["joints"].names == JOINTS
    assert estimate["joints"].value.shape == (40, 4)
    assert estimate["joints_covariance"].value.shape == (40, 4, 4)
    assert (estimate["joints_lower"].value < estimate["joints"].value).all()
    assert (estimate["joints_upper"].value > estimate["joints"].value).all()
    assert (tmp_path / "out" / "deflection.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_quaternions_in_the_other_order_and_missing_rows_change_nothing_where_the_config_says_so(invoke, log):
    values = []
    for order in ("wxyz", "xyzw"):
        q = bent()["imu3/orientation"].value.copy()
        q[7] = np.nan
        q = q[:, [1, 2, 3, 0]] if order == "xyzw" else q
        config = 'nan = "missing"\n' + CONFIG + f'order = "{order}"\n'
        result = invoke(*log(config, imu3__orientation=("value", q)), "--json", "--force")
        assert result.exit_code == 0, result.output
        values.append([row["value"] for row in json.loads(result.stdout)["rows"] if row["metric"] != "run time"])
    assert values[0] == values[1]


def changed(stream, row, value):
    """Values of a stream with one row replaced."""
    values = bent()[stream].value.copy()
    values[row] = value
    return values


BAD = {
    "unknown frame": (CONFIG.replace("site:imu3", "site:imu33"), {}, ["sensors.imu3", "'site:imu33'", "'site:imu3'"]),
    "unknown stream": (CONFIG.replace("imu2/orient", "imu2/orent"), {}, ["imu2/orentation", "'imu2/orientation'"]),
    "unknown kind": (CONFIG.replace("joint_angle", "joint_angel"), {}, ["sensors.encoders", "'joint_angle'"]),
    "unknown key": (CONFIG.replace("lam =", "lamb ="), {}, ["c.toml, line", "sensors.imu3.lam'"]),
    "unknown proposal": (CONFIG.replace("particles = 64", 'proposal = "guide"'), {}, ["proposal", "'guided'"]),
    "negative concentration": (CONFIG.replace("15.0", "-15.0"), {}, ["sensors.encoders", "-15", "at least 0"]),
    "negative walk": (CONFIG.replace("particles = 64", "walk = -1.0"), {}, ["walk", "-1.0", "0 or more"]),
    "no sensor": ("[deflection]\n", {}, ["names no sensor", "jaxest inspect ROBOT"]),
    "lengths": (
        CONFIG,
        {"imu3__orientation": ("value", 1.1 * bent()["imu3/orientation"].value)},
        ["'imu3/orientation'", "row 0 at 0.010000 s", "length 1.1", "expected 1"],
    ),
    "order": (
        CONFIG,
        {"imu3__orientation": ("value", bent()["imu3/orientation"].value[:, [1, 2, 3, 0]])},
        ["'imu3/orientation'", 'order = "xyzw"', "sensors.imu3"],
    ),
    "inverse": (
        CONFIG,
        {"imu3__orientation": ("value", bent()["imu3/orientation"].value * [1, -1, -1, -1])},
        ["'imu3/orientation'", "world to sensor"],
    ),
    "NaN": (
        CONFIG,
        {"joint_position": ("value", changed("joint_position", 3, np.nan))},
        ["'joint_position'", "row 3 at 0.3", 'nan = "missing"'],
    ),
    "columns": (
        CONFIG,
        {"joint_position": ("names", ("a", "b", "c", "d"))},
        ["'joint_position'", "a, b, c, d", "yaw", "joints = [...]"],
    ),
    "joints of a frame": (
        CONFIG.replace('frame = "site:imu3"', 'frame = "site:imu3"\njoints = ["yaw"]'), {},
        ["sensors.imu3", "joints is ['yaw'] and would do nothing"],
    ),
    "two frames": (
        CONFIG.replace('frame = "site:imu3"', 'frame = "site:imu3"\nframes = ["site:imu2"]'), {},
        ["sensors.imu3", "frame is 'site:imu3' and would do nothing"],
    ),
    "filter of a stream": (
        CONFIG.replace('frame = "site:imu3"', 'frame = "site:imu3"\nattitude = "ekf"'), {},
        ["sensors.imu3", "attitude is 'ekf' and would do nothing", "raw IMU"],
    ),
    "order of angles": (
        CONFIG.replace("concentration = 15.0", 'concentration = 15.0\norder = "xyzw"'), {},
        ["sensors.encoders", "order is 'xyzw' and would do nothing"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_named(refused, log, name):
    config, changes, parts = BAD[name]
    message = refused(*log(config, **changes))
    for part in parts:
        assert part in message


@pytest.mark.parametrize(("stamp", "word"), [(0.75, "earlier than"), (0.8, "a duplicate of")])
def test_unsorted_and_duplicate_stamps_are_refused(refused, log, tmp_path, stamp, word):
    words = log()
    arrays = dict(np.load(tmp_path / "log.npz"))
    arrays["imu2/orientation/time"][9] = stamp
    np.savez(tmp_path / "log.npz", **arrays)
    message = refused(*words)
    for part in ("'imu2/orientation'", "row 9", word, "strictly increasing"):
        assert part in message


def test_a_robot_is_needed(refused, log):
    words = [str(word) for word in log()]
    at = words.index("--robot")
    assert "--robot" in refused(*words[:at], *words[at + 2 :])


def test_the_first_config_of_robot_and_log_are_accepted(invoke, log, tmp_path):
    log()
    for file in (models.path("arm"), "log.npz"):
        result = invoke("inspect", file, "--json")
        assert result.exit_code == 0, result.output
        text = json.loads(result.stdout)["config"]
        (tmp_path / "first.toml").write_text(text)
        from jaxest.cli.settings import load

        table = load(tmp_path / "first.toml").method("deflection")
        found = deflection_config.sensors(table)
        assert [one.sensor.name for one in found][:3] == ["encoders", "imu2", "imu3"]
        assert found[1].sensor.frames == ("site:imu2",)


@pytest.mark.parametrize(("left", "right"), [pytest.param("left_", "right_", marks=pytest.mark.slow), ("l/", "r/")])
def test_a_robot_of_two_arms_is_given_a_stream_for_each(invoke, tmp_path, left, right):
    def arm(side, at):
        return (
            f'<body pos="0 {at} 0"><joint name="{side}up" axis="0 1 0"/><geom size=".1"/>'
            f'<body pos=".5 0 0"><joint name="{side}out" axis="0 1 0"/><geom size=".1"/></body></body>'
        )

    (tmp_path / "two.xml").write_text(f"<mujoco><worldbody>{arm(left, 0.3)}{arm(right, -0.3)}</worldbody></mujoco>")
    text = json.loads(invoke("inspect", "two.xml", "--json").stdout)["config"]
    time, names = np.arange(40) / 10, {side[:-1]: (f"{side}up", f"{side}out") for side in (left, right)}
    streams = {f"{side}/joint_position": Stream(time, np.full((40, 2), 0.1 + k), "rad") for k, side in enumerate(names)}
    write(SensorLog(streams), tmp_path / "log.npz")
    (tmp_path / "c.toml").write_text(text)
    result = invoke("estimate", "log.npz", "-m", "deflection", "-r", "two.xml", "-c", "c.toml")
    assert result.exit_code == 0, result.output
    joints = read(tmp_path / "jaxest-out/estimate.npz").streams["joints"]
    assert joints.names == tuple(name for pair in names.values() for name in pair)
    np.testing.assert_allclose(joints.value[-1], [0.1, 0.1, 1.1, 1.1], atol=0.15)


@pytest.mark.slow
def test_slides_and_balls_are_estimated_where_they_are_named(invoke, refused, tmp_path):
    """The crane stands still, bent; its first config, with the marker's stream, is enough."""
    (tmp_path / "crane.xml").write_text(CRANE)
    text = json.loads(invoke("inspect", "crane.xml", "--json").stdout)["config"]
    assert 'joints = ["boom", "rail", "wrist"]' in text
    assert '"drift"' not in text
    n, turn = 40, Rotation.from_euler("xyz", [0.2, -0.1, 0.3])
    lean = Rotation.from_euler("y", 0.4)
    tip = np.array([0.1, 0, 2]) + lean.apply([0.4, 0, 0]) + (lean * turn).apply([0.2, 0.05, 0])
    time = np.arange(n) / 10
    streams = {
        "joint_position": Stream(time, np.tile([0.09, 0.35], (n, 1)), "rad", names=("rail", "boom")),
        "imu/orientation": Stream(time, np.tile(lean.as_quat()[[3, 0, 1, 2]], (n, 1)), "1"),
        "cup/orientation": Stream(time, np.tile((lean * turn).as_quat()[[3, 0, 1, 2]], (n, 1)), "1"),
        "tip/position": Stream(time, np.tile(tip, (n, 1)), "m"),
        "joints": Stream(time, np.tile([0.1, 0.4], (n, 1)), "rad", names=("rail", "boom")),
    }
    write(SensorLog(streams), tmp_path / "log.npz")
    cup = '\n[deflection.sensors.cup]\nkind = "link_orientation"\nstream = "cup/orientation"\nframe = "cup"\n'
    text = text.replace("[0.01, 0.01, 0.01]", "[1e-6, 1e-6, 1e-6]")
    (tmp_path / "c.toml").write_text(text + cup + "lam = [0, -800, -800, -800]\n")
    words = ("estimate", "log.npz", "-m", "deflection", "--robot", "crane.xml", "--config", "c.toml", "-o", "out")
    result = invoke(*words, "--json")
    assert result.exit_code == 0, result.output
    rows = {(row["metric"], row["condition"]): row for row in json.loads(result.stdout)["rows"]}
    assert rows["error to joints, RMS", "rail"]["unit"] == "mm"
    assert rows["error to joints, RMS", "rail"]["value"] < 5 < 9 < rows["from the reading, RMS", "rail"]["value"]
    assert rows["error to joints, RMS", "boom"]["value"] < 1
    assert rows["half 95 % interval", "wrist x"]["unit"] == "deg"
    found = read(tmp_path / "out" / "estimate.npz").streams
    assert (found["joints"].names, found["slides"].names, found["slides"].unit) == (("boom",), ("rail",), "m")
    away = turn.inv() * Rotation.from_quat(found["wrist/orientation"].value[-1, [1, 2, 3, 0]])
    assert np.rad2deg(away.magnitude()) < 2
    assert found["wrist/orientation_covariance"].value.shape == (n, 3, 3)
    (tmp_path / "c.toml").write_text(text.replace('"wrist"]', '"drift"]'))
    assert "'drift' is a free joint" in refused(*words, "--force")
    (tmp_path / "c.toml").write_text(text.replace("joints =", "prior = 0.0\njoints =", 1))
    assert "prior: got 0.0, expected more than 0 for slides" in refused(*words, "--force")
    (tmp_path / "c.toml").write_text(text.replace('"rail", ', ""))
    assert "sensors.slides" in (message := refused(*words, "--force")) and "no slide is estimated" in message


def test_a_first_config_gives_each_sensor_a_table_and_a_likely_frame():
    """An IMU and a marker on one link, both under the link's name, which no site would have."""
    time, three = np.arange(5) / 10.0, np.zeros((5, 3))
    streams = {f"wrist/{kind}": Stream(time, three, unit) for kind, unit in
               (("gyroscope", "rad/s"), ("accelerometer", "m/s2"), ("position", "m"))}  # fmt: skip
    streams["imu_tip/position"] = streams["wrist/position"]
    streams["joint_position"] = Stream(time, three, "rad", names=("a", "b", "c"))
    table = tomllib.loads(deflection_config.of_log(SensorLog(streams)))["deflection"]["sensors"]
    assert {name: one.get("frame") for name, one in table.items()} == {
        "encoders": None, "wrist": "wrist", "wrist_position": "wrist", "imu_tip": "site:imu_tip",
    }  # fmt: skip
    assert table["wrist"]["imu"] == "wrist"


@pytest.mark.slow
def test_a_raw_imu_becomes_an_orientation(invoke, tmp_path):
    n, rate = 600, 100.0
    time = np.arange(n) / rate
    up = 9.81 * np.array([-np.sin(1.5), 0, np.cos(1.5)])  # in the forearm, which leans by 1.5 rad
    streams = bent()
    upper = 9.81 * np.array([-np.sin(0.8), 0, np.cos(0.8)])
    del streams["imu2/orientation"], streams["imu3/orientation"]
    for name, force in (("imu2", upper), ("imu3", up)):
        streams[f"{name}/gyroscope"] = Stream(time, np.full((n, 3), 1e-3), "rad/s")
        streams[f"{name}/accelerometer"] = Stream(time, np.tile(force, (n, 1)), "m/s2")
    write(SensorLog(streams), tmp_path / "raw.npz")
    config = CONFIG.replace('stream = "imu2/orientation"', 'imu = "imu2"\nattitude = "madgwick"')
    (tmp_path / "c.toml").write_text(config.replace('stream = "imu3/orientation"', 'imu = "imu3"\nattitude = "ekf"'))
    words = ("estimate", "raw.npz", "-m", "deflection", "--robot", models.path("arm"), "-c", "c.toml", "--json")
    result = invoke(*words)
    assert result.exit_code == 0, result.output
    rows = {(row["metric"], row["condition"]): row["value"] for row in json.loads(result.stdout)["rows"]}
    assert rows["error to joints, RMS", "shoulder"] < 1.5
    assert rows["error to joints, RMS", "elbow"] < 2
