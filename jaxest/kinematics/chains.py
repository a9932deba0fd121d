"""Cutting a robot's joints into chains, each one scan; see DESIGN, "The XLA CPU trap".

A plan says, for the frames that are asked for, which joints matter, how they form chains, and how the frames are
assembled from the chains' poses. It is static and hashable, so that it can be an argument of a jitted function.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxest.kinematics.fold import Carriers, Folded, carriers
from jaxest.kinematics.robot import BALL, FREE, SLIDE, Robot, is_concrete


class Chain(NamedTuple):
    """A run of joints without branches: scalar ones (hinges, slides) or those with a quaternion (balls, free)."""

    joints: tuple[int, ...]
    parent: int
    """The chain whose last joint carries this one, -1 for the world."""
    scalar: bool
    slides: bool
    """Whether a scalar chain has slides."""
    every: bool
    """Whether the pose of every joint is needed, or of the last one only."""


class Block(NamedTuple):
    """Consecutive frames that one chain carries."""

    chain: int
    """-1 for the world."""
    frames: tuple[int, ...]
    places: tuple[int, ...]
    """Position in the chain of each frame's joint."""
    moved: bool
    """Whether any of the frames is not the joint's frame itself."""


class Plan(NamedTuple):
    """How to compute certain frames of a certain robot."""

    chains: tuple[Chain, ...]
    blocks: tuple[Block, ...]
    joint_q: tuple[int, ...]
    joint_v: tuple[int, ...]
    joint_kind: tuple[str, ...]

    def whole(self) -> "Plan":
        """Return the same plan with the pose of every joint kept."""
        return self._replace(chains=tuple(chain._replace(every=True) for chain in self.chains))


def plan(robot: Robot, frames: Sequence[int], folded: Folded) -> Plan:
    """Plan the computation of some frames.

    Args:
        robot: the robot; only its topology is used.
        frames: indices of frames, in the order in which they are returned.
        folded: its folded offsets; frames known to sit on their joint need no further transform.

    Returns:
        The plan.
    """
    topology = robot.topology
    carried = carriers(topology)
    needed = _ancestors(carried, {carried.frame[f] for f in frames})
    chains = _cut(topology.joint_kind, carried, needed)
    place = {joint: (i, k) for i, chain in enumerate(chains) for k, joint in enumerate(chain.joints)}
    blocks = _blocks(frames, [place.get(carried.frame[f], (-1, 0)) for f in frames], _moved(folded))
    inner = {b.chain for b in blocks if b.chain >= 0 and min(b.places) < len(chains[b.chain].joints) - 1}
    kept = tuple(chain._replace(every=i in inner) for i, chain in enumerate(chains))
    return Plan(kept, blocks, topology.joint_q, topology.joint_v, topology.joint_kind)


def _ancestors(carried: Carriers, joints: set[int]) -> list[int]:
    found: set[int] = set()
    for start in joints:
        joint = start
        while joint >= 0 and joint not in found:
            found.add(joint)
            joint = carried.joint[joint]
    return sorted(found)


def _cut(kinds: tuple[str, ...], carried: Carriers, needed: list[int]) -> list[Chain]:
    children = {joint: [k for k in needed if carried.joint[k] == joint] for joint in needed}
    chains: list[Chain] = []
    chain_of: dict[int, int] = {}
    for start in needed:
        if start in chain_of:
            continue
        joints = [start]
        scalar = kinds[start] not in (BALL, FREE)
        while len(children[joints[-1]]) == 1:
            (following,) = children[joints[-1]]
            if (kinds[following] not in (BALL, FREE)) != scalar:
                break
            joints.append(following)
        parent = carried.joint[start]
        slides = any(kinds[joint] == SLIDE for joint in joints)
        chains.append(Chain(tuple(joints), chain_of.get(parent, -1), scalar, slides, False))
        chain_of |= dict.fromkeys(joints, len(chains) - 1)
    return chains


def _moved(folded: Folded) -> np.ndarray:
    """Tell which frames are known to be their joint's frame (False) or not (True)."""
    translation, quaternion = folded.frame_translation, folded.frame_quaternion
    if not is_concrete(translation, quaternion):
        return np.ones(translation.shape[0], bool)
    return np.any(np.asarray(translation) != 0, axis=-1) | np.any(np.asarray(quaternion) != (1, 0, 0, 0), axis=-1)


def _blocks(frames: Sequence[int], places: list[tuple[int, int]], moved: np.ndarray) -> tuple[Block, ...]:
    blocks: list[Block] = []
    for frame, (chain, place) in zip(frames, places, strict=True):
        last = blocks[-1] if blocks else None
        if last is not None and last.chain == chain and last.moved == moved[frame]:
            blocks[-1] = last._replace(frames=(*last.frames, frame), places=(*last.places, place))
        else:
            blocks.append(Block(chain, (frame,), (place,), bool(moved[frame])))
    return tuple(blocks)
