"""Moving pictures and Rerun recordings, written by the functions and by `jaxest show`."""

import numpy as np
import pytest
from typer.testing import CliRunner

from jaxest import kinematics, models
from jaxest.cli.app import app
from jaxest.cli.show import configurations
from jaxest.io import SensorLog, Stream, write
from jaxest.types import InputError
from jaxest.viz import animation, recording

Image = pytest.importorskip("PIL.Image")
ARM = models.path("arm")
NAMES = ("yaw", "shoulder", "elbow", "gripper")
SIZE = (160, 120)


def motion(n=6):
    q = np.tile([0.0, 0.6, 0.8, -0.3], (n, 1))
    q[:, 0] = np.linspace(-0.5, 0.5, n)
    return q


def rendered(*args, **options):
    try:
        return list(animation.frames(*args, **options))
    except InputError as error:
        if "MuJoCo cannot render here" in str(error):
            pytest.skip(f"no way to render on this machine: {error}")
        raise


def test_a_robot_moves_and_a_second_one_is_seen_through_it():
    q = motion(2)
    alone = rendered(ARM, q, None, SIZE)
    both = rendered(ARM, q, np.add(q, [0, 0.3, 0, 0]), SIZE)
    assert alone[0].shape == (120, 160, 3)
    assert np.mean(alone[0] != alone[1]) > 0.01
    assert np.mean(alone[0] != both[0]) > 0.005
    red = both[0].astype(int)
    assert (red[..., 0] - red[..., 1]).max() > 40
    assert alone[0][0, 0].min() > 200  # a bright sky


def test_a_robot_without_shapes_is_drawn_as_sticks():
    text = """<robot name="bare"><link name="a"/><link name="b"/><link name="c"/><joint name="j" type="continuous">
    <parent link="a"/><child link="b"/><axis xyz="0 1 0"/></joint><joint name="k" type="continuous"><parent link="b"/>
    <child link="c"/><origin xyz="0 0 .4"/><axis xyz="0 1 0"/></joint></robot>"""
    (picture,) = rendered(text, np.zeros((1, 2)), None, SIZE)
    assert np.ptp(picture.astype(int), axis=(0, 1)).max() > 40
    assert picture[0, 0].min() > 200  # a bright sky


def test_shapes_that_are_all_for_collisions_are_drawn():
    """MuJoCo does not draw their group; a robot that has nothing else would be an empty picture."""
    text = """<mujoco><worldbody><body><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".05"
    group="3"/>EYE</body></worldbody></mujoco>"""
    eye = '<geom type="box" size=".02 .02 .02" pos="0 0 .2"/>'
    alone, hidden = (rendered(text.replace("EYE", x), np.zeros((1, 1)), None, SIZE)[0] for x in ("", eye))
    far = [np.abs(picture.astype(int) - picture[0, 0]).max(axis=2) > 40 for picture in (alone, hidden)]
    assert far[0].mean() > 0.02
    assert 0 < far[1].mean() < far[0].mean()


def test_visual_shapes_of_a_urdf_are_drawn():
    """As robots come: a declared encoding, shapes that are for the eye only, which MuJoCo leaves out by default."""
    shape = '<visual><geometry><box size="0.05 0.05 0.05"/></geometry></visual>'
    text = """<?xml version="1.0" encoding="utf-8"?>
    <robot name="eye"><link name="a"/><link name="b">SHAPE</link><joint name="j" type="continuous">
    <parent link="a"/><child link="b"/><axis xyz="0 1 0"/></joint></robot>"""
    with_shape, bare = (rendered(text.replace("SHAPE", x), np.zeros((1, 1)), None, SIZE)[0] for x in (shape, ""))
    assert with_shape[0, 0].min() > 200
    assert np.mean(with_shape != bare) > 0.01


def test_a_urdf_in_a_file_keeps_its_visual_shapes(tmp_path):
    path = tmp_path / "eye.urdf"
    path.write_text("""<?xml version="1.0"?><robot name="eye"><link name="a"/><link name="b"><visual><geometry>
    <sphere radius="0.2"/></geometry></visual></link><joint name="j" type="continuous"><parent link="a"/>
    <child link="b"/></joint></robot>""")
    assert animation._visible(path).ngeom == 1


