"""Rooms to feel one's way in, made from a seed, and articulated structures to do it with, as MJCF.

The structures are those of Iwao 2025: a root, then links whose odd joints turn about z and even ones about y. The root
link carries sensors too; its origin is the world's unless it is free.
"""

from typing import NamedTuple

import numpy as np

from jaxest.sensors.proximity import Proximity, ring
from jaxest.types import InputError

LENGTHS = {5: 0.37, 10: 0.27, 20: 0.17}
"""m, of each link, by the number of links. Source: Iwao 2025, section III-A."""
BODY = 0.04  # m, radius of a link; its sensors sit 1 cm off its surface


class Room(NamedTuple):
    """Boxes, all aligned with the world; what is inside the walls is free of them but for the furniture."""

    lower: np.ndarray
    """(3,) m, a corner of the free space."""
    upper: np.ndarray
    """(3,) m, the opposite corner."""
    centers: np.ndarray
    """(B, 3) m: six walls, then furniture."""
    halves: np.ndarray
    """(B, 3) m, half sizes."""


def room(seed: int, *, reach: float = 3.6, free: bool = False) -> Room:
    """Draw a room about a structure that starts at the origin and points along x.

    Args:
        seed: of the room.
        reach: m, length of the structure, which the room is drawn around.
        free: whether the structure lies on the floor, which is then 6 cm below it.

    Returns:
        Walls, floor and ceiling, boxes on the floor, pillars, and slabs on the walls or under the ceiling.
    """
    random = np.random.default_rng([seed, 7001])
    low = np.array([-random.uniform(0.8, 1.6), -random.uniform(1.6, 2.6), -random.uniform(1.1, 1.5)])
    high = np.array([reach + random.uniform(0.5, 1.2), random.uniform(1.6, 2.6), random.uniform(1.1, 1.7)])
    if free:
        low[2], high[2] = -0.06, random.uniform(2.2, 2.9)
    size, middle = high - low, (high + low) / 2
    centers, halves = [], []
    for axis in range(3):
        for end, out in ((low, -1), (high, 1)):
            half = size / 2 + 0.1
            half[axis] = 0.05
            center = middle.copy()
            center[axis] = end[axis] + 0.05 * out
            centers.append(center)
            halves.append(half)
    for _ in range(int(random.integers(5, 10))):
        center, half = _furniture(random, low, high, reach, free)
        centers.append(center)
        halves.append(half)
    return Room(low, high, np.array(centers), np.array(halves))


def _furniture(
    random: np.random.Generator, low: np.ndarray, high: np.ndarray, reach: float, free: bool
) -> tuple[np.ndarray, np.ndarray]:
    """A box, a pillar or a slab that keeps off the straight structure."""
    while True:
        kind = random.integers(3)
        x, y = random.uniform(low[0], high[0]), random.uniform(low[1], high[1])
        if kind == 0:
            half = random.uniform([0.15, 0.15, 0.15], [0.5, 0.5, 0.45])
            z = low[2] + half[2]
        elif kind == 1:
            half = np.array([*random.uniform(0.08, 0.2, 2), (high[2] - low[2]) / 2])
            z = (low[2] + high[2]) / 2
        else:
            half = random.uniform([0.2, 0.2, 0.03], [0.7, 0.5, 0.1])
            z = random.choice([low[2] + random.uniform(0.3, 0.7), high[2] - random.uniform(0.05, 0.5)])
        center = np.array([x, y, z])
        near = np.clip(center, [-0.3, 0, 0], [reach + 0.3, 0, 0])
        gap = np.linalg.norm(np.maximum(np.abs(center - near) - half, 0))
        if gap > (0.6 if free else 0.75):
            return center, half


def sensors(links: int, *, rows: int = 8, columns: int = 8) -> tuple[Proximity, ...]:
    """Return a structure's rings, on the root and on each link, 8 sensors each at mid-link."""
    length = _length(links)
    names = ["root", *(f"link{i + 1}" for i in range(links))]
    return tuple(s for name in names for s in ring(name, length / 2, rows=rows, columns=columns))


def structure(links: int, *, free: bool = False) -> str:
    """Write an articulated structure alone, bodies `root`, `link1` ... and joints `joint1` ..., for `kinematics.load`.

    Args:
        links: 5, 10 or 20, or any other number of 17 cm links.
        free: whether the root moves freely.

    Returns:
        MJCF text.
    """
    return f'<mujoco model="structure{links}"><worldbody>{_chain(links, free)}</worldbody></mujoco>'


def scene(links: int, room: Room | None, *, free: bool = False, gain: float = 60.0) -> str:
    """Write the structure in a room; joints are servoed where it is free.

    Args:
        links: as in `structure`.
        room: the room, or None for a structure alone.
        free: whether the root moves freely, lying on the floor.
        gain: N m/rad of the servos.

    Returns:
        MJCF text.
    """
    boxes = "" if room is None else "".join(
        f'<geom name="room{i}" type="box" pos="{_text(c)}" size="{_text(h)}" rgba="{_colour(i)}" contype="2"'
        ' conaffinity="1" friction="0.8"/>'
        for i, (c, h) in enumerate(zip(room.centers, room.halves, strict=True))
    )  # fmt: skip
    servos = "".join(
        f'<position joint="joint{i + 1}" kp="{gain}" kv="{0.15 * gain}" forcerange="-60 60"/>' for i in range(links)
    )
    return (
        f'<mujoco model="structure{links}"><option timestep="0.002" integrator="implicitfast"/>'
        f'<visual><global offwidth="1280" offheight="960"/></visual><worldbody>{boxes}{_chain(links, free)}</worldbody>'
        + (f"<actuator>{servos}</actuator>" if free else "")
        + "</mujoco>"
    )


def _chain(links: int, free: bool) -> str:
    length = _length(links)
    fit = f'type="capsule" fromto="{BODY} 0 0 {length - BODY} 0 0" size="{BODY}" contype="1" conaffinity="2"'
    looks = f'{fit} mass="0.15" friction="0.8" rgba="0.25 0.45 0.75 1" group="3"'
    opening = f'<body name="root">{"<freejoint/>" if free else ""}<geom {looks}/>'
    for i in range(links):
        axis = "0 0 1" if i % 2 == 0 else "0 1 0"
        opening += (
            f'<body name="link{i + 1}" pos="{length} 0 0">'
            f'<joint name="joint{i + 1}" axis="{axis}" damping="{0.5 if free else 0}" armature="0.01"/><geom {looks}/>'
        )
    return opening + "</body>" * (links + 1)


def _length(links: int) -> float:
    if links < 1:
        raise InputError(f"links: {links}, expected at least 1")
    return LENGTHS.get(links, 0.17)


def _text(x: np.ndarray) -> str:
    return " ".join(f"{v:.6g}" for v in x)


def _colour(i: int) -> str:
    walls = ("0.85 0.85 0.82 0.15", "0.85 0.85 0.82 1", "0.8 0.82 0.85 0.15", "0.8 0.82 0.85 1", "0.6 0.58 0.55 1",
             "0.9 0.9 0.9 0.05")  # fmt: skip
    return walls[i] if i < 6 else "0.75 0.6 0.4 1"


__all__ = ["BODY", "LENGTHS", "Room", "room", "scene", "sensors", "structure"]
