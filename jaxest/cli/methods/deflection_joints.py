"""The joints that a method estimates: their names, units and kinds; and the streams of `--method deflection`."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.io import Stream

KINDS = {"hinge": ("joints", "rad", "deg", np.rad2deg(1.0)), "slide": ("slides", "m", "mm", 1e3)}
"""By kind: the stream's name, its unit, that of tables, and how many of that are one of the stream's."""


class Joints(NamedTuple):
    """The estimated joints; of a deflection hinges first, then slides, then balls."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    """Of each."""

    def of(self, *kinds: str) -> tuple[str, ...]:
        """Return the names of those of some kinds."""
        return tuple(name for name, kind in zip(self.names, self.kinds, strict=True) if kind in kinds)

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names of those with one number, an angle or a way."""
        return self.of(*KINDS)

    @property
    def size(self) -> int:
        """Coordinates of a tangent vector, three for each ball."""
        return len(self.names) + 2 * len(self.of("ball"))

    @property
    def hinges(self) -> NDArray[np.bool_]:
        """(c,) which of `numbers` are angles."""
        return np.array([kind == "hinge" for kind in self.kinds if kind in KINDS], bool)

    @property
    def coordinates(self) -> tuple[tuple[str, str, float], ...]:
        """(d,) name, unit in tables, and how many of that are one of the estimate's, of each tangent coordinate."""
        found = []
        for name, kind in zip(self.names, self.kinds, strict=True):
            _, _, unit, scale = KINDS.get(kind, KINDS["hinge"])
            found += [(label, unit, scale) for label in ([f"{name} {a}" for a in "xyz"] if kind == "ball" else [name])]
        return tuple(found)


def chosen(robot: Any, settings: Mapping[str, Any]) -> Joints:
    """Return the joints that are estimated; raises InputError for a name that does not exist."""
    from jaxest.sensors.joints import chosen as look_up

    numbers, _ = look_up(robot, settings.get("joints"))
    topology = robot.topology
    return Joints(tuple(robot.joint_names[j] for j in numbers), tuple(topology.joint_kind[j] for j in numbers))


def streams(joints: Joints, time: NDArray[np.float64], found: Any) -> dict[str, Stream]:
    """Return an estimate as streams.

    Args:
        joints: the joints.
        time: (T,) s.
        found: `deflection.Estimated`.

    Returns:
        `joints` and `slides`, where there are such, each with `_covariance`, `_lower` and `_upper` (95 %); for each
        ball `NAME/orientation` (wxyz, child to parent) with its covariance about its own axes.
    """
    meta = {"kinematics": "effective: a rigid robot with these coordinates stands as the real one does"}
    written, first = {}, 0
    for kind, (label, unit, _, _) in KINDS.items():
        names = joints.of(kind)
        run = slice(first, first + len(names))
        first = run.stop
        if not names:
            continue
        written[label] = Stream(time, found.mean[:, run], unit, names=names, extra=meta)
        written[f"{label}_covariance"] = Stream(time, found.covariance[:, run, run], f"{unit}2", names=names)
        for end in ("lower", "upper"):
            value = found.mean[:, run] + getattr(found, end)[:, run]
            written[f"{label}_{end}"] = Stream(time, value, unit, names=names, extra={"probability": 0.95})
    for i, name in enumerate(joints.of("ball")):
        run = slice(first + 3 * i, first + 3 * i + 3)
        written[f"{name}/orientation"] = Stream(time, found.balls[:, i], "1", extra={"order": "wxyz", **meta})
        written[f"{name}/orientation_covariance"] = Stream(time, found.covariance[:, run, run], "rad2")
    return written


def away(joints: Joints, one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return one less another's coordinates (T, c): angles on the circle, ways as they are."""
    from jaxest.metrics import circular_error

    return np.where(joints.hinges, circular_error(one, other), one - other)


__all__ = ["KINDS", "Joints", "away", "chosen", "streams"]
