"""`jaxest estimate --method posture`: a person's arm and a hand from logs, and what may be wrong with a config."""

import json
import re
import tomllib

import jax
import numpy as np
import pytest

from jaxest import kinematics, models
from jaxest.cli.methods import Request
from jaxest.cli.methods import posture as cli
from jaxest.io import SensorLog, Stream, read, write
from jaxest.simulate import grasp
from jaxest.systems import posture
from jaxest.types import InputError

SITES = ("imu_trunk", "imu_upper_arm", "imu_forearm", "imu_hand")
HZ, STEPS = 40.0, 200


def logged(robot, sites, key):
    """A log of a robot that moves, with its hinges, and these names."""
    system = posture.build(robot, [f"site:{name}" for name in sites], magnetic=True)
    params = jax.tree.map(np.float32, system.default_params)
    draw = jax.jit(lambda key: system.simulate(params, key=key, steps=STEPS, rate_hz=HZ))
    measurements, truth = draw(jax.random.key(key))
    time = np.arange(STEPS) / HZ
    streams = {}
    units = {"gyroscope": "rad/s", "accelerometer": "m/s2", "magnetometer": "T"}
    for kind, unit in units.items():
        value = np.asarray(getattr(measurements, kind).value, float)
        streams |= {f"{name}/{kind}": Stream(time, value[:, k], unit) for k, name in enumerate(sites)}
    names = robot.joint_names[1:]
    streams["joints"] = Stream(time, np.asarray(truth.q, float)[:, 4:], "rad", names=names)
    return SensorLog(streams), names


@pytest.fixture(scope="module")
def arm():
    return logged(kinematics.load(models.path("human_arm")), SITES, 4)


def followed(invoke, log, names, model, tmp_path, config=""):
    """Run the command on a log; errors in degrees by joint, those of the last two thirds, and in deviations."""
    write(log, tmp_path / "log.npz")
    (tmp_path / "c.toml").write_text("[posture]\nmagnetometer = true\n" + config)
    words = ("estimate", "log.npz", "-m", "posture", "--robot", models.path(model), "-c", "c.toml", "-o", "out")
    said = invoke(*words, "--json")
    assert said.exit_code == 0, said.output
    found = read(tmp_path / "out" / "estimate.npz").streams
    assert tuple(found["joints"].names) == names
    error = np.asarray(found["joints"].value) - np.asarray(log.streams["joints"].value)
    spread = np.sqrt(np.diagonal(np.asarray(found["joints_covariance"].value), axis1=1, axis2=2))
    told = {row["condition"]: row["value"] for row in json.loads(said.stdout)["rows"] if "RMS" in row["metric"]}
    for name, size in zip(names, np.sqrt(np.mean(error**2, axis=0)), strict=True):
        assert told[name] == pytest.approx(np.rad2deg(size), rel=0.05)
    late = slice(STEPS // 3, None)
    return np.sqrt(np.mean(np.rad2deg(error[late]) ** 2, axis=0)), np.abs(error[late] / spread[late]).max(), said


def test_an_arm_is_followed(invoke, arm, tmp_path):
    """From nothing, in 5 s. Where two of the three hinges of a shoulder turn alike, both are hardly known."""
    size, sigmas, _ = followed(invoke, *arm, "human_arm", tmp_path)
    assert size[3:].max() < 2
    assert size[:3].max() < 10
    assert sigmas < 4


@pytest.mark.slow
def test_a_hand_is_followed(invoke, tmp_path):
    """The gripper: two fingers of three joints each with a coupled one, seven IMUs."""
    sites = tuple(name.removeprefix("site:") for name in grasp.SITES)
    robot = kinematics.load(models.path("gripper"))
    size, sigmas, said = followed(invoke, *logged(robot, sites, 5), "gripper", tmp_path)
    assert size.max() < 1
    assert sigmas < 4
    assert "not observed" not in said.output


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ('[posture.imus]\nimu_trunk = "chest"', r"\[posture.imus\] imu_trunk.*'chest'"),
        ('[posture]\nfilter = "efk"', "did you mean 'ekf'"),
        ("[posture]\nzero_posture = [2.0, 1.0]", "expected two times in s"),
        ('[posture]\nzero_posture = ["a", "b"]', "expected two times in s"),
        ("[posture]\nzero_posture = [1.0, 3.0]", "imu_trunk moves in|imu_upper_arm moves in"),
        ('[posture.imus]\nbelt = "trunk"', "belt"),
    ],
)
def test_wrong_configs_are_named(refused, arm, tmp_path, config, message):
    write(arm[0], tmp_path / "log.npz")
    (tmp_path / "c.toml").write_text(config)
    words = ("estimate", "log.npz", "-m", "posture", "--robot", models.path("human_arm"), "-c", "c.toml", "-o", "out")
    said = refused(*words)
    assert re.search(message, said.replace("\n", " ")), said


def test_a_robot_is_needed(refused, arm, tmp_path):
    write(arm[0], tmp_path / "log.npz")
    assert "needs a robot: --robot FILE" in refused("estimate", "log.npz", "-m", "posture", "-o", "out")


def test_what_takes_no_part_is_said(arm):
    """An IMU that sits nowhere and a slide: the estimate says nothing of either."""
    robot = kinematics.load(
        '<mujoco><worldbody><body name="a"><joint name="lift" type="slide"/><geom size=".1"/>'
        '<body name="b"><joint name="turn"/><geom size=".1"/></body></body></worldbody></mujoco>'
    )
    log = SensorLog({f"{name}/gyroscope": arm[0].streams["imu_hand/gyroscope"] for name in ("a", "b", "c")})
    choice = cli.Choice({"a": "a", "b": "b"}, cli.KINDS[:2], "ekf", None, {})
    idle, slides = cli._left_out(log, robot, choice)
    assert "left out: c" in idle
    assert slides == "slides stay at home: lift"
    assert tuple(cli._hinges(robot)) == ("turn",)


def test_imus_without_a_frame_are_answered_with_lines_to_paste(arm):
    """Also where a name holds what TOML wants in quotes."""
    robot = kinematics.load('<mujoco><worldbody><body name="a"><joint/><geom size=".1"/></body></worldbody></mujoco>')
    log = SensorLog({"left/hand/gyroscope": arm[0].streams["imu_hand/gyroscope"]})
    with pytest.raises(InputError) as caught:
        cli.choose(log, robot, Request())
    text = str(caught.value)
    assert tomllib.loads(text[text.index("[posture") :]) == {"posture": {"imus": {"left/hand": "FRAME"}}}


@pytest.mark.parametrize("key", cli.NUMBERS)
@pytest.mark.parametrize("value", [-1.0, 0, float("nan"), float("inf")])
def test_numbers_are_above_zero(key, value):
    robot = kinematics.load('<mujoco><worldbody><body name="a"><joint/><geom size=".1"/></body></worldbody></mujoco>')
    log = SensorLog({f"a/{kind}": Stream(np.zeros(1), np.zeros((1, 3)), "") for kind in cli.KINDS})
    with pytest.raises(InputError, match=rf"\[posture\] {key}: got {value:g}, expected a finite number above 0"):
        cli.choose(log, robot, Request({key: value}))
    assert cli.choose(log, robot, Request({key: 0.5})).numbers == {key: 0.5}
