"""Which joints matter for the frames that are asked for, and which step of one scan carries each frame."""

from collections.abc import Sequence as List
from typing import NamedTuple

import numpy as np

from jaxest.kinematics.fold import Folded, carriers
from jaxest.kinematics.robot import Robot, is_concrete
from jaxest.kinematics.sequence import Sequence, joint_sequence


class Plan(NamedTuple):
    """How to compute certain frames of a certain robot; static and hashable, an argument of jitted functions."""

    order: Sequence
    """The joints that move any of the frames, a step each."""
    frames: tuple[int, ...]
    steps: tuple[int, ...]
    """The step whose joint carries each frame, -1 for the world."""
    moved: tuple[bool, ...]
    """Whether each frame is not its joint's frame itself."""
    every: bool
    """Whether the pose of every joint is needed, or of the last one only."""

    def whole(self) -> "Plan":
        """Return the same plan with the pose of every joint kept."""
        return self._replace(every=True)


def plan(robot: Robot, frames: List[int], folded: Folded) -> Plan:
    """Plan the computation of some frames.

    Args:
        robot: the robot; only its topology is used.
        frames: indices of frames, in the order in which they are returned.
        folded: its folded offsets; frames known to sit on their joint need no further transform.

    Returns:
        The plan.
    """
    carried = carriers(robot.topology)
    joints: set[int] = set()
    for frame in frames:
        joint = carried.frame[frame]
        while joint >= 0 and joint not in joints:
            joints.add(joint)
            joint = carried.joint[joint]
    order = joint_sequence(robot.topology, tuple(sorted(joints)))
    step = {joint: i for i, joint in enumerate(order.joint)}
    steps = tuple(step.get(carried.frame[f], -1) for f in frames)
    tip = len(order.joint) - 1
    serial = not order.branches and all(step == tip for step in steps)
    moved = tuple(_moved(folded)[list(frames)].tolist())
    return Plan(order, tuple(frames), steps, moved, not serial)


def _moved(folded: Folded) -> np.ndarray:
    """Tell which frames are known to be their joint's frame (False) or not (True)."""
    translation, quaternion = folded.frame_translation, folded.frame_quaternion
    if not is_concrete(translation, quaternion):
        return np.ones(translation.shape[0], bool)
    return np.any(np.asarray(translation) != 0, axis=-1) | np.any(np.asarray(quaternion) != (1, 0, 0, 0), axis=-1)
