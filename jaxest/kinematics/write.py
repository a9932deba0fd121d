"""Writing a robot as MJCF or URDF, on the host: what was loaded, changed, measured or put together goes back to a file.

`load(to_mjcf(robot))` has the same numbers. A URDF holds less, and says so where that would change the robot.
"""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray

from jaxest.files import write_text
from jaxest.kinematics.robot import BALL, FREE, HINGE, NV, SLIDE, Robot
from jaxest.kinematics.urdf_frames import matrix, roll_pitch_yaw, turned
from jaxest.types import InputError

WORLD = "world"
EFFORT, SPEED = "100", "10"  # N m and rad/s: a URDF must name some, nobody here knows them


def write(robot: Robot, path: str | Path) -> None:
    """Write a robot into a file, replacing it, whole or not at all.

    Args:
        robot: the robot.
        path: with the suffix `.xml` or `.mjcf` for MJCF, `.urdf` for URDF.

    Raises:
        InputError: another suffix, a URDF cannot hold this robot, or the file cannot be written.
    """
    path = Path(path)
    makers = {".xml": to_mjcf, ".mjcf": to_mjcf, ".urdf": to_urdf}
    if path.suffix.lower() not in makers:
        raise InputError(f"{path}: expected a name that ends in {', '.join(makers)}")
    write_text(path, makers[path.suffix.lower()](robot), overwrite=True)


def to_mjcf(robot: Robot) -> str:
    """Return a robot as MJCF text: bodies, joints, sites, inertias, couplings, limits and home; no shapes.

    Args:
        robot: the robot, its numbers known.

    Returns:
        The text.
    """
    topology = robot.topology
    root = Element("mujoco", model=topology.name)
    SubElement(root, "compiler", angle="radian", autolimits="true")
    SubElement(root, "option", gravity=_text(robot.gravity))
    elements = {-1: SubElement(root, "worldbody")}
    _add_sites(robot, -1, elements[-1])
    for body, name in enumerate(topology.body_names):
        parent = elements[topology.body_parent[body]]
        place = {"pos": _text(robot.body_position[body]), "quat": _text(robot.body_quaternion[body])}
        elements[body] = element = SubElement(parent, "body", {"name": name, **place})
        if float(robot.body_mass[body]) > 0:
            inertia = np.asarray(robot.body_inertia[body])
            full = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            SubElement(element, "inertial", pos=_text(robot.body_com[body]), mass=_text(robot.body_mass[body]),
                       fullinertia=_text(full))  # fmt: skip
        for joint in _joints(robot, body):
            _mjcf_joint(robot, joint, element)
        _add_sites(robot, body, element)
    _mjcf_couplings(robot, root)
    if not np.array_equal(robot.home, robot.joint_reference):
        SubElement(SubElement(root, "keyframe"), "key", name="home", qpos=_text(robot.home))
    return _document(root)


def _mjcf_joint(robot: Robot, joint: int, element: Element) -> None:
    topology = robot.topology
    kind, name = topology.joint_kind[joint], topology.joint_names[joint]
    q, v = (
        topology.joint_q[joint],
        slice(topology.joint_v[joint], topology.joint_v[joint] + NV[topology.joint_kind[joint]]),
    )
    passive = {"armature": robot.armature[v][0], "damping": robot.damping[v][0],
               "frictionloss": robot.friction_loss[v][0], "stiffness": robot.stiffness[joint]}  # fmt: skip
    made = SubElement(element, "joint", name=name, type=kind)
    if kind != FREE:
        made.set("pos", _text(robot.joint_anchor[joint]))
    if kind in (HINGE, SLIDE):
        made.set("axis", _text(robot.joint_axis[joint]))
        made.set("ref", _text(robot.joint_reference[q]))
        made.set("springref", _text(robot.spring_reference[q]))
        if np.isfinite(robot.limits[q]).all():
            made.set("range", _text(robot.limits[q]))
    for key, value in passive.items():
        if float(value):
            made.set(key, _text(value))


def _mjcf_couplings(robot: Robot, root: Element) -> None:
    topology = robot.topology
    equality = SubElement(root, "equality") if topology.couplings else root
    for (joint, leader), coefficients in zip(topology.couplings, np.asarray(robot.coupling), strict=True):
        made = SubElement(equality, "joint", joint1=topology.joint_names[joint], polycoef=_text(coefficients))
        if leader >= 0:
            made.set("joint2", topology.joint_names[leader])


def _add_sites(robot: Robot, body: int, element: Element) -> None:
    for site, owner in enumerate(robot.topology.site_body):
        if owner == body:
            SubElement(element, "site", name=robot.topology.site_names[site], pos=_text(robot.site_position[site]),
                       quat=_text(robot.site_quaternion[site]))  # fmt: skip


