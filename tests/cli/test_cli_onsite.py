"""`jaxest estimate --method onsite`: two IMUs on a link, a robot of modules, and what may be wrong with configs."""

import json
import tomllib

import jax
import numpy as np
import pytest

from jaxest import kinematics
from jaxest.cli.methods import onsite_config
from jaxest.io import SensorLog, Stream, read, write
from jaxest.simulate import imu, manipulator
from jaxest.systems import onsite
from jaxest.types import InputError

MODULES = """
[onsite]
gyroscope_axes = {off}
accelerometer_axes = {off}

[onsite.modules.joint0]
axis = [0, 0, 1]
place = {{ position = [0, 0, 0.25] }}

[onsite.modules.joint1]
place = {{ position = [0, 0, 0.06] }}
after = {{ imu = "imu0", position = {after[1]}, quaternion = {after[0]} }}

[onsite.modules.joint2]
before = {{ imu = "imu1", position = {before[1]}, quaternion = {before[0]} }}

[onsite.tool]
position = [0.11, 0, 0]
"""


def streams(imus):
    """A log's streams of IMUs (time, rates, forces) by name."""
    found = {}
    for name, (time, rates, forces) in imus.items():
        found[f"{name}/gyroscope"] = Stream(np.asarray(time, float), np.asarray(rates), "rad/s")
        found[f"{name}/accelerometer"] = Stream(np.asarray(time, float), np.asarray(forces), "m/s2")
    return SensorLog(found)


@pytest.fixture(scope="module")
def rod():
    params = jax.tree.map(np.float32, onsite.build().default_params)
    m, truth = jax.jit(lambda key: onsite.simulate(params, key=key, steps=1000))(jax.random.key(2))
    time = np.arange(1000) / 100
    imus = {name: (time, *(getattr(m, f"{kind}_{side}").value for kind in ("gyroscope", "accelerometer")))
            for name, side in (("left", "a"), ("right", "p"))}  # fmt: skip
    return imus, jax.tree.map(np.asarray, truth)


def test_two_imus(invoke, rod, tmp_path):
    imus, truth = rod
    write(streams(imus), tmp_path / "log.npz")
    place, turn = ([float(x) for x in v] for v in (truth.position, truth.quaternion))
    (tmp_path / "c.toml").write_text(f"[onsite]\nposition = {place}\nquaternion = {turn}\n")
    result = invoke("estimate", "log.npz", "-m", "onsite", "-c", "c.toml", "-o", "out", "--json")
    assert result.exit_code == 0, result.output
    rows = {(r["metric"], r["condition"]): r["value"] for r in json.loads(result.stdout)["rows"]}
    assert rows["position error", "to the config's"] < 2
    assert rows["rotation error", "to the config's"] < 0.2
    found = read(tmp_path / "out" / "estimate.npz").streams
    np.testing.assert_allclose(found["position"].value[0], truth.position, atol=2e-3)
    assert found["position"].frame == "left"
    assert found["pose_covariance"].value.shape == (1, 6, 6)
    np.testing.assert_allclose(found["live/position"].value[-1], truth.position, atol=3e-3)
    assert np.isnan(found["live/position"].value[0]).all()


@pytest.mark.slow
def test_forgetting_is_tuned_and_said_to_be_unknown_of_a_rigid_link(invoke, rod, tmp_path):
    write(streams(rod[0]), tmp_path / "log.npz")
    result = invoke("tune", "log.npz", "-m", "onsite", "--starts", 1, "-o", "tuned.toml", "--json")
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["unidentified"] == ["forgetting_rotation", "forgetting_position"]
    rows = {row["metric"]: row for row in report["rows"] if row["condition"].startswith("free")}
    for name, drawn in (("gyroscope_noise", 0.01), ("force_noise", 0.071)):
        # The force's noise has a little of the derivatives' in it.
        assert abs(rows[name]["value"] - drawn) < 3 * rows[name]["spread"] + 0.05 * drawn
    tuned = tomllib.loads((tmp_path / "tuned.toml").read_text())["onsite"]
    assert set(tuned) == {"window", *rows}
    (tmp_path / "tuned.toml").write_text("[onsite]\nforgetting_position = 1.2\n")
    assert "forgetting_position: got 1.2" in invoke("estimate", "log.npz", "-m", "onsite", "-c", "tuned.toml",
                                                    "-o", "out").stderr  # fmt: skip


def test_what_tuning_does_not_look_at_is_refused(refused, rod, tmp_path):
    write(streams(rod[0]), tmp_path / "log.npz")
    words = ("tune", "log.npz", "-m", "onsite", "-o", "tuned.toml")
    assert "the method 'onsite' knows no robot" in refused(*words, "--robot", "arm.xml")
    assert "knows no truth; leave it out" in refused(*words, "--truth", "log.npz")


def test_which_two_of_three(refused, rod, tmp_path):
    imus, _ = rod
    write(streams({**imus, "third": imus["left"]}), tmp_path / "log.npz")
    message = refused("estimate", "log.npz", "-m", "onsite", "-o", "out")
    assert "left, right, third; say which two in a config" in message.replace("\n", " ")
    (tmp_path / "c.toml").write_text('[onsite]\nfirst = "left"\nsecond = "rihgt"\n')
    assert "'right/gyroscope'" in refused("estimate", "log.npz", "-m", "onsite", "-c", "c.toml", "-o", "out")


