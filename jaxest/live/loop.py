"""The loop of live use: take a sample, step, look at the clock."""

import contextlib
import gc
import math
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxest.live import latency as lat
from jaxest.live.compiled import program
from jaxest.live.keeper import Keeper
from jaxest.live.measure import fields, measurement_of
from jaxest.live.sources import Sample, Source
from jaxest.types import OK, Array, InputError, PyTree, Step, status_message

KEPT = 5  # messages


class Outcome(NamedTuple):
    """How a live run went."""

    state: PyTree
    """After the last step; the checkpoint holds the same."""
    time: float | None
    """s, stamp of the last sample that was used; None where there was none."""
    steps: int
    """Samples used."""
    missed: int
    """Steps that took longer than the deadline."""
    late: int
    """Samples refused because their stamp was not after the one before."""
    broken: int
    """Items refused: not to be read, no `Sample`, unknown streams or other shapes, a stamp far off or not finite."""
    flagged: int
    """Steps whose info has a status other than 0."""
    masked: dict[str, int]
    """By stream, steps in which it had nothing usable to say."""
    latency: lat.Latency
    """From a sample at hand to its estimate being there."""
    messages: tuple[str, ...]
    """The first few about what was refused or flagged, and why a checkpoint could not be written."""
    ended: str
    """`the source ended`, `interrupted` or `enough`."""


def drive(
    step: Step,
    params: PyTree,
    state: PyTree,
    source: Source,
    template: PyTree,
    *,
    key: Array | None = None,
    deadline: float = 1e-3,
    emit: Callable[[float, Any], None] | None = None,
    tell: Callable[[str], None] | None = None,
    last: float | None = None,
    gap: float = 60.0,
    save: Path | str | None = None,
    save_every: float = 10.0,
    limit: int | None = None,
) -> Outcome:
    """Step through samples as they come, until the source ends, Ctrl-C or SIGTERM.

    The step is compiled before the first sample is taken. A sample whose stamp is not after the one before is refused
    and counted; so is one that cannot be read, and one whose stamp is more than `gap` ahead, unless the next one agrees
    with it: one wrong stamp must not make all later samples late. The very first stamp is given up where the next two
    agree with each other and are more than `gap` before or after it. A step beyond its deadline is counted and used
    all the same: skipping it would lose a measurement. Numbers are those of `jaxest.filters.run` on the same
    measurements.

    Args:
        step: an estimator's step.
        params: its parameters.
        state: where to begin: `init(params)`, or `resume(path, init(params)).state`.
        source: samples, as `from_queue`, `from_udp` and `from_file` yield them.
        template: a measurement of the step, NumPy arrays of the right shapes and dtypes.
        key: key of the whole run, for steps that draw.
        deadline: s, for a step.
        emit: called with the stamp (s) and the info of each step, of NumPy arrays, behind the clock.
        tell: called with each message as it comes: what was refused and why, and the first step with a status.
        last: s, stamp of the last sample in `state`, where the run goes on from a checkpoint.
        gap: s, longest silence after which a single sample is believed; above the slowest sensor's interval.
        save: file for checkpoints, replaced each time, whole or not at all; written every `save_every` seconds beside
            the loop, and at the end, whatever ends it. A checkpoint that cannot be written does not stop the loop.
        save_every: s.
        limit: number of samples after which to stop.

    Returns:
        The outcome.

    Raises:
        ValueError: a deadline or a gap that is not positive.
        InputError: a checkpoint cannot be written where `save` says.
    """
    for name, seconds in (("deadline", deadline), ("gap", gap)):
        if not seconds > 0:
            raise ValueError(f"{name}: got {seconds}, expected seconds above 0")
    keeper = Keeper(save, save_every)
    compiled = program(step, params, state, measurement_of(template, Sample(0.0, {}), 0.0), key=key)
    tally = _Tally(compiled.start(state), last, gap, tell)
    keeper.start(compiled.state)
    try:
        with _stoppable() as stopped, _undisturbed():
            ended = _loop(compiled.call, source, template, tally, deadline, emit, keeper, stopped, limit)
    finally:
        keeper.close()
    if keeper.failure:
        tally.say(f"no checkpoint: {keeper.failure}")
    return Outcome(
        compiled.state(tally.carry), tally.time, tally.steps, tally.missed, tally.late, tally.broken, tally.flagged,
        dict(tally.masked), tally.latency, tuple(tally.messages), ended,
    )  # fmt: skip


