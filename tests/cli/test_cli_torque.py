"""`jaxest estimate --method torque`: a pendulum's torque from its angle, pieces of a run, and what may be wrong."""

import json

import jax
import numpy as np
import pytest

from jaxest import kinematics
from jaxest.cli.methods import torque_series
from jaxest.io import SensorLog, Stream, read, write
from jaxest.systems import torque
from jaxest.types import InputError

PENDULUM = """<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 1 0"/><geom type="capsule"
fromto="0 0 0 0 0 -.5" size=".02" mass="1"/></body></worldbody></mujoco>"""
BARE = """<robot name="bare"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>
<child link="b"/><axis xyz="0 1 0"/></joint></robot>"""
TORQUE = 0.8
SHORT = ("[torque]", 'torque = "constant"', "iterations = 60", "rest = true", "velocity_noise = 1e-3")


def log(steps=60):
    with jax.enable_x64(True):
        robot = kinematics.load(PENDULUM)
        given = torque.default_params(robot)
        given = given._replace(mean=np.array([0.5, 0.0, TORQUE]))
        measured, _ = torque.simulate(given, key=jax.random.key(0), steps=steps, dt=0.02)
        angle = np.asarray(measured.joints.value)
    time = 0.02 * np.arange(steps)
    streams = {"q": Stream(time, angle, "rad"), "motor": Stream(time, np.full((steps, 1), TORQUE), "N m")}
    return SensorLog(streams)


@pytest.fixture
def ready(invoke, tmp_path):
    """A log, a robot and a config in the folder where commands run; returns what writes the config."""
    write(log(), tmp_path / "log.npz")
    (tmp_path / "arm.xml").write_text(PENDULUM)

    def config(*lines):
        (tmp_path / "c.toml").write_text("\n".join(lines) + "\n")

    config(*SHORT)
    return config


WORDS = ("estimate", "log.npz", "-m", "torque", "--robot", "arm.xml", "-c", "c.toml")


def test_a_constant_torque_in_pieces(invoke, refused, ready, tmp_path):
    """A run that is stopped and goes on is the run that was never stopped; another sampler's is refused."""
    ready(*SHORT, 'compare = "motor"')
    result = invoke(*WORDS, "--work", "kept", "--json", "-o", "whole")
    assert result.exit_code == 3  # so few draws must not be used, and the command says so
    assert "do not use this estimate: " in result.stderr
    assert "too few effective draws" in result.stderr
    pieces = sorted((tmp_path / "kept").glob("*.npz"))
    assert len(pieces) == 1
    found = read(tmp_path / "whole" / "estimate.npz")
    half = float((found.streams["torque_upper"].value - found.streams["torque_lower"].value)[0, 0]) / 2
    assert abs(float(found.streams["torque"].value[0, 0]) - TORQUE) < 2 * half < 1
    rows = {row["metric"]: row for row in json.loads(result.stdout)["rows"]}
    assert rows["from the logged torque, RMS"]["value"] < 2 * half
    assert (tmp_path / "whole" / "torque.png").stat().st_size > 10_000
    stamp = pieces[0].stat().st_mtime_ns
    again = invoke(*WORDS, "--work", "kept", "-o", "again")
    assert again.exit_code == 3
    assert pieces[0].stat().st_mtime_ns == stamp
    other = read(tmp_path / "again" / "estimate.npz")
    for name, item in found.streams.items():
        np.testing.assert_array_equal(other.streams[name].value, item.value)
    ready(*SHORT, 'sampler = "mh"')
    assert "belongs to a run with other data, settings" in refused(*WORDS, "--work", "kept")


@pytest.mark.slow
def test_noise_is_tuned_and_its_config_can_be_used(invoke, ready, tmp_path):
    write(log(200), tmp_path / "long.npz")
    words = ("long.npz", "-m", "torque", "--robot", "arm.xml", "-c", "c.toml")
    result = invoke("tune", *words, "-o", "tuned.toml", "--json")
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["unidentified"] == ["velocity_noise"]
    rows = {row["metric"]: row for row in report["rows"] if row["condition"].startswith("free")}
    for name in ("position_noise", "sensor_noise"):
        assert abs(rows[name]["value"] - 2e-7**0.5) < 3 * rows[name]["spread"] < 2e-4
    assert invoke("estimate", *words[:-1], "tuned.toml", "-o", "out").exit_code in (0, 3)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('torque = "constent"', "[torque] torque 'constent' does not exist; did you mean 'constant'"),
        ('sampler = "gibs"', "[torque] sampler 'gibs' does not exist; did you mean 'gibbs'"),
        ("iterations = 3", "[torque] iterations: got 3, expected at least 8"),
        ("low = 5.0\nhigh = 2.0", "[torque] low: 5.0 is not below high: 2.0"),
        ("sensor_noise = [1e-3, 1e-3]", "[torque] sensor_noise: got [0.001, 0.001], expected a number, or 1 of them"),
        ("sensor_noise = 0.0", "[torque] sensor_noise: got 0.0, expected a standard deviation above 0"),
        ('angles = "joint"', "'joint' does not exist"),
        ('feedforward = "moter"', "did you mean 'motor'"),
        ("every = 0", "[torque] every: got 0, expected at least 1"),
        ("every = 20", "3 samples, expected at least 8"),
    ],
)
def test_settings_that_cannot_be(refused, ready, line, message):
    ready("[torque]", line)
    assert message in refused(*WORDS)