def to_urdf(robot: Robot) -> str:
    """Return a robot as URDF text: a link for each body, and a fixed one for each site, on a link `world`.

    Gravity, rotor inertias, springs and the home posture have no place in a URDF and are left out.

    Args:
        robot: the robot, its numbers known.

    Returns:
        The text; `load` of it has the same coordinates and frames, sites being bodies.

    Raises:
        InputError: a ball or free joint, two joints on a body, a joint away from its body's origin, a coupling that is
            not linear, or a body called `world`.
    """
    topology = robot.topology
    root = Element("robot", name=topology.name)
    SubElement(root, "link", name=WORLD)
    if WORLD in topology.body_names:
        raise InputError(f"URDF: a body is called {WORLD!r}, which is what the fixed link is called")
    names = [WORLD, *topology.body_names]
    for body, name in enumerate(topology.body_names):
        link = SubElement(root, "link", name=name)
        if float(robot.body_mass[body]) > 0:
            _urdf_inertia(robot, body, link)
        _urdf_joint(robot, body, names[topology.body_parent[body] + 1], root)
    for site, owner in enumerate(topology.site_body):
        name = topology.site_names[site]
        name = name if name not in names else f"{name}_site"
        names.append(name)
        SubElement(root, "link", name=name)
        _fixed(root, names[owner + 1], name, robot.site_position[site], robot.site_quaternion[site])
    return _document(root)


def _urdf_inertia(robot: Robot, body: int, link: Element) -> None:
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_text(robot.body_com[body]), rpy="0 0 0")
    SubElement(inertial, "mass", value=_text(robot.body_mass[body]))
    inertia = np.asarray(robot.body_inertia[body])
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": _text(inertia[i, j]) for i in range(3) for j in range(i, 3)}
    SubElement(inertial, "inertia", entries)


def _fixed(root: Element, parent: str, child: str, position: Any, quaternion: Any) -> Element:
    made = SubElement(root, "joint", name=f"{parent}_{child}", type="fixed")
    _origin(made, parent, child, position, matrix(quaternion))
    return made


def _origin(made: Element, parent: str, child: str, position: Any, rotation: NDArray[np.float64]) -> None:
    SubElement(made, "origin", xyz=_text(position), rpy=_text(roll_pitch_yaw(rotation)))
    SubElement(made, "parent", link=parent)
    SubElement(made, "child", link=child)


def _urdf_joint(robot: Robot, body: int, parent: str, root: Element) -> None:
    topology = robot.topology
    name, joints = topology.body_names[body], _joints(robot, body)
    if not joints:
        _fixed(root, parent, name, robot.body_position[body], robot.body_quaternion[body])
        return
    joint = joints[0]
    kind = topology.joint_kind[joint]
    place = f"URDF: body {name!r}"
    if len(joints) > 1 or kind in (BALL, FREE):
        found = ", ".join(f"{topology.joint_names[j]!r} ({topology.joint_kind[j]})" for j in joints)
        raise InputError(f"{place}: moves by {found}, expected at most one hinge or slide")
    if np.any(np.asarray(robot.joint_anchor[joint])):
        raise InputError(f"{place}: its joint is at {_text(robot.joint_anchor[joint])} in it, expected at its origin")
    q, axis = topology.joint_q[joint], np.asarray(robot.joint_axis[joint], float)
    axis = axis / np.linalg.norm(axis)
    # A URDF's joint is 0 where its child stands at the origin given; ours is at its reference there.
    back, rotation = -float(robot.joint_reference[q]), matrix(robot.body_quaternion[body])
    position = np.asarray(robot.body_position[body], float)
    if kind == SLIDE:
        position = position + rotation @ axis * back
    else:
        rotation = rotation @ turned(axis, back)
    bounded = np.isfinite(robot.limits[q]).all()
    types = {SLIDE: "prismatic", HINGE: "revolute" if bounded else "continuous"}
    made = SubElement(root, "joint", name=topology.joint_names[joint], type=types[kind])
    _origin(made, parent, name, position, rotation)
    SubElement(made, "axis", xyz=_text(axis))
    limit = SubElement(made, "limit", effort=EFFORT, velocity=SPEED)
    if bounded:
        limit.set("lower", _text(robot.limits[q][0]))
        limit.set("upper", _text(robot.limits[q][1]))
    v = topology.joint_v[joint]
    SubElement(made, "dynamics", damping=_text(robot.damping[v]), friction=_text(robot.friction_loss[v]))
    _mimic(robot, joint, made)


def _mimic(robot: Robot, joint: int, made: Element) -> None:
    topology = robot.topology
    reference = np.asarray(robot.joint_reference, float)
    for (dependent, leader), coefficients in zip(topology.couplings, np.asarray(robot.coupling), strict=True):
        if dependent != joint:
            continue
        if leader < 0 or np.any(coefficients[2:]):
            raise InputError(
                f"URDF: joint {topology.joint_names[joint]!r}: its coupling is not linear in another joint"
            )
        offset = reference[topology.joint_q[joint]] + coefficients[0]
        offset = offset - coefficients[1] * reference[topology.joint_q[leader]]
        SubElement(made, "mimic", joint=topology.joint_names[leader], multiplier=_text(coefficients[1]),
                   offset=_text(offset))  # fmt: skip


def _joints(robot: Robot, body: int) -> list[int]:
    return [joint for joint, owner in enumerate(robot.topology.joint_body) if owner == body]


def _text(numbers: Any) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(np.asarray(numbers, np.float64)))


def _document(root: Element) -> str:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


__all__ = ["to_mjcf", "to_urdf", "write"]
