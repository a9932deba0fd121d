"""Loading: what is kept, what is left out with a word, and what is refused with a reason."""

import logging

import jax
import mujoco
import numpy as np
import pytest
from robots import PACKAGED, SHARED, source
from scipy.spatial.transform import Rotation

from jaxest import kinematics, models
from jaxest.kinematics.load import compile_model
from jaxest.types import InputError

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


def link(name, inside="", inertial=INERTIAL):
    return f'<link name="{name}">{inertial}{inside}</link>'


def joint(name, parent, child, kind="revolute", inside=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>'
        f'<origin xyz="0 0 1"/><limit lower="-1" upper="2" effort="1" velocity="1"/>{inside}</joint>'
    )


def urdf(*parts):
    return f'<robot name="r">{"".join(parts)}</robot>'


def collision(file):
    return f'<collision><geometry><mesh filename="{file}"/></geometry></collision>'


@pytest.mark.parametrize("name", [*PACKAGED, *(pytest.param(n, marks=pytest.mark.recorded) for n in SHARED)])
def test_every_robot_loads_with_mujocos_order(name, request):
    robot = kinematics.load(source(name, request.getfixturevalue("shared") if name in SHARED else None))
    assert len(set(robot.frame_names)) == len(robot.frame_names)
    assert robot.home.shape == (robot.nq,)
    assert robot.limits.shape == (robot.nq, 2)
    assert (robot.limits[:, 0] < robot.limits[:, 1]).all()
    assert all(parent < body for body, parent in enumerate(robot.topology.body_parent))


@pytest.mark.recorded
def test_absent_meshes_are_left_out_with_one_line(shared, caplog):
    with caplog.at_level(logging.WARNING, "jaxest"):
        robot = kinematics.load(shared / "robots" / "panda.xml")
    assert robot.notes == ("58 mesh files absent, geometry left out (first: meshes/link0.stl)",)
    assert robot.notes[0] in caplog.text
    assert (robot.body_mass[1:8] > 0.5).all()


@pytest.mark.recorded
def test_a_hand_without_inertias_has_kinematics_only(shared):
    robot = kinematics.load(shared / "robots" / "inspire_left_hand.xml")
    assert len(robot.topology.massless) > 10
    assert np.isfinite(kinematics.forward(robot, robot.home).position).all()
    with pytest.raises(InputError, match=r"no inertia for .* moving bodies .*expected <inertial> elements"):
        kinematics.gravity_torque(robot, robot.home)


def test_sources_path_text_and_model_agree():
    path = models.path("arm")
    loaded = [kinematics.load(s) for s in (path, str(path), path.read_text())]
    model = mujoco.MjModel.from_xml_path(str(path))
    for robot in (*loaded, kinematics.load(model)):
        assert robot.frame_names == loaded[0].frame_names
        np.testing.assert_array_equal(robot.body_inertia, loaded[0].body_inertia)
    np.testing.assert_allclose(loaded[0].home, [0, 0.6, 0.8, -0.3])
    assert loaded[0].limits[1] == pytest.approx(np.deg2rad([-115, 115]))


def test_a_mesh_that_is_there_gives_the_inertia(tmp_path):
    vertices = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}\nf {a} {c} {d}" for a, b, c, d in faces]
    (tmp_path / "cube.obj").write_text("\n".join(lines))
    text = (
        '<mujoco><asset><mesh name="cube" file="cube.obj"/><mesh name="gone" file="gone.obj"/></asset><worldbody>'
        '<body><joint/><geom type="mesh" mesh="cube"/><geom type="mesh" mesh="gone" mass="0"/></body>'
        "</worldbody></mujoco>"
    )
    (tmp_path / "robot.xml").write_text(text)
    robot = kinematics.load(tmp_path / "robot.xml")
    assert robot.body_mass[0] == pytest.approx(8000)
    assert robot.notes == ("1 mesh files absent, geometry left out (first: gone.obj)",)


