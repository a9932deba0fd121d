"""How time grows with size: particles, joints, robots, IMU pairs, map points, links, chains; with fitted exponents."""

import math
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import jax
import numpy as np

from jaxest.bench.harness import Candidate, Progress, race
from jaxest.bench.scaling_cases import Curve, curves
from jaxest.io.report import Row
from jaxest.types import unknown_name

METRIC, EXPONENT, FIRST = "time against ", "exponent of ", "first call, "
SECONDS = 8.0
"""Of timed calls, after which a curve is not continued; what compiles and makes the data is not counted."""


def rows(
    *,
    peers: bool,
    progress: Progress,
    small: bool = False,
    only: Sequence[str] = (),
    seconds: float = SECONDS,
    last: int = 0,
) -> Iterable[Row]:
    """Time one call at each size, by itself and compiled, and fit the exponent over the larger half of the sizes.

    Args:
        peers: whether to run SciPy's tree beside the map.
        progress: hears what is being measured.
        small: two sizes of each, and only of what compiles quickly.
        only: what is to be counted, as in the rows; everything if empty.
        last: only so many of a curve's sizes, the largest; all if 0.
        seconds: a curve ends where the calls of its next size would take it beyond that; it has two sizes at least.

    Yields:
        Times of calls, first calls with their compiling, and exponents with the standard error of the fit: 1 is a time
        that grows as the size does.

    Raises:
        InputError: `only` has a name that no curve has.
    """
    studies = curves(small, peers)
    names = [curve.item for curve in studies]
    for name in only:
        if name not in names:
            raise unknown_name("curve", name, names)
    for curve in studies:
        if not only or curve.item in only:
            yield from _one(curve._replace(sizes=curve.sizes[-last:]), progress, 2 if small else 5, seconds)


def _one(curve: Curve, progress: Progress, most: int, seconds: float) -> Iterable[Row]:
    spent = 0.0
    sizes: list[int] = []
    values: list[float] = []
    for size in curve.sizes:
        growth = size / sizes[-1] if sizes else 1.0
        expected = most * growth * values[-1] if values else 0.0
        if len(sizes) > 1 and spent + expected > seconds:
            break
        progress(f"{size} {curve.item}")
        start = time.perf_counter()
        program = curve.build(size)
        jax.block_until_ready(program.call())
        ready = time.perf_counter() - start
        other = curve.beside(size)
        candidates = [Candidate("ours", program.call), *([] if other is None else [Candidate(curve.peer, other)])]
        start = time.perf_counter()
        found = race(candidates, repeats=most)
        spent += time.perf_counter() - start
        ours, beside = found["ours"], found.get(curve.peer)
        sizes, values = [*sizes, size], [*values, ours.median]
        yield Row(METRIC + curve.item, f"{size}: {curve.what}", 1e6 * ours.median, "us", 1e6 * ours.spread,
                  len(ours.seconds), None if beside is None else 1e6 * beside.median, curve.peer or None,
                  None if beside is None else float(np.median(beside.seconds / ours.seconds)))  # fmt: skip
        if len(sizes) == 1:
            yield Row(FIRST + curve.item, f"{size}, with its data, tracing and compiling", ready, "s")
    slope, error = exponent(sizes, values)
    first = _first(sizes)
    yield Row(EXPONENT + curve.item, f"from {sizes[first]} on", slope, "1", error, len(sizes) - first)


def exponent(sizes: Sequence[int], values: Sequence[float]) -> tuple[float, float | None]:
    """Return the slope of log time by log size over the larger half, and its standard error where it has one."""
    first = _first(sizes)
    x, y = np.log(np.asarray(sizes[first:], float)), np.log(np.asarray(values[first:], float))
    x = x - x.mean()
    slope = float(x @ y / (x @ x))
    rest = y - y.mean() - slope * x
    return slope, math.sqrt(rest @ rest / (len(x) - 2) / (x @ x)) if len(x) > 2 else None


def _first(sizes: Sequence[int]) -> int:
    """Place of the first size that is fitted."""
    return len(sizes) // 2 if len(sizes) > 2 else 0


def draw(path: Path, found: Iterable[Row]) -> None:
    """Draw the curves of these rows and write the picture."""
    from jaxest.viz import scaling

    series: dict[str, list[tuple[int, float]]] = {}
    slopes: dict[str, float] = {}
    for row in found:
        if row.value is not None and row.metric.startswith(METRIC):
            size = int(row.condition.split(":")[0])
            series.setdefault(row.metric.removeprefix(METRIC), []).append((size, row.value))
        elif row.value is not None and row.metric.startswith(EXPONENT):
            slopes[row.metric.removeprefix(EXPONENT)] = row.value
    scaling.draw(path, series, slopes)


__all__ = ["draw", "exponent", "rows"]
