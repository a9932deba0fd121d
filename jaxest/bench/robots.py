"""The robots that benchmarks are run on, with a batch of states each, and Pinocchio's reading of them."""

import contextlib
import io
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxest import kinematics, models
from jaxest.bench.harness import find_peer
from jaxest.kinematics.fold import carriers
from jaxest.kinematics.load import compile_model


class Subject(NamedTuple):
    """A robot to be timed, and a batch of states."""

    name: str
    source: str | Path
    robot: kinematics.Robot
    model: Any
    """compiled by MuJoCo"""
    pinocchio: Any
    """Pinocchio's model, or None"""
    q: np.ndarray
    """(batch, nq) float64"""
    v: np.ndarray
    """(batch, nv)"""
    tau: np.ndarray
    """(batch, nv)"""


def subjects(chains: Sequence[int], packaged: bool, files: Sequence[str], batch: int, peers: bool) -> Iterator[Subject]:
    """Load robots, one at a time.

    Args:
        chains: numbers of joints of serial arms.
        packaged: whether the packaged robots follow.
        files: MJCF or URDF files that come last.
        batch: number of states of each.
        peers: whether Pinocchio reads them, too.

    Yields:
        Each robot with its states.
    """
    for joints in chains:
        yield subject(f"chain of {joints}", models.chain(joints), batch, peers)
    for name in models.names() if packaged else ():
        yield subject(name, models.path(name), batch, peers)
    for file in files:
        yield subject(Path(file).name, file, batch, peers)


def subject(name: str, source: str | Path, batch: int, peers: bool) -> Subject:
    """Load a robot and draw states, coordinates, velocities and torques even in [-2, 2].

    Args:
        name: what rows call it.
        source: MJCF or URDF file, or its text.
        batch: number of states.
        peers: whether Pinocchio reads it, too.

    Returns:
        The robot and its states.
    """
    robot, model = kinematics.load(source), compile_model(source)
    rng = np.random.default_rng(0)
    q = rng.uniform(-2, 2, (batch, robot.nq))
    v, tau = rng.uniform(-2, 2, (2, batch, robot.nv))
    return Subject(name, source, robot, model, pinocchio_model(source, robot) if peers else None, q, v, tau)


def pinocchio_model(source: str | Path, robot: kinematics.Robot) -> Any:
    """Read a robot with Pinocchio.

    Args:
        source: MJCF or URDF file, or its text.
        robot: the same as jaxest reads it.

    Returns:
        Pinocchio's model; None where it is not installed or reads another robot from the file.
    """
    pinocchio = find_peer("pinocchio")
    if pinocchio is None:
        return None
    # Its parsers raise whatever they like.
    with contextlib.suppress(Exception), contextlib.redirect_stderr(io.StringIO()), tempfile.TemporaryDirectory() as at:
        if str(source).lstrip().startswith("<"):
            file = Path(at) / "robot.xml"
            file.write_text(str(source))
            source = file
        urdf = str(source).endswith(".urdf")
        model = (pinocchio.buildModelFromUrdf if urdf else pinocchio.buildModelFromMJCF)(str(source))
        return model if (model.nq, model.nv) == (robot.nq, robot.nv) else None
    return None


def joints_above(robot: kinematics.Robot) -> list[tuple[int, ...]]:
    """Return the joints between each body and the world, the nearest first.

    Args:
        robot: the robot.
    """
    carried = carriers(robot.topology)
    above: list[tuple[int, ...]] = []
    for joint in carried.frame[: len(robot.topology.body_names)]:
        path = []
        while joint >= 0:
            path.append(joint)
            joint = carried.joint[joint]
        above.append(tuple(path))
    return above


def tips(robot: kinematics.Robot, least: int = 6) -> list[str]:
    """Name the last body of each arm: the one with most joints before it, then the next that shares none of them.

    Args:
        robot: the robot.
        least: joints that make an arm; the first counts whatever it has.

    Returns:
        Names of bodies.
    """
    above = joints_above(robot)
    found: list[int] = []
    taken: set[int] = set()
    while True:
        free = [body for body, joints in enumerate(above) if joints and not taken & set(joints)]
        # The last of equals, farthest out: bodies come in depth-first order.
        best = max(free, key=lambda body: (len(above[body]), body), default=None)
        if best is None or (found and len(above[best]) < least):
            return [robot.topology.body_names[body] for body in found]
        found.append(best)
        taken |= set(above[best])
