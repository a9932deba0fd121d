"""`jaxest estimate --method slam`: a simulated structure's log, and configs that cannot be."""

import json
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from jaxest import kinematics
from jaxest.cli.methods import Request, slam, slam_figures, slam_streams
from jaxest.cli.methods.slam_imu import driven
from jaxest.io import SensorLog, Stream, read, write
from jaxest.io.clouds import read_cloud
from jaxest.io.report import Row
from jaxest.sensors.proximity import ring
from jaxest.simulate import proximity, rooms
from jaxest.systems.slam import Free
from jaxest.types import FOLLOWS, LOST, UNSEEN, InputError

CONFIG = """
[slam]
points = 128
capacity = 2000

[slam.rings.body]
frames = ["root", "link1", "link2"]
along = 0.085
rows = 4
columns = 4
"""

ALIGNED = """
[slam]
points = 72
capacity = 900
align = true
tilt = 0.02

[slam.rings.body]
frames = ["root", "link1"]
along = 0.085
rows = 3
columns = 3
"""


@pytest.fixture(scope="module")
def log():
    scene = rooms.scene(2, rooms.room(4, reach=1.0))
    time, q = proximity.inside(scene, 4, duration=1.2)
    sensors = [s for frame in ("root", "link1", "link2") for s in ring(frame, 0.085, rows=4, columns=4)]
    scan = proximity.cast(scene, sensors, q, time)
    value, there = proximity.corrupt(scan, sensors, proximity.Faults(), 0)
    ranges = np.where(there, value, np.nan).astype(float)
    return SensorLog({
        "joints": Stream(time, q + 0.05, "rad", names=("joint1", "joint2")),
        "ranges": Stream(time, ranges, "m"),
    })  # fmt: skip


def small(free=False):
    """What one link and its root, at rest, read with 3 x 3 zones a sensor over 0.6 s."""
    scene = rooms.scene(1, rooms.room(4, reach=1.0), free=free)
    time = 0.1 * np.arange(1, 7)
    q = np.zeros((6, 8 if free else 1))
    if free:
        q[:, 3] = 1
    q[:, -1] = 0.2
    sensors = [s for frame in ("root", "link1") for s in ring(frame, 0.085, rows=3, columns=3)]
    scan = proximity.cast(scene, sensors, q, time)
    value, there = proximity.corrupt(scan, sensors, proximity.Faults(), 0)
    return SensorLog({
        "joints": Stream(time, q[:, -1:] + 0.05, "rad", names=("joint1",)),
        "ranges": Stream(time, np.where(there, value, np.nan).astype(float), "m"),
    })  # fmt: skip


def called(log, links, config, tmp_path, monkeypatch):
    """Lay out files and arguments of `jaxest estimate --json`; the folder becomes the current one."""
    write(log, tmp_path / "log.npz")
    (tmp_path / "robot.xml").write_text(rooms.structure(links))
    (tmp_path / "c.toml").write_text(config)
    arguments = ["estimate", "log.npz", "--method", "slam", "--robot", "robot.xml", "--config", "c.toml", "-o", "out"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["jaxest", *arguments, "--json"])


def test_a_log_becomes_poses_biases_and_a_map(log, tmp_path, capsys, monkeypatch):
    from jaxest.cli import main

    called(log, 2, CONFIG, tmp_path, monkeypatch)
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code in (0, None)
    report = json.loads(capsys.readouterr().out)
    found = read(tmp_path / "out" / "estimate.npz")
    assert found.streams["link2/position"].value.shape == (12, 3)
    away = found.streams["joints_bias"].value[-1] - 0.05
    deviation = found.streams["joints_deviation"].value[-1]
    # Twelve scans of few zones tell something, and the deviations hold.
    assert np.all(deviation < 0.08)
    assert np.all(np.abs(away) < 4 * deviation)
    metrics = {(row["metric"], row["condition"]): row["value"] for row in report["rows"]}
    assert metrics["steps flagged as lost", ""] == 0
    assert metrics["steps, link kept its prediction", "root"] > 0  # before there is a map
    assert found.streams["status"].value.shape == (12,)
    assert found.streams["link_status"].names == ("root", "link1", "link2")
    assert metrics["map", "voxels"] > 100
    assert len(read_cloud(tmp_path / "out" / "slam_map.ply").point) == metrics["map", "voxels"]


