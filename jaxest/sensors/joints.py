"""Which joints are estimated, and which come with the measurement."""

from collections.abc import Sequence

from jaxest.kinematics import Robot
from jaxest.kinematics.robot import HINGE, NQ
from jaxest.kinematics.space import KINDS, ordered
from jaxest.types import InputError, unknown_name


def chosen(
    robot: Robot, joints: Sequence[str] | None = None, others: Sequence[str] = ()
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Look up joints by name.

    Args:
        robot: the robot.
        joints: hinges, slides and balls to estimate; every hinge that no other joint leads and that is not among
            `others` if None.
        others: joints whose coordinates come with the measurement.

    Returns:
        The numbers of both; those to estimate by kind, hinges first, then slides, then balls.

    Raises:
        InputError: a name does not exist, a joint is free, is coupled or is named twice, or there is none.
    """
    led = {joint for joint, _ in robot.topology.couplings}
    kinds = robot.topology.joint_kind
    rest = tuple(_number(robot, name) for name in others)
    if joints is None:
        found = tuple(j for j, kind in enumerate(kinds) if kind == HINGE and j not in led and j not in rest)
    else:
        found = tuple(_number(robot, name) for name in joints)
    for joint in found:
        if kinds[joint] not in KINDS or joint in led:
            what = "coupled to another" if joint in led else f"a {kinds[joint]} joint"
            raise InputError(
                f"joint {robot.joint_names[joint]!r} is {what}, expected a hinge, slide or ball of its own"
            )
    for joint in rest:
        if NQ[kinds[joint]] != 1 or joint in led:
            raise InputError(f"joint {robot.joint_names[joint]!r}: expected a hinge or slide of its own among others")
    both = [robot.joint_names[j] for j in (*found, *rest)]
    twice = {name for name in both if both.count(name) > 1}
    if twice or not found:
        none = "there is no hinge; slides and balls are estimated where they are named"
        raise InputError(f"joints: {', '.join(sorted(twice))} named twice" if twice else f"joints: {none}")
    return ordered(robot, found), rest


def _number(robot: Robot, name: str) -> int:
    if name not in robot.joint_names:
        raise unknown_name("joint", name, robot.joint_names)
    return robot.joint_names.index(name)


def columns(robot: Robot, joints: tuple[int, ...], kind: str, name: str, wanted: Sequence[str]) -> tuple[int, ...]:
    """Return where among the estimated joints of a kind those stand that a sensor looks at; all if none is named.

    Args:
        robot: the robot.
        joints: the estimated joints.
        kind: that the sensor looks at: hinges or slides.
        name: the sensor's, for messages.
        wanted: names of joints.

    Raises:
        InputError: a joint is not estimated, the closest are named; or there is none of the kind.
    """
    names = [robot.joint_names[j] for j in joints if robot.topology.joint_kind[j] == kind]
    if not names:
        raise InputError(f"sensor {name!r}: no {kind} is estimated")
    for joint in wanted:
        if joint not in names:
            raise unknown_name(f"sensor {name!r}: estimated {'joint' if kind == HINGE else kind}", joint, names)
    return tuple(names.index(joint) for joint in wanted) or tuple(range(len(names)))


__all__ = ["chosen", "columns"]