def test_robots_and_logs_that_cannot_be(refused, ready, tmp_path):
    assert "the method 'torque' needs a robot" in refused("estimate", "log.npz", "-m", "torque")
    (tmp_path / "arm.urdf").write_text(BARE)
    assert "inertia" in refused("estimate", "log.npz", "-m", "torque", "--robot", "arm.urdf")
    whole = log()
    wide = {"q": whole.streams["q"]._replace(value=np.zeros((60, 2)))}
    write(SensorLog(wide), tmp_path / "wide.npz")
    assert "2 columns, expected 1, the robot's joints hinge" in refused("estimate", "wide.npz", *WORDS[2:])
    holes = whole.streams["q"].value.copy()
    holes[7] = np.nan
    write(SensorLog({"q": whole.streams["q"]._replace(value=holes)}), tmp_path / "holes.npz")
    assert "row 7, column 0 is NaN" in refused("estimate", "holes.npz", *WORDS[2:])


def test_a_known_torque_is_not_made_up_where_it_is_not_known():
    """It ends before the angles do, or holds NaN that nobody allowed."""
    time = np.arange(100) / 100
    angles = Stream(time, np.sin(time)[:, None], "rad")

    def taken(nan="error", **known):
        log = SensorLog({"q": angles, "motor": Stream(**known)})
        return torque_series.series(log, {"feedforward": "motor"}, ("hinge",), nan).feedforward

    late = time[:-1] + 0.004  # another clock, half a sample short: its last value is held
    np.testing.assert_allclose(taken(time=late, value=10 * late[:, None])[1:-1, 0], 10 * time[1:-1], atol=1e-9)
    with pytest.raises(InputError, match=r"'motor': covers 0.000 to 0.490 s, the angles 0.000 to 0.990 s"):
        taken(time=time[:50], value=np.zeros((50, 1)))
    holes = np.where(time[:, None] == time[7], np.nan, 10 * time[:, None])
    with pytest.raises(InputError, match=r"row 7 at 0.070000 s is not finite"):
        taken(time=time, value=holes)
    np.testing.assert_allclose(taken("missing", time=time, value=holes)[:, 0], 10 * time, atol=1e-9)
    some = (time < 0.2) | (time > 0.6)
    with pytest.raises(InputError, match=r"'motor': nothing is known between 0.190 and 0.610 s, .* at most 0.025 s"):
        taken(time=time[some], value=np.zeros((some.sum(), 1)))


def test_gaps_are_bridged_up_to_a_length():
    def bridged(pause):
        time = np.concatenate([np.arange(100), pause + np.arange(100)]) / 100
        return torque_series.series(SensorLog({"q": Stream(time, np.zeros((200, 1)), "rad")}), {}, ("j",), "error")

    assert np.diff(bridged(500).time).max() < 0.011
    with pytest.raises(
        InputError, match=r"'q': 199.01 s pass after row 99 at 0.990 s, 0.01 s after most; expected gaps of at most"
    ):
        bridged(20000)


def test_columns_with_names_are_never_taken_by_position():
    time, joints = np.arange(20) / 100, ("shoulder", "elbow")

    def taken(*names):
        item = Stream(time, np.tile([1.0, 2.0], (20, 1)), "rad", names=names)
        return torque_series.series(SensorLog({"q": item}), {}, joints, "error")

    np.testing.assert_array_equal(taken("elbow", "shoulder").angles[0], [2, 1])
    np.testing.assert_array_equal(taken().angles[0], [1, 2])
    with pytest.raises(InputError, match=r"'q': its columns are elbow_joint, shoulder, none of them 'elbow'; expected"):
        taken("elbow_joint", "shoulder")


def test_pieces_are_for_methods_that_have_them(refused, ready):
    message = refused("estimate", "log.npz", "-m", "orientation", "--work", "kept")
    assert "the method 'orientation' keeps no pieces" in message
