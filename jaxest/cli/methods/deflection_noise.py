"""What `--method deflection` says of the noise that its config gives the sensors."""

from collections.abc import Sequence
from typing import Any

from jaxest.cli.methods.deflection_config import Described, place
from jaxest.io.report import Row

FACTOR = 3.0
"""How many times too much or too little scatter is told: bands are wrong by about as much."""
SPARE, ENOUGH = 0.05, 100.0
"""Share of a sensor's readings, and how many of them, that the estimate must not simply follow for a word on it."""
PRECISIONS, VARIANCES = ("concentration", "lam"), ("variance",)


def judged(described: Sequence[Described], scattered: Any) -> tuple[list[Row], list[str]]:
    """Compare the sensors' scatter with their noise.

    Args:
        described: the sensors.
        scattered: theirs, a `jaxest.systems.deflection_scatter.Scatter`.

    Returns:
        A row for each sensor of which there is enough, and a sentence for each whose noise is far off.
    """
    rows, said = [], []
    for one, ratio, spare, readings in zip(described, *scattered, strict=True):
        if spare < max(SPARE * readings, ENOUGH):
            continue
        rows.append(Row("scatter over what its noise says", one.sensor.name, float(ratio), "1", n=int(spare)))
        if not 1 / FACTOR <= ratio <= FACTOR:
            said.append(_sentence(one, float(ratio)))
    return rows, said


def _sentence(one: Described, ratio: float) -> str:
    from jaxest.sensors import KINDS

    fields = _fields(KINDS[one.sensor.kind].Params())
    square = max(ratio * ratio, 1e-12)
    advice = [f"{key} {1 / square:.2g} times as large" for key in PRECISIONS if key in fields]
    advice += [f"{key} {square:.2g} times as large" for key in VARIANCES if key in fields]
    wrong = "narrow" if ratio > 1 else "wide"
    return (
        f"{place(one.sensor.name)} scatters {ratio:.2g} times as much as its noise says, so the 95 % bands are too "
        f"{wrong}; where it always does, take {' and '.join(advice)}"
    )


def _fields(params: Any) -> set[str]:
    """Names of parameters, those of parts of a sensor too."""
    found = set(params._fields)
    for part in params:
        found |= _fields(part) if hasattr(part, "_fields") else set()
    return found


__all__ = ["judged"]
