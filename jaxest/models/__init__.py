"""Robots that come with the package, as MJCF: paths to hand to `jaxest.kinematics.load`.

`path("arm")` is a light 4-joint arm that bends (Sato 2023, Fig. 7), `path("sticks")` a manipulator of joint modules and
crooked sticks with its IMUs (Sato 2024, Fig. 7), `path("rover")` has every kind of joint, `path("gripper")` has two
fingers with IMUs, `path("human_arm")` is a person's arm with four (Santaera 2015), and `chain(n)` writes a serial arm
of n hinges for studies of size.
"""

from pathlib import Path

from jaxest.types import unknown_name

_HERE = Path(__file__).parent


def names() -> tuple[str, ...]:
    """Return the names of the packaged robots."""
    return tuple(sorted(file.stem for file in _HERE.glob("*.xml")))


def path(name: str) -> Path:
    """Return the MJCF file of a packaged robot.

    Args:
        name: one of `names()`.

    Returns:
        Its path.

    Raises:
        InputError: there is no such robot; the closest names are given.
    """
    if name not in names():
        raise unknown_name("packaged robot", name, names())
    return _HERE / f"{name}.xml"


def chain(joints: int, length: float = 0.25) -> str:
    """Write a serial arm whose hinges turn about z and y in turn.

    Args:
        joints: number of hinges, at least 1.
        length: m, from one hinge to the next.

    Returns:
        MJCF text, bodies `link1` ... and joints `joint1` ...

    Raises:
        ValueError: fewer than one joint.
    """
    if joints < 1:
        raise ValueError(f"joints: {joints}, expected at least 1")
    opening, closing = "", ""
    for i in range(joints):
        axis = "0 0 1" if i % 2 == 0 else "0 1 0"
        opening += (
            f'<body name="link{i + 1}" pos="{length if i else 0} 0 0" euler="0 {5 if i else 0} 0">'
            f'<joint name="joint{i + 1}" axis="{axis}"/>'
            f'<geom type="capsule" fromto="0 0 0 {length} 0 0" size="0.02" mass="0.3"/>'
        )
        closing += "</body>"
    return f'<mujoco model="chain{joints}"><worldbody>{opening}{closing}</worldbody></mujoco>'