def test_turns_of_sensors_are_reported_and_the_map_written_without_a_picture(tmp_path, capsys, monkeypatch):
    """`align = true`; matplotlib is away. The second run finds the map alone, and keeps it."""
    from jaxest.cli import main

    find = __import__("importlib.util").util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "matplotlib" else find(name))
    called(small(), 1, ALIGNED, tmp_path, monkeypatch)
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code in (0, None)
    rows = {(row["metric"], row["condition"]): row["value"] for row in json.loads(capsys.readouterr().out)["rows"]}
    assert 0 < rows["turn of a sensor", "mean"] <= rows["turn of a sensor", "largest"] < 3 * np.rad2deg(0.02)
    out = tmp_path / "out"
    assert {path.name for path in out.iterdir()} == {"estimate.npz", "report.json", "slam_map.ply"}
    assert len(read_cloud(out / "slam_map.ply").point) == rows["map", "voxels"]
    for name in ("estimate.npz", "report.json"):
        (out / name).unlink()
    before = (out / "slam_map.ply").read_bytes()
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    assert "slam_map.ply exists already and is kept" in capsys.readouterr().err
    assert (out / "slam_map.ply").read_bytes() == before


@pytest.mark.slow  # a program of its own
def test_an_imu_drives_a_free_root(tmp_path):
    """At rest, where it stays within 3 cm; the streams have the names that the config gives them."""
    given, robot = small(free=True), tmp_path / "robot.xml"
    robot.write_text(rooms.structure(1, free=True))
    time = 0.01 * np.arange(61)
    random = np.random.default_rng(3)
    still = {"spin": np.zeros(3), "force": np.array([0, 0, 9.81])}
    imu = {k: Stream(time, v + 1e-3 * random.normal(size=(61, 3)), u)
           for (k, v), u in zip(still.items(), ("rad/s", "m/s^2"), strict=True)}  # fmt: skip
    settings = {**tomllib.loads(ALIGNED)["slam"], "align": False, "imu": "root", "gyroscope_stream": "spin",
                "accelerometer_stream": "force"}  # fmt: skip
    wheels = Stream(given.streams["ranges"].time, np.zeros((6, 3)), "m")
    outcome = slam.estimate(SensorLog({**given.streams, **imu, "travel": wheels}), Request(settings, robot=robot))
    assert not outcome.refused
    assert "the root is free, driven by an IMU" in outcome.notes[0]
    assert outcome.notes[1] == "not used beside an IMU: travel"
    place = outcome.estimate.streams["root/position"].value
    assert np.abs(place - place[0]).max() < 0.03
    assert outcome.estimate.streams["driven"].value[1:].all()
    with pytest.raises(InputError, match="stream 'spin'"):
        slam.estimate(given, Request(settings, robot=robot))


def single(**changed):
    """Settings of one sensor."""
    return {"sensors": {"a": {"frame": "root", "position": [0, 0, 0.1], "directions": [[0, 0, 1]], **changed}}}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, r"names no sensor; expected .*\[slam.rings.arm\] frames = "),
        ({"rings": {"a": {"along": 0.1}}}, r"\[slam.rings.a\]: has no frame"),
        ({"sensors": {"a": {"frame": "root"}}}, r"\[slam.sensors.a\]: has no position, directions"),
        ({"rings": {"a": {"frame": "root"}}}, "has 384 columns, the config's sensors 512 zones"),
        ({"rings": {"a": {"frame": "toor"}}}, "frame 'toor' does not exist"),
        ({"rings": {"a": {"frame": "root"}}, "ranges": "rangs"}, "did you mean 'ranges'"),
        ({"rings": {"a": {"frame": "root"}}, "noise": 0.0}, r"\[slam\] noise: got 0, expected a finite .* more than 0"),
        ({"rings": {"a": {"frame": "root"}}, "voxel": 0.0}, r"\[slam\] voxel: got 0, expected a finite .* more than 0"),
        ({"rings": {"a": {"frame": "root"}}, "voxel": np.nan}, r"\[slam\] voxel: got nan, expected a finite"),
        ({"rings": {"a": {"frame": "root"}}, "points": 0}, r"\[slam\] points: got 0, expected at least 1"),
        ({"rings": {"a": {"frame": "root"}}, "capacity": 0}, r"\[slam\] capacity: got 0, expected at least 1"),
        ({"rings": {"a": {"frame": "root"}}, "align": True}, r"\[slam\] align: is true without a tilt"),
        ({"rings": {"a": {"frame": "root", "count": 0}}}, r"\[slam.rings.a\] count: got 0, expected at least 1"),
        (single(directions=[[0, 0, 1, 1]]), r"\[slam.sensors.a\] directions: got \[0, 0, 1, 1\], expected a list of"),
        (single(directions=[[0, 0, 1], [1, 0]]), r"\[slam.sensors.a\] directions: got .* expected a list of one or"),
        (single(directions=["x", "y", "z"]), r"\[slam.sensors.a\] directions: got \['x', 'y', 'z'\], expected a list"),
        (single(directions=[]), r"\[slam.sensors.a\] directions: got \[\], expected a list of one or more"),
        (single(position=[0, 0]), r"\[slam.sensors.a\] position: got \[0, 0\], expected \[x, y, z\] in m"),
        ({"rings": {"a": {"frame": "root"}}, "swing": -1.0}, r"\[slam\] swing: got -1, expected a finite"),
        ({"rings": {"a": {"frame": "root"}}, "imu": "root"}, "imu 'root': the robot's root is fixed"),
    ],
)
def test_what_cannot_be_is_named(log, tmp_path, settings, message):
    robot = tmp_path / "robot.xml"
    robot.write_text(rooms.structure(2))
    with pytest.raises(InputError, match=message):
        slam.estimate(log, Request(settings, robot=robot))
    with pytest.raises(InputError, match="needs a robot"):
        slam.estimate(log, Request(settings))