def test_files_are_written_once(tmp_path):
    rendered(ARM, motion(1), None, SIZE)
    path = tmp_path / "arm.gif"
    animation.draw(path, ARM, motion(), size=SIZE)
    with Image.open(path) as picture:
        assert (picture.n_frames, picture.size) == (6, SIZE)
    with pytest.raises(InputError, match="exists already"):
        animation.draw(path, ARM, motion(), size=SIZE)
    with pytest.raises(InputError, match=r"expected a name that ends in \.gif"):
        animation.draw(tmp_path / "arm.mp4", ARM, motion())
    with pytest.raises(InputError, match="3 coordinates, expected 4"):
        animation.draw(tmp_path / "other.gif", ARM, motion()[:, :3])


@pytest.fixture
def estimated(tmp_path):
    """An estimate's folder and a log with encoders."""
    q, time = motion(), np.arange(6) / 10
    covariance = np.tile(np.diag([1e-4, 1e-4, 1e-4, 1e-4]), (6, 1, 1))
    (tmp_path / "out").mkdir()
    joints = Stream(time, q, "rad", names=NAMES)
    write(SensorLog({"joints": joints, "joints_covariance": Stream(time, covariance, "rad2", names=NAMES)}),
          tmp_path / "out" / "estimate.npz")  # fmt: skip
    write(SensorLog({"encoders": joints._replace(value=q + 0.1)}), tmp_path / "log.npz")
    return tmp_path


def show(folder, *words, what="out"):
    return CliRunner().invoke(app, ["show", str(folder / what), "--robot", str(ARM), *map(str, words)])


def test_show_renders_an_estimate(estimated):
    rendered(ARM, motion(1), None, SIZE)
    result = show(estimated, "-o", estimated / "a.png", "--beside", f"{estimated / 'log.npz'}:encoders")
    assert result.exit_code == 0, result.output
    with Image.open(estimated / "a.png") as picture:
        assert picture.size == (480, 360)


def test_a_stream_is_named_behind_its_log(estimated, monkeypatch):
    drawn = {}
    monkeypatch.setattr(animation, "draw", lambda out, robot, q, **options: drawn.update(q=q, **options))
    both = {key: Stream(np.arange(6) / 10, motion() + more, "rad", names=NAMES) for key, more in (("a", 0), ("b", 1))}
    write(SensorLog(both), estimated / "two.npz")
    where = f"{estimated / 'two.npz'}:a"
    assert show(estimated, "-o", estimated / "a.gif", "--beside", where, what="two.npz:b").exit_code == 0
    np.testing.assert_allclose(drawn["q"], drawn["beside"] + 1)
    result = show(estimated, "-o", estimated / "a.gif", what="two.npz")
    assert result.exit_code == 2
    assert "2 streams of joint angles: a, b; expected one" in result.output


def test_a_free_root_is_where_its_body_was_found_and_a_slide_where_it_went():
    robot = kinematics.load(
        '<mujoco><worldbody><body name="rover"><freejoint name="root"/><geom size=".1"/><body name="arm">'
        '<joint name="turn"/><geom size=".1"/><body name="rod"><joint name="lift" type="slide"/><geom size=".1"/>'
        "</body></body></body></worldbody></mujoco>"
    )
    time, turned = np.arange(3) / 10, np.tile([0.8, 0, 0, 0.6], (3, 1))
    joints = Stream(time, np.full((3, 1), 0.2), "rad", names=("turn",))
    place = Stream(time, np.array([[1.0, 2, 3], [2, 3, 4], [4, 5, 6]]), "m")
    slides = Stream(time, np.array([[0.1], [0.2], [0.3]]), "m", names=("lift",))
    found = configurations(
        robot,
        SensorLog({
            "joints": joints, "slides": slides, "rover/position": place, "rover/orientation": Stream(time, turned, "1")
        }),
        joints,
        np.array([0, 2]),
    )  # fmt: skip
    np.testing.assert_allclose(found, [[1, 2, 3, 0.8, 0, 0, 0.6, 0.2, 0.1], [4, 5, 6, 0.8, 0, 0, 0.6, 0.2, 0.3]])