def test_urdf_keeps_fixed_links_mimics_and_limits():
    text = urdf(
        link("a"),
        link("b"),
        link("c"),
        link("tool", inertial=""),
        joint("j1", "a", "b"),
        joint("j2", "b", "c", "continuous", '<mimic joint="j1" multiplier="2" offset="0.1"/>'),
        joint("flange", "c", "tool", "fixed"),
    )
    robot = kinematics.load(text)
    assert robot.frame_names == ("a", "b", "c", "tool")
    assert robot.topology.couplings == ((1, 0),)
    np.testing.assert_allclose(kinematics.expand(robot, np.array([0.3])), [0.3, 0.7], rtol=1e-6)
    np.testing.assert_array_equal(robot.limits, [[-1, 2], [-np.inf, np.inf]])


@pytest.mark.parametrize("file", ["package://nowhere/meshes/x.stl", "package://nowhere/meshes/x.dae"])
def test_an_unknown_package_path_is_named(file):
    parts = link("a"), joint("j", "a", "b")
    robot = kinematics.load(urdf(*parts, link("b", collision(file))))
    assert robot.notes == (f"1 mesh files absent, geometry left out (first: {file})",)
    assert robot.body_mass[1] == 1
    robot = kinematics.load(urdf(*parts, link("b", collision(file), inertial="")))
    assert robot.topology.massless == ("b",)


def test_a_moving_link_without_anything_has_kinematics_only():
    robot = kinematics.load(
        urdf(link("a"), link("b", inertial=""), link("c"), joint("j", "a", "b"), joint("k", "b", "c"))
    )
    assert robot.topology.massless == ("b",)
    assert robot.body_mass[1] == 0


def test_nameless_elements_get_free_names():
    text = '<mujoco><worldbody><body><joint/><geom size=".1"/><site/></body><body name="body1"/></worldbody></mujoco>'
    assert kinematics.load(text).frame_names == ("body2", "body1", "site:site0")


def test_pictures_and_sensors_of_absent_files_do_not_matter():
    text = (
        '<mujoco><asset><texture name="t" type="2d" file="no.png"/><material name="m" texture="t"/>'
        '<hfield name="h" file="no.png" size="1 1 1 1"/><skin file="no.skn"/></asset>'
        '<worldbody><geom type="hfield" hfield="h"/><body><joint/><geom material="m" size=".1"/></body></worldbody>'
        "</mujoco>"
    )
    assert kinematics.load(text).nq == 1


