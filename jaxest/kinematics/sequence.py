"""The order in which one scan visits a tree; see DESIGN, "The XLA CPU trap".

A scan per chain would compile a program per chain. Instead the joints stand in one row, each branch after the other,
and a few registers remember the state at a branching until its last branch has been started: none for a serial arm,
one for most humanoids and hands. Kinematics take a step per joint; dynamics a step per velocity coordinate, where a
ball or free joint is like a row of hinges and slides at one point.

A gradient computes a step's inner values again (`jax.checkpoint`) rather than read them back from memory: measured,
a quarter of the time for a humanoid of 27 coordinates in batches of 1024.
"""

import functools
import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.kinematics.fold import carriers
from jaxest.kinematics.robot import FREE, NV, Topology

WORLD, PREVIOUS = -2, -1


class Sequence(NamedTuple):
    """One step per joint or per velocity coordinate, parents before children; static and hashable."""

    joint: tuple[int, ...]
    place: tuple[int, ...]
    """Which of its joint's coordinates, from 0; 0 where a step is a whole joint."""
    velocity: tuple[int, ...]
    """Where the (first) coordinate stands in v."""
    source: tuple[int, ...]
    """Where the state before the step is: WORLD, PREVIOUS step, or a register from 0."""
    keep: tuple[int, ...]
    """The register that keeps the state after the step for later branches, or -1."""
    parent: tuple[int, ...]
    """The step before this one on the way to the world, or -1."""
    registers: int
    whole: bool
    """Whether a step is a whole joint."""
    joint_kind: tuple[str, ...]
    joint_q: tuple[int, ...]

    @property
    def kind(self) -> tuple[str, ...]:
        """Kind of each step's joint."""
        return tuple(self.joint_kind[j] for j in self.joint)

    @property
    def opening(self) -> np.ndarray:
        """Whether the step moves into its joint's frame; a free joint first shifts along the world's axes."""
        if self.whole:
            return np.ones(len(self.joint), bool)
        return np.array([p == (3 if k == FREE else 0) for p, k in zip(self.place, self.kind, strict=True)], bool)

    @property
    def closing(self) -> np.ndarray:
        """Whether the step is its joint's last, after which the links that the joint carries move."""
        if self.whole:
            return np.ones(len(self.joint), bool)
        return np.array([p == NV[k] - 1 for p, k in zip(self.place, self.kind, strict=True)], bool)

    @property
    def runs(self) -> tuple[tuple[int, int], ...]:
        """The steps cut into runs (first, end) without branches: each starts from the world or the end of another."""
        cuts = {0} | {i for i, parent in enumerate(self.parent) if parent != i - 1}
        cuts |= {parent + 1 for i, parent in enumerate(self.parent) if parent != i - 1}
        return tuple(itertools.pairwise(sorted(cuts | {len(self.joint)})))

    def part(self, first: int, end: int) -> "Sequence":
        """Return some consecutive steps, whose sources and parents mean nothing."""
        cut = {
            name: getattr(self, name)[first:end] for name in ("joint", "place", "velocity", "source", "keep", "parent")
        }
        return self._replace(**cut)

    @property
    def branches(self) -> bool:
        """Whether some step starts from elsewhere than the previous one."""
        return any(source != PREVIOUS for source in self.source[1:])


@functools.lru_cache(maxsize=64)
def sequence(topology: Topology) -> Sequence:
    """Put a robot's velocity coordinates in an order that a scan can follow.

    Args:
        topology: the robot's.

    Returns:
        The order. The branch that needs most registers comes last, so that few are needed (Sethi and Ullman's rule).
    """
    return _sequence(topology, tuple(range(len(topology.joint_kind))), whole=False)


@functools.lru_cache(maxsize=256)
def joint_sequence(topology: Topology, joints: tuple[int, ...]) -> Sequence:
    """Put joints in an order that a scan can follow, a step per joint.

    Args:
        topology: the robot's.
        joints: those to visit; with each one all before it on the way to the world.

    Returns:
        The order.
    """
    return _sequence(topology, joints, whole=True)


def _sequence(topology: Topology, joints: tuple[int, ...], whole: bool) -> Sequence:
    carried = carriers(topology).joint
    children: dict[int, list[int]] = {j: [] for j in (-1, *joints)}
    for joint in joints:
        children[carried[joint]].append(joint)
    need = dict.fromkeys(joints, 0)
    for joint in reversed(joints):
        children[joint].sort(key=lambda child: need[child])
        *others, last = [need[child] for child in children[joint]] or [0]
        need[joint] = max([last, *(1 + other for other in others)])
    order: list[tuple[int, int, int]] = []  # joint, source, register that keeps it
    waiting = [(joint, WORLD, 0) for joint in reversed(children[-1])]
    while waiting:
        joint, source, level = waiting.pop()
        below = children[joint]
        order.append((joint, source, level if len(below) > 1 else -1))
        starts = [PREVIOUS] + [level] * (len(below) - 1)
        levels = [level + 1] * (len(below) - 1) + [level]
        waiting += reversed(list(zip(below, starts, levels[: len(below)], strict=False)))
    return _steps(topology, carried, order, whole)