def test_degrees_of_a_log_are_drawn_as_degrees(estimated, monkeypatch):
    drawn = {}
    monkeypatch.setattr(animation, "draw", lambda out, robot, q, **options: drawn.update(q=q, **options))
    item = Stream(np.arange(6) / 10, np.rad2deg(motion()), "deg", names=NAMES)
    write(SensorLog({"joint_position": item}), estimated / "deg.npz")
    where = f"{estimated / 'deg.npz'}:joint_position"
    assert show(estimated, "-o", estimated / "a.gif", "--beside", where, what="deg.npz").exit_code == 0
    np.testing.assert_allclose(drawn["q"][[0, -1]], motion()[[0, -1]], atol=1e-6)
    np.testing.assert_allclose(drawn["beside"][[0, -1]], motion()[[0, -1]], atol=1e-6)


def test_a_posture_that_is_not_known_is_the_last_that_was(estimated, monkeypatch):
    drawn, q = {}, motion()
    monkeypatch.setattr(animation, "draw", lambda out, robot, q, **options: drawn.update(q=q))
    q[[0, 3, 4]], q[:, 3] = np.nan, np.nan
    write(SensorLog({"joints": Stream(np.arange(6) / 10, q, "rad", names=NAMES)}), estimated / "holes.npz")
    result = show(estimated, "-o", estimated / "a.gif", what="holes.npz")
    assert "6 of 6 postures lack a joint; it stays where it was known last" in result.output
    np.testing.assert_allclose(drawn["q"][:, :3], motion()[[1, 1, 2, 2, 2, 5], :3])
    np.testing.assert_allclose(drawn["q"][:, 3], kinematics.load(ARM).home[3], rtol=1e-6)


def test_a_second_robot_of_another_clock_is_refused(estimated):
    item = Stream(100 + np.arange(6) / 10, motion(), "rad", names=NAMES)
    write(SensorLog({"encoders": item}), estimated / "late.npz")
    result = show(estimated, "-o", estimated / "a.gif", "--beside", estimated / "late.npz")
    assert result.exit_code == 2
    assert "covers 100.000 to 100.500 s, the estimate 0.000 to 0.500 s; expected times in" in result.output


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("-o", "a.mp4"), "ends in .gif, .png or .rrd"),
        (("-o", "a.gif", "--beside", "none.npz"), "no such file"),
        (("-o", "a.rrd", "--frame", "site:tip"), "'site:tip' does not exist"),
    ],
)
def test_what_cannot_be_shown_is_told(estimated, words, part, monkeypatch):
    monkeypatch.chdir(estimated)
    if words[1].endswith("rrd"):
        pytest.importorskip("rerun")
    result = show(estimated, *words)
    assert result.exit_code == 2
    assert part in result.output


def test_a_recording_for_rerun(estimated):
    pytest.importorskip("rerun")
    robot = kinematics.load(ARM)
    path = estimated / "arm.rrd"
    assert show(estimated, "-o", path, "--frame", "site:end_effector").exit_code == 0
    assert path.read_bytes()[:4] == b"RRF2"
    full = estimated / "full.rrd"
    cloud = np.random.default_rng(0).normal(size=(2000, 3))
    recording.write(full, robot, np.arange(6) / 10, motion(), beside=motion(), points=cloud,
                    particles=np.tile(motion()[:, None], (1, 500, 1)))  # fmt: skip
    assert full.stat().st_size > 2000 * 12


def test_ellipsoids_are_those_of_the_jacobian():
    robot = kinematics.load(ARM)
    q, covariance = motion(2), np.tile(np.diag([1e-4, 4e-4, 1e-4, 1e-4]), (2, 1, 1))
    half, turned = recording._ellipsoids(robot, ("site:end_effector",), q, covariance)
    rows = np.asarray(kinematics.jacobian(robot, q[0], "site:end_effector"))[3:]
    w = turned[0, 0, [3, 0, 1, 2]]
    from jaxest.manifolds import quaternion

    axes = np.asarray(quaternion.to_matrix(w))
    found = axes @ np.diag((half[0, 0] / recording.SIGMAS) ** 2) @ axes.T
    np.testing.assert_allclose(found, rows @ covariance[0] @ rows.T, atol=1e-8)
