"""Aliases, status codes and the contracts that every estimator keeps.

A measurement is a NamedTuple whose fields are `Reading`s and `dt`, the time since the previous step in seconds. A
`Step` maps `(params, state, measurement)` to `(state, info)`; `jaxest.filters.run` scans it. A `System` bundles what
is needed to use an estimator on one robot.
"""

import difflib
from collections.abc import Iterable
from typing import Any, NamedTuple, Protocol

import jax
from jax.typing import ArrayLike

Array = jax.Array
PyTree = Any

OK = 0
NON_FINITE = 1
WEIGHTS_VANISHED = 2
NOT_CONVERGED = 3
OUT_OF_RANGE = 4
LOST = 5
UNSEEN = 6
FULL = 7
FOLLOWS = 8

_MESSAGES = {
    OK: "ok",
    NON_FINITE: "a valid measurement was not finite, or time ran backwards; it was left out",
    WEIGHTS_VANISHED: "all particle weights vanished; the weights were reset to uniform",
    NOT_CONVERGED: "the iteration stopped before it converged",
    OUT_OF_RANGE: "numbers outgrew the precision; the step was not taken",
    LOST: "what the sensors see contradicts the map; the pose must not be relied on",
    UNSEEN: "the link has no sensors; it follows its joints",
    FULL: "the map is full; points found no room in it",
    FOLLOWS: "too few points fit the map; the link keeps its prediction",
}


def status_message(status: int) -> str:
    """Return what a `status` in an estimator's info means.

    Args:
        status: code, one of `OK`, `NON_FINITE`, `WEIGHTS_VANISHED`, `NOT_CONVERGED`, `OUT_OF_RANGE`, and of whole-body
            SLAM `LOST`, `UNSEEN`, `FULL` and `FOLLOWS`.

    Returns:
        One sentence in plain English.

    Raises:
        ValueError: the code is unknown.
    """
    if int(status) not in _MESSAGES:
        raise ValueError(f"status: unknown code {int(status)}, expected one of {sorted(_MESSAGES)}")
    return _MESSAGES[int(status)]


class InputError(ValueError):
    """Bad input from a person or a file; the message names the place, what was found and what was expected."""


def listed(names: Iterable[str], most: int = 20) -> str:
    """Join names for a message, the first few of many.

    Args:
        names: any number of them.
        most: how many are written out.

    Returns:
        `a, b, c and 97 more`, or `none`.
    """
    known = list(names)
    more = f" and {len(known) - most} more" if len(known) > most else ""
    return (", ".join(known[:most]) or "none") + more


def unknown_name(kind: str, name: str, known: Iterable[str]) -> InputError:
    """Build the error for a name that does not exist, with the closest existing ones.

    Args:
        kind: what is named, for example `"frame"` or `"stream"`.
        name: the name that was asked for.
        known: the names that exist.

    Returns:
        The error, to be raised by the caller.
    """
    names = list(known)
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(map(repr, close))}?" if close else f"known: {listed(names)}"
    return InputError(f"{kind} {name!r} does not exist; {hint}")


class Reading(NamedTuple):
    """One sensor's value at one step, and whether it is there at all."""

    value: Array
    """(...) in the sensor's SI unit; any finite number where invalid."""
    valid: Array
    """() bool, or one per zone of a ranging sensor."""


class Step(Protocol):
    """One step of an estimator: a pure function, the same under jit, vmap, scan and grad."""

    def __call__(
        self, params: PyTree, state: PyTree, measurement: PyTree, *, key: Array | None = None
    ) -> tuple[PyTree, PyTree]:
        """Return the next state and the info of this step; `key` is the key of the whole run."""
        ...


class Reducer(Protocol):
    """Decides what `run` keeps: called with every step's `(state, info)`, returns what is stacked for that step."""

    def __call__(self, state: PyTree, info: PyTree) -> PyTree:
        """Return the part to keep."""
        ...


class Init(Protocol):
    """Builds the state that has seen no data."""

    def __call__(self, params: PyTree, *, key: Array | None = None) -> PyTree:
        """Return `state0`."""
        ...


class Simulate(Protocol):
    """Draws measurements and the truth they come from."""

    def __call__(self, params: PyTree, *, key: Array, **options: Any) -> tuple[PyTree, PyTree]:
        """Return `(measurements, truth)`, both with a leading time axis."""
        ...


class System(NamedTuple):
    """An estimator for one robot and one set of sensors, as `jaxest.systems.NAME.build` returns it."""

    default_params: PyTree
    init: Init
    step: Step
    simulate: Simulate


__all__ = [
    "FOLLOWS",
    "FULL",
    "LOST",
    "NON_FINITE",
    "NOT_CONVERGED",
    "OK",
    "OUT_OF_RANGE",
    "UNSEEN",
    "WEIGHTS_VANISHED",
    "Array",
    "ArrayLike",
    "Init",
    "InputError",
    "PyTree",
    "Reading",
    "Reducer",
    "Simulate",
    "Step",
    "System",
    "listed",
    "status_message",
    "unknown_name",
]