def _steps(topology: Topology, carried: tuple[int, ...], order: list[tuple[int, int, int]], whole: bool) -> Sequence:
    rows: list[tuple[int, int, int, int, int, int]] = []
    last: dict[int, int] = {-1: -1}
    for joint, source, keep in order:
        width = 1 if whole else NV[topology.joint_kind[joint]]
        for place in range(width):
            rows.append(
                (
                    joint,
                    place,
                    topology.joint_v[joint] + place,
                    source if place == 0 else PREVIOUS,
                    keep if place == width - 1 else -1,
                    last[carried[joint]] if place == 0 else len(rows) - 1,
                )
            )
        last[joint] = len(rows) - 1
    joints, places, velocities, starts, kept, parents = (tuple(row[k] for row in rows) for k in range(6))
    registers = max(kept, default=-1) + 1
    kinds, addresses = topology.joint_kind, topology.joint_q
    return Sequence(joints, places, velocities, starts, kept, parents, registers, whole, kinds, addresses)


class _Flags(NamedTuple):
    """What a step does with the registers, (n,) bool each; empty where it never happens."""

    world: tuple[np.ndarray, ...]
    previous: tuple[np.ndarray, ...]
    take: tuple[np.ndarray, ...]
    keep: tuple[np.ndarray, ...]


def _flags(order: Sequence) -> _Flags:
    source, keep = np.array(order.source), np.array(order.keep)
    several = order.source.count(WORLD) > 1
    registers = range(order.registers)
    return _Flags(
        (source == WORLD,) if several else (),
        (source == PREVIOUS,) if order.branches else (),
        tuple(source == r for r in registers),
        tuple(keep == r for r in registers),
    )


def _choose(flag: Any, a: Any, b: Any) -> Any:
    return jax.tree.map(lambda x, y: jnp.where(flag, x, y), a, b)


def outward(order: Sequence, step: Callable[[Any, Any], tuple[Any, Any]], world: Any, steps: Any) -> Any:
    """Go through a tree from the world outwards.

    Args:
        order: the steps' order.
        step: maps (state before, a row of `steps`) to (state after, output).
        world: state of the world, a tree of () arrays.
        steps: tree of arrays (n, ...), one row a step.

    Returns:
        The outputs, (n, ...).
    """

    def body(carry: Any, now: Any) -> Any:
        state, kept = carry
        flags, own = now
        for take, register in zip(flags.take, kept, strict=True):
            state = _choose(take, register, state)
        for flag in flags.world:
            state = _choose(flag, world, state)
        state, out = jax.checkpoint(step, prevent_cse=False)(state, own)
        kept = tuple(_choose(keep, state, register) for keep, register in zip(flags.keep, kept, strict=True))
        return (state, kept), out

    return jax.lax.scan(body, (world, (world,) * order.registers), (_flags(order), steps))[1]


def inward(order: Sequence, step: Callable[[Any, Any], tuple[Any, Any]], nothing: Any, steps: Any) -> Any:
    """Go through a tree from its tips inwards, adding up at the branchings.

    Args:
        order: the steps' order.
        step: maps (sum of what the children pass, a row of `steps`) to (what is passed to the parent, output).
        nothing: what a tip receives: zeros.
        steps: tree of arrays (n, ...), one row a step.

    Returns:
        The outputs, (n, ...).
    """

    def body(carry: Any, now: Any) -> Any:
        received, kept = carry
        flags, own = now
        for keep, register in zip(flags.keep, kept, strict=True):
            received = jax.tree.map(jnp.add, received, _choose(keep, register, nothing))
        passed, out = jax.checkpoint(step, prevent_cse=False)(received, own)
        kept = tuple(
            jax.tree.map(jnp.add, _choose(take, passed, nothing), _choose(keep, nothing, register))
            for keep, take, register in zip(flags.keep, flags.take, kept, strict=True)
        )
        for flag in flags.previous:
            passed = _choose(flag, passed, nothing)
        return (passed, kept), out

    carry = (nothing, (nothing,) * order.registers)
    return jax.lax.scan(body, carry, (_flags(order), steps), reverse=True)[1]
