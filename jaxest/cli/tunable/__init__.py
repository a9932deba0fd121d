"""What `jaxest tune` can tune, one file a method: how logs and a config become an objective and free parameters.

A tunable is a module with `prepare(sources, request, goal, free) -> Tunable`, named in `TUNABLE` and loaded when asked
for.
"""

import importlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxest.cli.methods import METHODS, Request
from jaxest.io import SensorLog
from jaxest.types import InputError, unknown_name

TUNABLE = {name: f"jaxest.cli.tunable.{name}" for name in ("orientation", "deflection", "onsite", "torque")}
"""Name of a method, and the module that tunes it."""
GOALS = ("error", "likelihood", "consistency", "relaxed")


class Source(NamedTuple):
    """A log to tune on, and the one that holds its truth, which may be the same."""

    log: SensorLog
    truth: SensorLog | None


class Tunable(NamedTuple):
    """A tuning that can start."""

    objective: Any
    """A `jaxest.tuning.Objective`."""
    space: Any
    """A `jaxest.tuning.Space`."""
    recordings: list[Any]
    """`jaxest.tuning.Recording`, one a log."""
    label: str
    """What the objective is, for people."""
    unit: str
    scale: float
    """From the objective to that unit."""
    method: Any
    """A `jaxest.tuning.Method`."""
    windows: Any
    """`jaxest.tuning.Windows`, or None."""
    settings: Callable[[Any], dict[str, Any]]
    """`params -> ` the config's table of the method, tuned."""
    dtype: Any
    identity: Any = ()
    """A tree of all that it depends on beside code, logs and what is free: method, objective, config and robot."""


def known(method: str) -> None:
    """Refuse a method that cannot be tuned.

    Args:
        method: as typed.

    Raises:
        InputError: there is no such method, or it has no tuning.
    """
    if method in METHODS and method not in TUNABLE:
        *others, last = TUNABLE
        raise InputError(f"the method {method!r} cannot be tuned, expected {', '.join(others)} or {last}")
    if method not in TUNABLE:
        raise unknown_name("method", method, TUNABLE)


def prepare(
    method: str, sources: Sequence[Source], request: Request, goal: str, free: Mapping[str, str | None]
) -> Tunable:
    """Prepare the tuning of a method.

    Args:
        method: one of `TUNABLE`.
        sources: the logs.
        request: the robot and the config's table.
        goal: one of `GOALS`, or empty for what fits the method and the logs.
        free: path -> name of a constraint, or None for the usual one; empty for the method's own choice.

    Returns:
        The tuning.

    Raises:
        InputError: a name is unknown, or the logs cannot be used.
    """
    known(method)
    if goal and goal not in GOALS:
        raise unknown_name("objective", goal, GOALS)
    found = importlib.import_module(TUNABLE[method]).prepare(sources, request, goal, free)
    return found._replace(identity=(method, goal, request.settings, _robot(request.robot)))


def _robot(path: Path | None) -> Any:
    """A robot's numbers and what hangs on what, also of files that its own names."""
    if path is None:
        return None
    from jaxest import kinematics

    robot = kinematics.load(path)
    return robot, repr(robot.topology)


def constrained(free: Mapping[str, str | None], default: Mapping[str, str] | Sequence[str]) -> dict[str, Any]:
    """Turn names of constraints into constraints; where nothing is said, those of a method's own choice."""
    from jaxest.tuning import transforms

    free = free or (default if isinstance(default, Mapping) else dict.fromkeys(default))
    return {path: None if name is None else transforms.named(name) for path, name in free.items()}


def plain(value: Any) -> Any:
    """Return a parameter as a config writes it: numbers of six digits, in lists."""
    import numpy as np

    array = np.asarray(value, float)
    return float(f"{float(array):.6g}") if array.shape == () else [plain(entry) for entry in array]


def refuse_goal(method: str, goal: str, possible: str) -> InputError:
    """Build the error for an objective that a method does not have."""
    return InputError(f"--objective {goal}: the method {method!r} is tuned by {possible}")


__all__ = ["GOALS", "TUNABLE", "Source", "Tunable", "constrained", "known", "plain", "prepare", "refuse_goal"]
