"""Robots put together from joint modules and sticks: what is known of the modules, and the robot that they make.

A module is a motor with an IMU on its housing (`before` the joint) and one on its horn (`after` it). A stick joins the
horn of one module to the housing of the next; where that is, `jaxest.systems.onsite_chain` finds out.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from jaxest.kinematics.load import load
from jaxest.kinematics.robot import Robot
from jaxest.manifolds.se3 import Pose
from jaxest.types import InputError


def known(rotation: Any = (1.0, 0.0, 0.0, 0.0), translation: Any = (0.0, 0.0, 0.0)) -> Pose:
    """Return a pose of NumPy numbers, from a quaternion (4,) wxyz and a place (3,) m."""
    rotation, translation = np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
    return Pose(rotation, translation)


STILL = known()
TOOL = "tool"


class Module(NamedTuple):
    """A joint with its IMUs; the joint's axis runs through the origin of the module's frame."""

    name: str
    """Of the joint."""
    before: Pose | None = None
    """The IMU on the housing, in the module's frame; None where there is none."""
    after: Pose | None = None
    """The IMU on the horn, in the module's frame when the joint is at 0."""
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """In the module's frame."""
    limits: tuple[float, float] = (-math.pi / 2, math.pi / 2)
    """rad."""


class Assembly(NamedTuple):
    """A serial robot of modules."""

    modules: tuple[Module, ...]
    """From the base outwards."""
    links: tuple[Pose | None, ...]
    """Module k + 1 in the horn of module k; None where a stick is between them that nobody has measured."""
    base: Pose = STILL
    """The first module's housing in the world."""
    tool: Pose = STILL
    """The gripper in the last module's horn, known by design."""

    @property
    def unknown(self) -> tuple[int, ...]:
        """Links that are to be found."""
        return tuple(k for k, link in enumerate(self.links) if link is None)


def check(assembly: Assembly) -> Assembly:
    """Check an assembly on the host.

    Args:
        assembly: the assembly.

    Returns:
        The same.

    Raises:
        InputError: no modules, names that repeat, a link too many or too few, limits or axes that cannot be, or a link
            that is to be found with no IMU at an end.
    """
    modules = assembly.modules
    names = [module.name for module in modules]
    if not modules or len(set(names)) < len(names):
        raise InputError(f"modules: got the names {', '.join(names) or 'none'}, expected at least one, all different")
    if len(assembly.links) != len(modules) - 1:
        raise InputError(f"links: got {len(assembly.links)} for {len(modules)} modules, expected one between every two")
    for module in modules:
        low, high = module.limits
        if not low < high or not np.linalg.norm(module.axis) > 0:
            raise InputError(f"module {module.name!r}: axis {module.axis}, limits {module.limits}")
    for k in assembly.unknown:
        for module, side in ((modules[k], "after"), (modules[k + 1], "before")):
            if getattr(module, side) is None:
                raise InputError(
                    f"module {module.name!r}: has no IMU {side} the joint, so that the link from "
                    f"{names[k]!r} to {names[k + 1]!r} cannot be found"
                )
    return assembly


def assemble(assembly: Assembly, links: Sequence[Pose] = (), *, name: str = "assembly") -> Robot:
    """Put a robot together.

    Args:
        assembly: its modules.
        links: poses of the links that the assembly does not know, in their order.
        name: of the robot.

    Returns:
        The robot, without masses: joints by the modules' names, bodies `NAME_horn`, sites `NAME_before` and
        `NAME_after` for the IMUs and `tool` for the gripper.

    Raises:
        InputError: the assembly is wrong, or the number of links is.
    """
    check(assembly)
    if len(links) != len(assembly.unknown):
        raise InputError(f"links: got {len(links)}, expected {len(assembly.unknown)}, those that are not known")
    given = iter(links)
    places = [assembly.base, *(next(given) if link is None else link for link in assembly.links)]
    root = Element("mujoco", model=name)
    SubElement(root, "compiler", angle="radian", autolimits="true")
    element = SubElement(root, "worldbody")
    for module, place in zip(assembly.modules, places, strict=True):
        if module.before is not None:
            housing = SubElement(element, "body", name=f"{module.name}_housing", **_place(place))
            SubElement(housing, "site", name=f"{module.name}_before", **_place(module.before))
        element = SubElement(element, "body", name=f"{module.name}_horn", **_place(place))
        SubElement(element, "joint", name=module.name, axis=_text(module.axis), range=_text(module.limits))
        if module.after is not None:
            SubElement(element, "site", name=f"{module.name}_after", **_place(module.after))
    SubElement(element, "site", name=TOOL, **_place(assembly.tool))
    return load(tostring(root, encoding="unicode"))


def _place(pose: Pose) -> Any:
    return {"pos": _text(pose.translation), "quat": _text(pose.rotation)}


def _text(numbers: object) -> str:
    return " ".join(repr(float(x)) for x in np.asarray(numbers, np.float64))


__all__ = ["STILL", "TOOL", "Assembly", "Module", "assemble", "check", "known"]