def test_an_encoder_that_misses_a_row_goes_on(log):
    """A row of the joints that is no number is refused unless told to be missing; those that follow are read."""
    value = np.array(log.streams["joints"].value)
    value[5, 0] = np.nan
    spoiled = SensorLog(log.streams | {"joints": log.streams["joints"]._replace(value=value)})
    robot = kinematics.load(rooms.structure(2))
    sensors = [s for frame in ("root", "link1", "link2") for s in ring(frame, 0.085, rows=4, columns=4)]
    with pytest.raises(InputError, match=r"stream of joints: row 5 .* is not finite"):
        slam_streams.measurements(spoiled, {}, robot, sensors, "error")
    _, given, _ = slam_streams.measurements(spoiled, {}, robot, sensors, "missing")
    assert given.joints.valid.all()
    np.testing.assert_allclose(np.delete(given.joints.value, 5, 0), np.delete(value, 5, 0), atol=1e-6)


def found(**fields):
    """A run of two steps of a robot with a slide and a hinge, whose figures are fine unless said otherwise."""
    whole = {
        "joints": [[0.2, 0.5]] * 2, "bias": [[0.05, 0.1]] * 2, "bias_deviation": [[0.002, 0.01]] * 2,
        "position": np.zeros((2, 2, 3)), "quaternion": np.tile([1.0, 0, 0, 0], (2, 2, 1)),
        "inliers": [[20], [20]], "seen": [[40], [40]], "voxels": [100, 200], "overflow": [0, 0], "status": [0, 0],
        "link_status": [[6, 0]] * 2,
    }  # fmt: skip
    return SimpleNamespace(**{name: np.asarray(value) for name, value in (whole | fields).items()})


@pytest.fixture(scope="module")
def lift():
    return kinematics.load(
        '<mujoco><worldbody><body name="base"><joint name="lift" type="slide"/><geom size=".1"/><body name="arm">'
        '<joint name="turn"/><geom size=".1"/></body></body></worldbody></mujoco>'
    )


def test_slides_are_told_in_metres_and_hinges_in_radians(lift):
    joints, info, time = slam_streams.encoded(lift), found(), np.arange(2.0)
    rows = slam_figures.rows(time, joints, info, lift)
    assert Row("bias at the end", "lift", 50.0, "mm", 2.0, 2) in rows
    assert ("turn", "deg") in [(row.condition, row.unit) for row in rows if row.metric == "bias at the end"]
    streams = slam_figures.streams(time, joints, info, lift)
    for name, unit, joint, column in (("slides", "m", "lift", 0), ("joints", "rad", "turn", 1)):
        for part, value in (("", info.joints), ("_bias", info.bias), ("_deviation", info.bias_deviation)):
            item = streams[name + part]
            assert (item.unit, item.names) == (unit, (joint,))
            np.testing.assert_array_equal(item.value[:, 0], value[:, column])