def test_a_robot_of_modules(invoke, tmp_path):
    sticks = manipulator.draw(1)
    recorded = manipulator.swing(sticks, 1, seconds=16.0, sensor=imu.perfect())
    imus = {f"imu{e}": tuple(part[0][e] for part in recorded[:3]) for e in (0, 1)}
    write(streams(imus), tmp_path / "log.npz")
    modules = sticks.assembly.modules
    mountings = {side: [[float(x) for x in v] for v in pose]
                 for side, pose in (("after", modules[1].after), ("before", modules[2].before))}  # fmt: skip
    (tmp_path / "c.toml").write_text(MODULES.format(off=0.0, **mountings))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "robot.xml").write_text("<mujoco/>")
    kept = invoke("estimate", "log.npz", "-m", "onsite", "-c", "c.toml", "-o", "mine")
    assert kept.exit_code == 2
    assert "robot.xml exists already and is kept" in kept.stderr
    assert [f.name for f in (tmp_path / "mine").iterdir()] == ["robot.xml"]
    result = invoke("estimate", "log.npz", "-m", "onsite", "-c", "c.toml", "-o", "out", "--json")
    assert result.exit_code == 0, result.output
    found = read(tmp_path / "out" / "estimate.npz").streams
    np.testing.assert_allclose(found["joint2/position"].value[-1], sticks.links[0].translation, atol=2e-3)
    for name in ("robot.xml", "robot.urdf"):
        robot = kinematics.load(tmp_path / "out" / name)
        assert robot.joint_names == ("joint0", "joint1", "joint2")
        place = kinematics.forward(robot, np.zeros(3), ["joint2_horn"]).position[0]
        np.testing.assert_allclose(place, np.add(sticks.links[0].translation, [0, 0, 0.31]), atol=2e-3)

    # The same from gyros whose axes nobody knows better than to 1 %: the stop must not claim 0.1 deg.
    (tmp_path / "c.toml").write_text(MODULES.format(off=0.01, **mountings))
    result = invoke("estimate", "log.npz", "-m", "onsite", "-c", "c.toml", "-o", "loose")
    assert result.exit_code == 3
    assert "axes are off by 1 % leave 1.98 deg however long they swing" in " ".join(result.output.split())


def test_configs_that_make_no_robot():
    plain = {"modules": {"a": {"axis": [0, 0]}}}
    with pytest.raises(InputError, match=r"\[onsite.modules.a\] axis: got \[0, 0\], expected 3 numbers"):
        onsite_config.modules(plain)
    with pytest.raises(InputError, match="quaternion of length 2, expected 1"):
        onsite_config.modules({"modules": {"a": {"before": {"quaternion": [2, 0, 0, 0]}}}})
    with pytest.raises(InputError, match="every module has a `place`"):
        onsite_config.modules({"modules": {"a": {}}})


def test_axes_that_cannot_be(refused, rod, tmp_path):
    write(streams(rod[0]), tmp_path / "log.npz")
    (tmp_path / "c.toml").write_text("[onsite]\ngyroscope_axes = -0.1\n")
    message = refused("estimate", "log.npz", "-m", "onsite", "-c", "c.toml", "-o", "out")
    assert "[onsite] gyroscope_axes: got -0.1, expected a number of 0 or more" in message.replace("\n", " ")


def test_what_a_config_says_is_used_or_refused():
    """A tape measure knows the position alone: no rotation is made up beside it."""
    true = onsite_config.truth({"position": [0.1, 0, 0]})
    assert true.quaternion is None
    assert true.position.tolist() == [0.1, 0, 0]
    assert onsite_config.truth({"quaternion": [0, 1, 0, 0]}).position is None
    assert onsite_config.truth({}) == (None, None)
    with pytest.raises(InputError, match=r"\[onsite\] clocks: is of two IMUs"):
        onsite_config.refuse_idle({"modules": {}, "clocks": True})
    with pytest.raises(InputError, match=r"\[onsite\] tool: is of a robot"):
        onsite_config.refuse_idle({"first": "a", "tool": {}})
    onsite_config.refuse_idle({"first": "a", "second": "b", "modules": {}})  # what `inspect` prints for a pair


def test_inspect_proposes_a_first_config(invoke, rod, tmp_path):
    imus, _ = rod
    write(streams(imus), tmp_path / "log.npz")
    shown = json.loads(invoke("inspect", "log.npz", "--json").stdout)["config"]
    assert '[onsite]  # two IMUs on one rigid link\nfirst = "left"\nsecond = "right"\n' in shown
    three = onsite_config.of_log(["a", "b", "c"])
    assert "# [onsite.modules.joint1]" in three
    assert onsite_config.of_log(["a"]) == ""


@pytest.mark.recorded
@pytest.mark.slow
def test_the_recorded_rod(invoke, shared, tmp_path):
    """Through a [columns] table, all defaults: 6 mm and 1.8 deg."""
    file = shared / "recordings" / "two_imus_200mm" / "twoimus_200mm_sample.npz"
    config = json.loads(invoke("inspect", file, "--json").stdout)["config"]
    known = "position = [-0.2, 0, 0]\nquaternion = [1, 0, 0, 0]\n"
    (tmp_path / "c.toml").write_text(config.replace('second = "imu1"\n', 'second = "imu1"\n' + known))
    result = invoke("estimate", file, "-m", "onsite", "-c", "c.toml", "-o", "out", "--json")
    assert result.exit_code == 0, result.output
    rows = {(r["metric"], r["condition"]): r["value"] for r in json.loads(result.stdout)["rows"]}
    assert rows["position error", "to the config's"] < 6
    assert rows["rotation error", "to the config's"] < 1.8
