"""The manipulator of joint modules and sticks as MuJoCo has it: masses, servos, IMUs, and a box to drop a ball into."""

from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from numpy.typing import NDArray

from jaxest.kinematics.modular import TOOL, Assembly
from jaxest.manifolds.se3 import Pose

STEP = 5e-4  # s, of MuJoCo
BALL, BOX, WALL = 0.010, (0.045, 0.045, 0.040), 0.002  # m: radius; half width, half depth, height; thickness
STIFF, DAMPED = 300.0, 6.0  # N m/rad and N m s/rad of a servo


class Sticks(NamedTuple):
    """A manipulator and what it knows of itself."""

    assembly: Assembly
    """The modules; the links between the pitch joints are unknown."""
    links: tuple[Pose, ...]
    """Where the unknown links really lead."""
    bends: tuple[NDArray[np.float64], ...]
    """(n, 3) m, corners of each unknown stick in its horn, for its mass and a picture."""


def model(sticks: Sticks, box: NDArray[np.float64] | None = None) -> str:
    """Return the manipulator as MJCF with masses, servos and IMUs, and perhaps a ball and a box to drop it into.

    Args:
        sticks: the manipulator.
        box: (3,) m, the middle of the box's floor in the world; no box and no ball if None.

    Returns:
        The text: joints by the modules' names, sites `NAME_before`, `NAME_after` and `tool`, a gyro and an
        accelerometer for each site of a module.
    """
    root = Element("mujoco", model="sticks")
    SubElement(root, "compiler", angle="radian", autolimits="true")
    SubElement(
        root, "option", timestep=repr(STEP), integrator="Euler"
    )  # implicit ones move by other accelerations than the sensors read
    world = SubElement(root, "worldbody")
    SubElement(world, "light", pos="0 -1 2", dir="0 0.5 -1")
    SubElement(
        world,
        "geom",
        type="cylinder",
        size="0.05 0.1",
        pos="0 0 0.14",
        rgba="0.35 0.37 0.4 1",
        contype="0",
        conaffinity="0",
    )
    element, sensors, actuators = world, SubElement(root, "sensor"), SubElement(root, "actuator")
    given = iter(sticks.links)
    places = [sticks.assembly.base, *(next(given) if k is None else k for k in sticks.assembly.links)]
    sticking = [None, *(b if k is None else None for k, b in zip(sticks.assembly.links, _spaced(sticks), strict=True))]
    following = [*sticking[1:], None]
    for module, place, bends in zip(sticks.assembly.modules, places, following, strict=True):
        if module.before is not None:
            housing = SubElement(element, "body", name=f"{module.name}_housing", **_at(place))
            _imu(housing, sensors, f"{module.name}_before", module.before)
            _geom(housing, "box", size="0.02 0.018 0.012", mass="0.05", rgba="0.2 0.2 0.22 1")
        element = SubElement(element, "body", name=f"{module.name}_horn", **_at(place))
        SubElement(
            element, "joint", name=module.name, axis=_text(module.axis), range=_text(module.limits), armature="0.003"
        )
        _geom(
            element, "cylinder", size="0.012 0.014", mass="0.02", quat="0.7071068 0.7071068 0 0", rgba="0.8 0.8 0.82 1"
        )
        if module.after is not None:
            _imu(element, sensors, f"{module.name}_after", module.after)
        for start, end in zip(*((bends[:-1], bends[1:]) if bends is not None else ((), ())), strict=True):
            _geom(
                element,
                "capsule",
                fromto=_text([*start, *end]),
                size="0.008",
                mass=repr(0.15 * float(np.linalg.norm(end - start))),
                rgba="0.55 0.36 0.2 1",
            )
        SubElement(actuators, "position", name=module.name, joint=module.name, kp=repr(STIFF), kv=repr(DAMPED))
    SubElement(element, "site", name=TOOL, **_at(sticks.assembly.tool))
    _geom(
        element,
        "capsule",
        fromto=_text([0, 0, 0, *sticks.assembly.tool.translation]),
        size="0.007",
        mass="0.04",
        rgba="0.3 0.3 0.32 1",
    )
    if box is not None:
        _target(world, box)
    return tostring(root, encoding="unicode")


def _spaced(sticks: Sticks) -> list[Any]:
    bends = iter(sticks.bends)
    return [next(bends) if link is None else None for link in sticks.assembly.links]


def _imu(body: Element, sensors: Element, name: str, place: Pose) -> None:
    SubElement(body, "site", name=name, size="0.006", rgba="0.1 0.45 0.9 1", **_at(place))
    SubElement(sensors, "gyro", site=name)
    SubElement(sensors, "accelerometer", site=name)


def _geom(body: Element, kind: str, **options: Any) -> None:
    SubElement(body, "geom", type=kind, contype="0", conaffinity="0", **options)


def _target(world: Element, box: NDArray[np.float64]) -> None:
    """A box that is open above, on a column, and the ball."""
    x, y, z = BOX
    walls: list[Any] = [((x, y, WALL), (0, 0, -WALL))]
    walls += [((WALL, y, z / 2), (side * (x + WALL), 0, z / 2)) for side in (-1, 1)]
    walls += [((x, WALL, z / 2), (0, side * (y + WALL), z / 2)) for side in (-1, 1)]
    body = SubElement(world, "body", name="box", pos=_text(box))
    for size, place in walls:
        SubElement(body, "geom", type="box", size=_text(size), pos=_text(place), rgba="0.2 0.6 0.3 1", solref="0.005 1")
    ball = SubElement(world, "body", name="ball", pos=_text(np.asarray(box) + np.array([0, 0, 0.3])))
    SubElement(ball, "freejoint", name="ball")
    SubElement(ball, "geom", type="sphere", size=repr(BALL), mass="0.004", rgba="0.85 0.15 0.15 1", solref="0.005 1")


def _at(pose: Pose) -> Any:
    return {"pos": _text(pose.translation), "quat": _text(pose.rotation)}


def _text(numbers: Any) -> str:
    return " ".join(repr(float(x)) for x in np.asarray(numbers, np.float64))


__all__ = ["BOX", "STEP", "WALL", "Sticks", "model"]