def test_turns_are_those_of_sensors_that_there_are():
    """Eight on one link and one on another, all turned alike: so is their mean."""
    robot = kinematics.load(rooms.structure(1))
    placed = [*ring("root", 0.085), *ring("link1", 0.085, count=1)]
    turn = np.zeros((2, 8, 3))
    turn[0, :, 0] = turn[1, 0, 0] = 0.05
    rows = slam_figures.turns(SimpleNamespace(ring=np.zeros((2, 3)), turn=turn), placed, robot)
    np.testing.assert_allclose([row.value for row in rows], np.rad2deg(0.05))


def test_an_imus_samples_belong_to_the_scan_that_follows():
    """100 Hz beside scans at 10: ten samples each, none before the first scan, and a missing value is told."""
    scans, time = 0.1 * np.arange(1, 5), 0.01 * np.arange(1, 60)
    value = np.tile(time[:, None], 3)
    value[22] = np.nan
    log = SensorLog({
        "ranges": Stream(scans, np.ones((4, 2)), "m"),
        "gyroscope": Stream(time, value, "rad/s"),
        "accelerometer": Stream(time, np.ones((59, 3)), "m/s^2"),
    })  # fmt: skip
    given = driven(log, {}, Free(None, None, None, None, np.full(4, 0.1)))
    assert given.gyroscope.value.shape == (4, 10, 3)
    assert np.all(given.spacing[0] == 0)
    np.testing.assert_allclose(given.spacing[1:].sum(1), 0.1, atol=1e-6)
    np.testing.assert_allclose(given.gyroscope.value[1, :, 0], time[10:20], atol=1e-6)
    assert (~given.gyroscope.valid).sum() == 1
    assert not given.gyroscope.valid[2, 2]
    with pytest.raises(InputError, match="expected three"):
        driven(log, {"gyroscope_stream": "ranges"}, Free(None, None, None, None, np.full(4, 0.1)))
    later = SensorLog(log.streams | {"accelerometer": log.streams["accelerometer"]._replace(time=time + 1000)})
    with pytest.raises(InputError, match=r"'accelerometer': covers 1000.010 to .* within the ranges' 0.100 to 0.400 s"):
        driven(later, {}, Free(None, None, None, None, np.full(4, 0.1)))


@pytest.mark.parametrize(
    ("gap", "blind"),
    [
        ((0.204, 0.714), [3, 4, 5, 6, 7, 8]),  # between two scans as a whole, and into a later one
        ((0.25, 0.28), [3]),  # within one
        ((-1.0, 0.55), [2, 3, 4, 5, 6]),  # before it begins
        ((0.96, 2.0), [10, 11]),  # after it has ended
        ((0.254, 0.264), []),  # one sample lost is none
    ],
)
@pytest.mark.parametrize("lacking", ["both", "accelerometer"])
def test_an_imus_gap_is_not_bridged(gap, blind, lacking):
    """No sample stands for what was before it, and no scan is led to by samples of a part of the way."""
    scans, time = 0.1 * np.arange(1, 12), 0.01 * np.arange(1, 111)
    rest = time[(time <= gap[0]) | (time >= gap[1])]
    gyroscope = rest if lacking == "both" else time
    log = SensorLog({
        "ranges": Stream(scans, np.ones((11, 2)), "m"),
        "gyroscope": Stream(gyroscope, np.zeros((len(gyroscope), 3)), "rad/s"),
        "accelerometer": Stream(rest, np.ones((len(rest), 3)), "m/s^2"),
    })  # fmt: skip
    given = driven(log, {}, Free(None, None, None, None, np.full(11, 0.1)))
    there = given.gyroscope.valid & given.accelerometer.valid
    whole = np.all(there | (given.spacing <= 0), axis=1) & np.any(given.spacing > 0, axis=1)
    np.testing.assert_array_equal(1 + np.flatnonzero(~whole), [1, *blind])
    np.testing.assert_allclose(given.spacing[whole].sum(1), 0.1, atol=1.1e-2)


UNIX = 1.7e9 + 0.1 * np.arange(1, 7)
ONE = ring("root", 0.085, count=1, rows=2, columns=2)


