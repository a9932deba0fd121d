"""Timing that holds on a small and noisy machine: warm, blocked, interleaved, medians with their spread.

All candidates of a comparison run in one process, one after the other within each round, so that a busy neighbour
slows them alike; the ratio is the median of the rounds' ratios, not the ratio of two medians taken minutes apart.
"""

import importlib
import time
from collections.abc import Callable, Iterable, Sequence
from types import ModuleType
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np

from jaxest.io.report import Row

INSTALL_PEERS = "pip install 'jaxest[peers]'"


class Progress(Protocol):
    """Hears what is being measured, one short line at a time."""

    def __call__(self, message: str) -> None:
        """Take the line; a terminal shows it, a test ignores it."""
        ...


class Case(Protocol):
    """A module `jaxest.bench.NAME`: what it measures and the rows that come out."""

    def rows(self, *, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
        """Yield rows; with `peers` beside other programs, with `small` on sizes that a test can afford."""
        ...


class Candidate(NamedTuple):
    """Something to be timed."""

    name: str
    """what the row is called"""
    call: Callable[[], Any]
    """does all the work once; what it returns is waited for"""
    items: int = 1
    """pieces of work in one call; times are per piece"""
    compile_s: float | None = None
    """time to trace, lower and compile, s; None where nothing is compiled"""


class Timing(NamedTuple):
    """What came out for one candidate."""

    name: str
    seconds: np.ndarray
    """(rounds,) time per piece of work, s"""
    compile_s: float | None

    @property
    def median(self) -> float:
        """Median over the rounds, s per piece."""
        return float(np.median(self.seconds))

    @property
    def spread(self) -> float:
        """Interquartile range over the rounds, s per piece."""
        low, high = np.percentile(self.seconds, [25.0, 75.0])
        return float(high - low)


def candidate(name: str, fn: Callable[..., Any], *args: Any, items: int = 1) -> Candidate:
    """Compile a function for its arguments, or call it once, and note how long that took.

    Args:
        name: what the row is called.
        fn: a jitted function, whose lowering and compilation are timed, or any other callable, which is called once
            and has no compile time.
        args: arguments of `fn`.
        items: pieces of work in one call.

    Returns:
        The candidate, ready to be raced. A persistent compilation cache, if one is set up, makes `compile_s` the time
        to read it.
    """
    compile_s = None
    if hasattr(fn, "lower"):
        start = time.perf_counter()
        fn.lower(*args).compile()
        compile_s = time.perf_counter() - start
    return Candidate(name, lambda: fn(*args), items, compile_s)


def race(candidates: Sequence[Candidate], *, repeats: int = 20, min_time: float = 2e-3) -> dict[str, Timing]:
    """Time candidates against each other, in turn within each round.

    Args:
        candidates: what to time, each under its own name.
        repeats: number of rounds.
        min_time: a quick call is repeated within its turn until the turn lasts about this long, s.

    Returns:
        One timing a candidate, by name.

    Raises:
        ValueError: no rounds, or two candidates of one name.
    """
    if repeats < 1:
        raise ValueError(f"repeats: {repeats}, expected at least 1")
    names = [one.name for one in candidates]
    if len(set(names)) != len(names):
        raise ValueError(f"candidates: names {names} are not distinct")
    inner = [_calls_in(one.call, min_time) for one in candidates]
    seconds = np.empty((len(candidates), repeats))
    for turn in range(repeats):
        # Every other round runs backwards, so that nobody always follows the same neighbour's leftovers in the cache.
        order = range(len(candidates)) if turn % 2 == 0 else reversed(range(len(candidates)))
        for index in order:
            seconds[index, turn] = _turn(candidates[index].call, inner[index]) / candidates[index].items
    return {one.name: Timing(one.name, seconds[i], one.compile_s) for i, one in enumerate(candidates)}


def measure(fn: Callable[..., Any], *args: Any, repeats: int = 20, items: int = 1, name: str = "") -> Timing:
    """Time one function alone; see `race` for several.

    Args:
        fn: jitted or plain callable.
        args: its arguments.
        repeats: number of rounds.
        items: pieces of work in one call.
        name: what the timing is called; the function's own name if empty.

    Returns:
        The timing.
    """
    one = candidate(name or getattr(fn, "__name__", "call"), fn, *args, items=items)
    return race([one], repeats=repeats)[one.name]


def compare(
    metric: str, condition: str, ours: Timing, peer: Timing | None = None, *, unit: str = "us", missing: str = ""
) -> Row:
    """Make a row of a timing, beside a peer's timing of the same race.

    Args:
        metric: what was timed, for example `"live step"`.
        condition: sizes, precision, what the peer does differently.
        ours: the timing that the row is about.
        peer: the reference, if there is one.
        unit: `"s"`, `"ms"`, `"us"` or `"ns"`, per piece of work.
        missing: name of a peer that is not installed; the row then names the line that installs it.

    Returns:
        The row. `ratio` is how many times faster ours is, the median over the rounds.
    """
    scale = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
    row = Row(metric, condition, ours.median * scale, unit, spread=ours.spread * scale, n=len(ours.seconds))
    if peer is not None:
        ratio = float(np.median(peer.seconds / ours.seconds))
        return row._replace(reference=peer.median * scale, reference_name=peer.name, ratio=ratio)
    return row._replace(reference_name=f"{missing} is not installed: {INSTALL_PEERS}") if missing else row


def compile_row(condition: str, timing: Timing) -> Row:
    """Make a row of the time that a candidate took to compile.

    Args:
        condition: what was compiled.
        timing: a timing whose candidate was a jitted function.

    Returns:
        The row, in seconds.
    """
    settings = jax.config.values
    cached = settings["jax_compilation_cache_dir"] and settings["jax_enable_compilation_cache"]
    note = ", read from the compilation cache if it was there" if cached else ""
    return Row("compile", condition + note, timing.compile_s, "s")


def find_peer(module: str) -> ModuleType | None:
    """Import a peer if it is installed.

    Args:
        module: name of its module, for example `"vqf"`.

    Returns:
        The module, or None where it is absent.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        return None


def _turn(call: Callable[[], Any], times: int) -> float:
    start = time.perf_counter()
    for _ in range(times):
        jax.block_until_ready(call())
    return (time.perf_counter() - start) / times


def _calls_in(call: Callable[[], Any], min_time: float) -> int:
    _turn(call, 1)  # warm: compiles what is not compiled, fills caches
    return max(1, round(min_time / max(_turn(call, 1), 1e-9)))