class _Tally:
    """What the loop counts; lives inside `drive` only."""

    def __init__(self, carry: Any, time: float | None, gap: float, tell: Callable[[str], None] | None) -> None:
        self.carry, self.time = carry, time
        self.steps = self.missed = self.late = self.broken = self.flagged = 0
        self.masked: Counter[str] = Counter()
        self.latency = lat.empty()
        self.messages: list[str] = []
        self._gap, self._tell = gap, tell
        self._alone = time is None  # whether at most one stamp was seen, which may be the wrong one
        self._off: float | None = None

    def say(self, message: str) -> None:
        if len(self.messages) < KEPT:
            self.messages.append(message)
        if self._tell:
            self._tell(message)

    def refuse(self, message: str) -> None:
        self.broken += 1
        self.say(message)

    def in_time(self, stamp: float) -> bool:
        """Whether a sample with this stamp may be used; says so where not."""
        if not _finite(stamp):
            self.refuse(f"sample with the stamp {stamp!r:.60}, expected a finite number of seconds")
            return False
        if self.time is None:
            return True
        off, self._off = self._off, None
        agrees = off is not None and 0 < stamp - off <= self._gap
        far = abs(stamp - self.time) > self._gap
        if self._alone and agrees:
            self.time = off
        elif not stamp > self.time and not (self._alone and far):
            self.late += 1
            if self.steps:
                self.say(f"sample at {stamp:.6f} s: not after the one before, {self.time:.6f} s; refused as late")
            elif self.late == 1:
                self.say(f"sample at {stamp:.6f} s: the state has seen all up to {self.time:.6f} s; these are refused")
            return False
        elif far and not agrees:
            self._off = stamp
            self.refuse(
                f"sample at {stamp:.6g} s: more than {self._gap:g} s from the one before, {self.time:.6f} s; "
                "refused, unless the next one agrees (gap= takes longer silences)"
            )
            return False
        self._alone = False
        return True

    def look(self, info: Any) -> None:
        """Count a status other than 0."""
        status = int(np.max(getattr(info, "status", OK)))
        if status != OK:
            self.flagged += 1
            if self.flagged == 1:
                self.say(f"step at {self.time:.6f} s: status {status}{_meaning(status)}")


def _finite(stamp: Any) -> bool:
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        return math.isfinite(stamp)
    return False


def _meaning(status: int) -> str:
    """What a status means, in brackets; nothing where only its estimator knows."""
    with contextlib.suppress(ValueError):
        return f" ({status_message(status)})"
    return ""


def _loop(
    call: Any, source: Source, template: PyTree, tally: _Tally, deadline: float,
    emit: Any, keeper: Keeper, stopped: threading.Event, limit: int | None,
) -> str:  # fmt: skip
    names = fields(template)
    for item in source:
        if stopped.is_set():
            return "interrupted"
        if item is None:
            continue
        if not isinstance(item, Sample):
            tally.refuse(item if isinstance(item, str) else f"got {type(item).__name__}, expected a Sample")
            continue
        begun = time.perf_counter()
        if not tally.in_time(item.time):
            continue
        try:
            measurement = measurement_of(template, item, 0.0 if tally.time is None else item.time - tally.time)
        except InputError as error:
            tally.refuse(str(error))
            continue
        tally.carry, info = call(tally.carry, measurement)
        took = time.perf_counter() - begun
        tally.time, tally.steps = item.time, tally.steps + 1
        tally.latency = lat.counted(tally.latency, took)
        tally.missed += took > deadline
        tally.masked.update(name for name in names if not getattr(measurement, name).valid.all())
        tally.look(info)
        keeper.offer(tally.carry, item.time)
        if emit:
            emit(item.time, info)
        if limit is not None and tally.steps >= limit:
            return "enough"
    return "the source ended"


@contextlib.contextmanager
def _stoppable() -> Iterator[threading.Event]:
    """Turn Ctrl-C and SIGTERM into an event that the loop looks at; only a main thread hears signals."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    before = {number: signal.signal(number, lambda *_: event.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield event
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Keep the garbage collector off what was there before: its full passes take milliseconds."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


__all__ = ["Outcome", "drive"]