@pytest.mark.parametrize(
    ("odometry", "settings", "free", "message"),
    [
        ({}, {"travel_stream": "odmo"}, True, "stream 'odmo' does not exist; did you mean 'odom'"),
        ({}, {"travel_stream": "odom"}, False, r"\[slam\] travel_stream: is 'odom' .*the robot's root is fixed"),
        ({}, {"turn_stream": "odom", "imu": "root"}, True, r"\[slam\] turn_stream: .*the IMU 'root' tells how"),
        ({}, {"gyroscope_stream": "odom"}, True, r"\[slam\] gyroscope_stream: .*no imu = "),
        ({"time": UNIX - 3600}, {}, True, "stream 'travel': 6 rows from 1699996400.100 .* expected one at each"),
        ({"time": UNIX[:5], "value": np.ones((5, 3))}, {}, True, "stream 'travel': 5 rows .* the ranges' 6 times"),
        ({"value": np.ones(6)}, {}, True, r"stream 'travel': got shape \(6,\), expected \(6, 3\)"),
        ({"value": np.ones((6, 1))}, {}, True, r"stream 'travel': got shape \(6, 1\), expected \(6, 3\)"),
    ],
)
def test_streams_that_would_not_be_used_are_named(odometry, settings, free, message):
    """Nothing that a config or a log holds is dropped without a word."""
    robot = kinematics.load(rooms.structure(1, free=free))
    still = Stream(UNIX, np.full((6, 3), 0.01), "m")
    streams = {
        "ranges": Stream(UNIX, np.ones((6, 4)), "m"), "joints": Stream(UNIX, np.full((6, 1), 0.2), "rad"),
        "travel": still, "odom": still,
    }  # fmt: skip
    if free and not settings:
        _, given, _ = slam_streams.measurements(SensorLog(streams), {}, robot, ONE, "error")
        assert given.travel.valid.all()
        assert not given.turn.valid.any()
    with pytest.raises(InputError, match=message):
        wrong = streams | {"travel": still._replace(**odometry)}
        slam_streams.measurements(SensorLog(wrong), settings, robot, ONE, "error")


@pytest.mark.parametrize(
    ("name", "changed", "message"),
    [
        ("ranges", {"value": np.full((6, 4), 1500.0)}, "none of 24 values is within .* 24 beyond, 0 are .* in m"),
        ("ranges", {"value": np.full((6, 4), np.nan)}, "none of 24 values is within .* 0 beyond, 24 are no number"),
        ("joints", {"time": UNIX + 1000}, "stream of joints: covers 1700001000.1.* at any of the ranges' times"),
    ],
)
def test_a_log_of_which_nothing_can_be_used_is_refused(name, changed, message):
    robot = kinematics.load(rooms.structure(1))
    streams = {
        "ranges": Stream(UNIX, np.ones((6, 4)), "m"), "joints": Stream(UNIX, np.full((6, 1), 0.2), "rad"),
    }  # fmt: skip
    with pytest.raises(InputError, match=message):
        slam_streams.measurements(
            SensorLog(streams | {name: streams[name]._replace(**changed)}), {}, robot, ONE, "error"
        )


def test_what_a_run_did_not_use_is_told_and_too_much_of_it_refused(lift):
    """FULL, NON_FINITE and OUT_OF_RANGE steps, links that only follow, points that fit nothing or find no room."""
    assert slam_figures.refused(found(), 400) == []
    none, full = found(inliers=np.zeros((2, 1))), found(overflow=[20, 100], status=[7, 7])
    assert slam_figures.refused(none, 400) == ["no point fitted the map, so that nothing was learned"]
    assert slam_figures.refused(full, 400)[0].startswith("25 % of the points found no room in the map")
    assert not slam_figures.refused(full, 4000)
    assert slam_figures.refused(found(status=[0, 4]), 400) == ["numbers outgrew the precision in 50 % of the steps"]
    fared = [[UNSEEN, FOLLOWS], [UNSEEN, LOST]]
    info, time = found(status=[1, 7], link_status=fared), np.arange(2.0)
    joints, driven = slam_streams.encoded(lift), np.array([False, True])
    rows = {(row.metric, row.condition): row.value for row in slam_figures.rows(time, joints, info, lift, driven)}
    assert rows["steps flagged", "map full"] == rows["steps flagged", "not finite"] == 50
    assert rows["steps, link kept its prediction", "arm"] == rows["steps, link lost", "arm"] == 50
    assert rows["steps that the IMU drove", ""] == 100
    streams = slam_figures.streams(time, joints, info, lift, driven)
    np.testing.assert_array_equal(streams["status"].value, [1, 7])
    np.testing.assert_array_equal(streams["link_status"].value, info.link_status)
    np.testing.assert_array_equal(streams["driven"].value, driven)
