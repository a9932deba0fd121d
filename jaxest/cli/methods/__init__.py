"""The methods of `jaxest estimate`, one file each: which streams they need, and how a log becomes an estimate.

A method is a module with `schema() -> dict` (its table of a config) and `estimate(log, request) -> Outcome`, named in
`METHODS` and loaded when it is asked for; one that writes files of its own beside the estimate names them by
`files(settings) -> names`.
"""

import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jaxest.io import SensorLog
from jaxest.io.report import Row
from jaxest.types import InputError, unknown_name

METHODS = {
    "orientation": "jaxest.cli.methods.orientation",
    "deflection": "jaxest.cli.methods.deflection",
    "onsite": "jaxest.cli.methods.onsite",
    "posture": "jaxest.cli.methods.posture",
    "torque": "jaxest.cli.methods.torque",
    "slam": "jaxest.cli.methods.slam",
}
"""Name of a method, and the module that holds it."""
PIECES = ("torque",)
"""Methods that run in pieces and can go on from the last one."""
ROBOTLESS = ("orientation", "onsite")
"""Methods that need no robot."""
CHOOSING = ("orientation",)
"""Methods whose sensors may be chosen by kind; the others' are those that their table of the config names."""

SIZE = ("samples", "duration")
"""Metrics of the first two rows of every outcome."""


class Request(NamedTuple):
    """What a person asks of a method, beside the log."""

    settings: Mapping[str, Any] = {}
    """the config's table of the method's name"""
    sensors: tuple[str, ...] | None = None
    """kinds of stream to use, for methods of `CHOOSING`; None leaves the choice to the config, then to the log"""
    nan: str = "error"
    """`error`, or `missing` where values that are not finite count as missing samples"""
    robot: Path | None = None
    """file of the robot, for methods that need one"""
    work: Path | None = None
    """folder that keeps finished pieces of a long run, for methods of `PIECES`; kept nowhere if None"""
    say: Callable[[str], None] = lambda message: None
    """told how far it is"""


class Outcome(NamedTuple):
    """What a method makes of a log."""

    estimate: SensorLog
    """streams to be written"""
    rows: list[Row]
    """figures to print and to report, the first two those of `SIZE`"""
    notes: list[str]
    """what was chosen, one sentence each"""
    refused: list[str]
    """why the result must not be used; empty where it may"""
    draw: Callable[[Path, str], None] | None
    """writes a picture with a title, if there is one to draw"""
    files: Mapping[str, str | bytes] = {}
    """texts and other contents to be written beside the estimate, by the name of the file"""


def estimate(method: str, log: SensorLog, request: Request) -> Outcome:
    """Run a method on a log.

    Args:
        method: one of `METHODS`.
        log: the log, windowed already.
        request: settings.

    Returns:
        The outcome.

    Raises:
        InputError: an unknown method, an option that it does not have, or a log that it cannot use.
    """
    if method not in METHODS:
        raise unknown_name("method", method, METHODS)
    if request.work is not None and method not in PIECES:
        raise InputError(f"--work: the method {method!r} keeps no pieces; {', '.join(PIECES)} does")
    if request.robot is not None and method in ROBOTLESS:
        raise InputError(f"--robot {request.robot}: the method {method!r} knows no robot, expected none; leave it out")
    if request.sensors is not None and method not in CHOOSING:
        raise InputError(
            f"--sensors: the method {method!r} uses the sensors that [{method}] names in a config, expected no others; "
            "leave it out"
        )
    return importlib.import_module(METHODS[method]).estimate(log, request)


def files(method: str, settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the files that a method will write beside the estimate under a config's settings."""
    module = importlib.import_module(METHODS[method])
    found: tuple[str, ...] = module.files(settings) if hasattr(module, "files") else ()
    return found


def size(rows: list[Row]) -> str:
    """Say how long the log was, from the first rows of an outcome."""
    samples, duration = (row.value or 0.0 for row in rows[: len(SIZE)])
    return f"{samples:.0f} samples in {duration:.1f} s"


__all__ = ["CHOOSING", "METHODS", "PIECES", "ROBOTLESS", "SIZE", "Outcome", "Request", "estimate", "files", "size"]
