"""Which joints matter for the frames that are asked for, and which step of one scan carries each frame."""

from collections.abc import Sequence as List
from typing import NamedTuple

import numpy as np

from jaxest.kinematics.fold import Folded, carriers
from jaxest.kinematics.robot import Robot, is_concrete
from jaxest.kinematics.sequence import Sequence, joint_sequence

SEVERAL = 12
"""Up to this many runs without branches are a scan each: quicker to run, as nothing is remembered at the branchings and
only the poses that are asked for are stored, but every scan compiles for about 0.1 s."""


class Plan(NamedTuple):
    """How to compute certain frames of a certain robot; static and hashable, an argument of jitted functions."""

    order: Sequence
    """The joints that move any of the frames, a step each."""
    kept: tuple[int, ...]
    """The steps whose poses are computed for good."""
    frames: tuple[int, ...]
    rows: tuple[int, ...]
    """Where in `kept` the joint of each frame stands, -1 for the world."""
    moved: tuple[bool, ...]
    """Whether each frame is not its joint's frame itself."""
    stacked: bool = False
    """Whether the components of each pose are stored together."""

    def whole(self) -> "Plan":
        """Return the same plan with the pose of every joint kept, by component."""
        every = tuple(range(len(self.order.joint)))
        return self._replace(
            kept=every, stacked=False, rows=tuple(row if row < 0 else self.kept[row] for row in self.rows)
        )

    @property
    def runs(self) -> tuple[tuple[int, int], ...]:
        """The steps (first, end) of each scan."""
        runs = self.order.runs
        return runs if len(runs) <= SEVERAL else ((0, len(self.order.joint)),)


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
    moved = tuple(_moved(folded)[list(frames)].tolist())
    whole = Plan(order, tuple(range(len(order.joint))), tuple(frames), steps, moved)
    kept: list[int] = []
    for first, end in whole.runs:
        needed = {s for s in steps if first <= s < end}
        kept += [end - 1] * len(needed) if needed <= {end - 1} else range(first, end)
    place = {s: row for row, s in enumerate(kept)}
    return whole._replace(kept=tuple(kept), rows=tuple(place.get(s, -1) for s in steps))


def _moved(folded: Folded) -> np.ndarray:
    """Tell which frames are known to be their joint's frame (False) or not (True)."""
    translation, quaternion = folded.frame_translation, folded.frame_quaternion
    if not is_concrete(translation, quaternion):
        return np.ones(translation.shape[0], bool)
    return np.any(np.asarray(translation) != 0, axis=-1) | np.any(np.asarray(quaternion) != (1, 0, 0, 0), axis=-1)