BAD = {
    "broken XML": ("<mujoco><worldbody></mujoco>", "robot text: MuJoCo cannot read it: .*MISMATCHED"),
    "unknown attribute": ('<mujoco><worldbody><body nme="a"/></worldbody></mujoco>', "nme.*line 1"),
    "name twice": ('<mujoco><worldbody><body name="a"/><body name="a"/></worldbody></mujoco>', "repeated name 'a'"),
    "keyframe": (
        '<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody>'
        '<keyframe><key name="home" qpos="1 2"/></keyframe></mujoco>',
        "keyframe 'home': invalid qpos size, expected 1, got 2",
    ),
    "absent include": ('<mujoco><include file="nothere.xml"/></mujoco>', "nothere.xml"),
    "other XML": ("<svg/>", r"not a robot: expected MJCF \(<mujoco>\) or URDF \(<robot>\), found '<svg/>'"),
    "mimic of nobody": (
        urdf(link("a"), link("b"), joint("j", "a", "b", inside='<mimic joint="i"/>')),
        "joint 'j' mimics: joint 'i' does not exist; did you mean 'j'|known: j",
    ),
    "coupled in a circle": (
        '<mujoco><worldbody><body><joint name="a"/><joint name="b" axis="1 0 0"/><geom size=".1"/></body></worldbody>'
        '<equality><joint joint1="a" joint2="b"/><joint joint1="b" joint2="a"/></equality></mujoco>',
        "robot text: equality: joints a, b are coupled in a circle",
    ),
    "coupled twice": (
        '<mujoco><worldbody><body><joint name="a"/><joint name="b" axis="1 0 0"/><joint name="c" axis="0 1 0"/>'
        '<geom size=".1"/></body></worldbody><equality><joint joint1="a" joint2="b"/><joint joint1="a" joint2="c"/>'
        "</equality></mujoco>",
        "robot text: equality: joint a is joint1 twice; expected once",
    ),
    "macros": (
        '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include filename="a.xacro"/>'
        + link("a")
        + "</robot>",
        "found <xacro:include>, expected plain URDF; expand it first",
    ),
    "macro in a number": (
        urdf(link("a"), link("b"), '<joint name="j" type="fixed"><origin xyz="${x} 0 0"/></joint>'),
        r"found \${x}, expected plain URDF",
    ),
    "link of nobody": (urdf(link("base"), link("b"), joint("j", "bsae", "b")), "'j': parent: link 'bsae' .* 'base'"),
    "joint of one link": (urdf(link("a"), '<joint name="j" type="fixed"><parent link="a"/></joint>'), "'j': no <child"),
    "links in a circle": (
        urdf(link("a"), link("b"), joint("j", "a", "b"), joint("k", "b", "a")),
        "links form a circle: a - b - a",
    ),
    "two joints of one name": (
        urdf(link("a"), link("b"), link("c"), joint("j", "a", "b"), joint("j", "b", "c")),
        "robot text: two joints are named 'j'; expected each name once",
    ),
    "two links of one name": (
        urdf(link("a"), link("b"), link("b"), joint("j", "a", "b")),
        "robot text: two links are named 'b'",
    ),
    "reversed limits": (
        urdf(link("a"), link("b"), joint("j", "a", "b").replace('"-1"', '"3"')),
        "joint 'j': limit: lower 3 is above upper 2; expected lower < upper",
    ),
    "two parents": (
        urdf(link("a"), link("b"), link("c"), joint("j", "a", "c"), joint("k", "b", "c")),
        "joint 'k': link 'c' hangs on 'a' already",
    ),
    "not a number": (
        '<mujoco><worldbody><body name="up" pos="nan 0 0"><joint/><geom size=".1"/></body></worldbody></mujoco>',
        "body 'up': a number is NaN",
    ),
    "free joint below the root": (urdf(link("a"), link("b"), joint("j", "a", "b", "floating")), "'world'"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_robots_are_refused_with_a_reason(case):
    text, reason = BAD[case]
    with pytest.raises(InputError, match=reason):
        kinematics.load(text)


def test_files_that_are_no_robots(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere.urdf: no such file"):
        kinematics.load(tmp_path / "nowhere.urdf")
    (tmp_path / "a.xml").write_text("hello\nworld")
    with pytest.raises(InputError, match=r"a.xml: not a robot: .* found 'hello'"):
        kinematics.load(tmp_path / "a.xml")
    (tmp_path / "b.xml").write_bytes(b"")
    with pytest.raises(InputError, match=r"b.xml: not a robot: .* found 'an empty file'"):
        kinematics.load(tmp_path / "b.xml")


def test_files_in_another_encoding_are_refused_only_where_it_matters(tmp_path):
    file = tmp_path / "a.urdf"
    text = urdf(link("a"), link("b"), joint("j", "a", "b"))
    file.write_bytes(("<!-- für --><!-- -- ${x} <xacro:macro> -- -->" + text).encode("latin-1"))
    assert kinematics.load(file).nq == 1
    file.write_bytes(text.replace('"b"', '"bügel"').encode("latin-1"))
    with pytest.raises(InputError, match=r"a.urdf: a name is not UTF-8 \(b'b.*gel'\)"):
        kinematics.load(file)
    file.write_bytes(text.encode("utf-16"))
    with pytest.raises(InputError, match=r"a.urdf: not a text in UTF-8"):
        kinematics.load(file)


def inertial(mass, numbers, rpy="0 0 0"):
    values = " ".join(f'{key}="{value}"' for key, value in zip(("ixx", "iyy", "izz", "ixy"), numbers, strict=True))
    turned = f'<origin xyz="0.1 0.2 0.3" rpy="{rpy}"/>'
    return f'<inertial>{turned}<mass value="{mass}"/><inertia {values} ixz="0" iyz="0"/></inertial>'


def test_inertias_that_no_matter_has_are_used_as_given():
    bodies = [
        link("a"),
        f'<link name="flat">{inertial(1.5, (0.01, 0.01, 0.03, 0.002), "0.1 0.2 0.3")}</link>',  # A + B < C
        f'<link name="frame">{inertial(0, (0, 0, 0, 0))}</link>',
        f'<link name="tip">{inertial(0.5, (0.01, 0.02, 0.025, 0.001))}</link>',
        f'<link name="nothing">{inertial(0, (0, 0, 0, 0))}</link>',
    ]
    joints = [joint("i", "a", "flat"), joint("j", "flat", "frame"), joint("k", "frame", "tip")]
    text = urdf(*bodies[:4], *joints)
    robot = kinematics.load(text)
    assert robot.notes == ("2 inertias that no matter has, used as given (flat, frame)",)
    np.testing.assert_allclose(robot.body_mass, [1, 1.5, 0, 0.5])
    turn = Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix()
    given = np.array([[0.01, 0.002, 0], [0.002, 0.01, 0], [0, 0, 0.03]])
    np.testing.assert_allclose(robot.body_inertia[robot.frame_names.index("flat")], turn @ given @ turn.T, atol=1e-12)
    q = np.array([0.3, -0.4, 0.5])
    model = compile_model(text)
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    with jax.enable_x64(True):
        np.testing.assert_allclose(kinematics.gravity_torque(robot, q), data.qfrc_bias, atol=1e-12)
    robot = kinematics.load(urdf(*bodies, *joints, joint("l", "tip", "nothing")))
    assert "kinematics only: no inertia for 1 bodies (nothing)" in robot.notes


def test_a_frame_without_mass_at_the_tip_leaves_the_dynamics():
    """As `tool0` of many arms: only a joint that would move nothing has none."""
    tool = f'<link name="tool">{inertial(0, (0, 0, 0, 0))}</link>'
    robot = kinematics.load(urdf(link("a"), link("b"), tool, joint("j", "a", "b"), joint("k", "b", "tool", "fixed")))
    assert robot.topology.massless == ()
    assert np.isfinite(kinematics.mass_matrix(robot, np.zeros(1))).all()


def compiled_alike(text):
    """The masses and inertias are MuJoCo's own."""
    robot, model = kinematics.load(text), mujoco.MjModel.from_xml_string(text)
    np.testing.assert_allclose(robot.body_mass, model.body_mass[1:])
    for body, inertia in enumerate(robot.body_inertia):
        np.testing.assert_allclose(np.linalg.eigvalsh(inertia), np.sort(model.body_inertia[body + 1]), rtol=1e-9)
    return robot


def mjcf(body, options="", rest=""):
    return f"<mujoco>{options}<worldbody>{body}</worldbody>{rest}</mujoco>"


FLAT = '<inertial pos="0 0 0.1" mass="3" diaginertia="1 1 3"/>'


def test_the_compiler_may_replace_inertias_that_no_matter_has():
    body = f'<body name="a"><joint/>{FLAT}<geom size="0.1"/></body>'
    for option in ('balanceinertia="true"', 'inertiafromgeom="true"'):
        assert compiled_alike(mjcf(body, f"<compiler {option}/>")).notes == ()


def test_the_compilers_bounds_count_before_what_no_matter_has():
    light = '<inertial pos=".1 0 0" mass="0" diaginertia="0 0 0"/>'
    heavy = '<inertial pos=".1 0 0" mass="1" diaginertia=".1 .1 .1"/>'
    tip = f'<body pos="0 .1 0"><joint axis="0 1 0"/>{heavy}</body>'
    text = mjcf(f'<body><joint axis="1 0 0"/>{light}{tip}</body>', '<compiler boundmass=".5" boundinertia=".01"/>')
    compiled_alike(text)
    found, wanted = np.zeros((2, 2, 2))
    for model, matrix in ((compile_model(text), found), (mujoco.MjModel.from_xml_string(text), wanted)):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    robot = kinematics.load(mjcf(f'<body name="a"><joint/>{FLAT}</body>', '<compiler boundmass="5"/>'))
    assert robot.body_mass[0] == 5
    assert robot.notes == ("1 inertias that no matter has, used as given (a)",)


def test_nameless_bodies_may_have_inertias_that_no_matter_has():
    robot = kinematics.load(mjcf(f"<body><joint/>{FLAT}<body><joint/>{FLAT}</body></body>"))
    assert robot.frame_names == ("body1", "body2")
    np.testing.assert_allclose(np.linalg.eigvalsh(robot.body_inertia[1]), [1, 1, 3])


def test_a_total_mass_counts_what_the_file_says():
    """Not the stand-ins that MuJoCo is given for what it refuses."""
    body = '<body name="a"><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    robot = kinematics.load(mjcf(f'{body}<body name="b"><joint/>{FLAT}</body>', '<compiler settotalmass="8"/>'))
    np.testing.assert_allclose(robot.body_mass, [2, 6])
    np.testing.assert_allclose(np.linalg.eigvalsh(robot.body_inertia[1]), [2, 2, 6])


def test_meshes_of_an_attached_model_are_looked_for_beside_it(tmp_path):
    (tmp_path / "arm" / "m").mkdir(parents=True)
    corner = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "arm" / "m" / "hand.obj").write_text(corner)
    hand = '<body name="hand"><joint/><geom type="mesh" mesh="hand"/></body>'
    (tmp_path / "arm" / "arm.xml").write_text(
        mjcf(hand, '<compiler meshdir="m"/><asset><mesh name="hand" file="hand.obj"/></asset>')
    )
    attach = '<body name="base"><attach model="arm" body="hand" prefix="my_"/></body>'
    (tmp_path / "robot.xml").write_text(
        mjcf(attach, '<asset><model name="arm" file="arm/arm.xml"/></asset>').replace("<mujoco>", '<mujoco model="r">')
    )
    robot = kinematics.load(tmp_path / "robot.xml")
    assert robot.notes == ()
    np.testing.assert_allclose(robot.body_mass, [0, 1000 / 6], rtol=1e-6)


def test_what_acts_beyond_the_joints_is_taken_along_or_said():
    joints = "".join(
        f'<body name="{n}" {more}><joint name="{n}" axis="0 1 0"/><geom size=".1" mass="1"/></body>'
        for n, more in (("a", ""), ("b", 'gravcomp="1"'))
    )
    springs = '<tendon><fixed name="t" stiffness="1"><joint joint="a" coef="1"/></fixed></tendon>'
    closed = '<equality><connect body1="a" body2="b" anchor="0 0 0"/></equality>'
    motor = '<actuator><general joint="a" gear="3" armature=".5" damping=".2"/></actuator>'
    robot = kinematics.load(mjcf(joints, rest=springs + closed + motor))
    assert robot.notes == (
        "left out: 1 constraints (connect), so that closed loops are open; 1 tendons' springs, dampers and inertias; "
        "1 bodies' gravity compensation",
    )
    np.testing.assert_allclose(robot.armature, [4.5, 0])
    np.testing.assert_allclose(robot.damping, [1.8, 0])


@pytest.mark.parametrize("flag", ["gravity", "spring", "damper", "frictionloss", "equality", "constraint"])
def test_what_a_files_flags_disable_does_not_act(flag):
    joints = "".join(
        f'<body name="{n}" gravcomp="1"><joint name="{n}" axis="0 1 0" stiffness="2" damping=".5" frictionloss=".1"/>'
        '<geom pos=".1 0 0" size=".1"/></body>'
        for n in "ab"
    )
    rest = '<equality><joint joint1="a" joint2="b"/><connect body1="a" body2="b" anchor="0 0 0"/></equality>'
    rest += '<actuator><general joint="a" damping=".2"/></actuator>'
    text = mjcf(joints, f'<option><flag {flag}="disable"/></option>', rest)
    robot, model = kinematics.load(text), mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = (0.3, -0.2), (0.4, 0.1)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(-robot.damping * data.qvel, data.qfrc_damper)
    np.testing.assert_allclose(-robot.stiffness * data.qpos, data.qfrc_spring)
    assert (
        any(robot.gravity)
        == (abs(data.qfrc_bias) > 1e-9).all()
        == any("gravity compensation" in note for note in robot.notes)
    )
    assert bool(robot.topology.couplings) == (data.ne > 0) == any("connect" in note for note in robot.notes)
    assert any(robot.friction_loss) == (data.nf > 0)
    np.testing.assert_array_equal(kinematics.load(model).damping, robot.damping)
    assert model.dof_damping.all()


def coupled(ranges, coefficients):
    """Two hinges, the second of which follows the first."""
    one, two = ranges
    inner = f'<body pos="1 0 0"><joint name="b" axis="0 0 1" range="{two}"/><geom size=".1"/></body>'
    outer = f'<body><joint name="a" axis="0 0 1" range="{one}"/><geom size=".1"/>{inner}</body>'
    rest = f'<equality><joint joint1="b" joint2="a" polycoef="{coefficients}"/></equality>'
    return kinematics.load(mjcf(outer, '<compiler angle="radian"/>', rest))


@pytest.mark.parametrize(
    ("ranges", "coefficients", "leader"),
    [
        (("-3 3", "-.5 .5"), "0 1 0 0 0", (-0.5, 0.5)),
        (("-3 .1", "-.5 .5"), ".3 -2 0 0 0", (-0.1, 0.1)),
        (("-3 3", "-.5 .5"), "0 0 1 0 0", (-3, 3)),  # not in proportion
        (("0 1", "0 1"), "0 -1 0 0 0", (0, 1)),  # no range would be left
    ],
)
def test_a_leaders_limits_hold_for_what_follows_it(ranges, coefficients, leader):
    robot = coupled(ranges, coefficients)
    np.testing.assert_allclose(robot.limits[0], leader, atol=1e-12)
    np.testing.assert_array_equal(robot.limits[1], np.array(ranges[1].split(), float))


def test_limits_of_a_ball_joint_are_left_out_with_a_word():
    ball = '<body><joint type="ball" range="0 30"/><geom size=".1"/></body>'
    assert kinematics.load(mjcf(ball)).notes == ("left out: 1 limits of ball joints",)


def test_what_is_no_source():
    with pytest.raises(ValueError, match="source: got int, expected a path"):
        kinematics.load(3)
    with pytest.raises(FileNotFoundError, match=r"x\.\.\.: no such file"):
        kinematics.load("x" * 5000)
    assert kinematics.load("\ufeff" + urdf(link("a"), link("b"), joint("j", "a", "b"))).nq == 1


def test_what_mujoco_warns_of_is_a_note(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    mimic = joint("k", "a", "b", "planar", inside='<mimic joint="k"/>')
    robot = kinematics.load(urdf(link("a"), link("b"), mimic))
    assert robot.notes == ("<mimic> on joint 'k' ignored; mimic requires revolute, continuous, or prismatic joints",)
    flex = kinematics.load(
        '<mujoco><worldbody><flexcomp name="f" type="grid" count="2 2 1" spacing=".1 .1 .1" radius=".01" dim="2"/>'
        "</worldbody></mujoco>"
    )
    assert "flex 'f' is not rigid" in flex.notes[0]
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr().out == ""


def test_packaged_robots():
    assert {"arm", "rover"} <= set(models.names())
    with pytest.raises(InputError, match="packaged robot 'am' does not exist; did you mean 'arm'"):
        models.path("am")
    with pytest.raises(ValueError, match="joints: 0"):
        models.chain(0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"position": {"b": [1, 2]}}, r"position\['b'\]: shape \(2,\), expected \(3,\)"),
        ({"quaternion": {"b": [1, 0, 0]}}, r"quaternion\['b'\]: shape \(3,\), expected \(4,\)"),
        ({"mass": {"b": [1]}}, r"mass\['b'\]: shape \(1,\), expected \(\)"),
        ({"center_of_mass": {"b": 0.5}}, r"center_of_mass\['b'\]: shape \(\), expected \(3,\)"),
        ({"payload": {"b": (1.0, [1, 2])}}, r"payload\['b'\]: shapes \(\) and \(2,\), expected"),
    ],
)
def test_changed_numbers_of_a_wrong_shape_are_named(change, words):
    robot = kinematics.load(urdf(link("a"), link("b"), joint("j", "a", "b")))
    with pytest.raises(ValueError, match=words):
        kinematics.with_parameters(robot, **change)
