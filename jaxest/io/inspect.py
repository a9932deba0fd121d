"""What a log holds and what looks wrong about it: rates, gaps, NaN, stuck channels, clocks, units."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest import stamps
from jaxest.io import plausible, units
from jaxest.io.align import interpolate
from jaxest.io.log import SensorLog, Stream, check, finite_rows

RUN = 5
"""A channel is saturated if it stays at its extreme this often in a row, having arrived at speed."""
DRIFT = 1e-4
"""Clocks whose rates differ by more than this drift apart: 0.1 s in 17 minutes."""
_UNIT_LENGTH, _MANY = 0.02, 20
_UP = 0.8  # cosine of the angle between the vertical and where quaternions put it
_ARRIVAL, _QUANTA = 0.3, 2.5  # of the rms step, of the smallest step


class Gaps(NamedTuple):
    """Steps longer than `stamps.GAP` median steps."""

    number: int
    longest: float
    """s; 0 where there is no gap."""
    at: float
    """s, the stamp before the longest gap; NaN where there is none."""


class StreamSummary(NamedTuple):
    """One stream in figures."""

    name: str
    n: int
    shape: tuple[int, ...]
    """Of one sample."""
    dtype: str
    unit: str
    frame: str
    start: float
    """s, the first stamp."""
    duration: float
    """s, from the first to the last stamp."""
    rate: float
    """Hz, one over the median step; NaN for a single sample."""
    jitter: float
    """s, 1.4826 times the median deviation of the step from its median."""
    gaps: Gaps
    missing: int
    """Rows that are not finite."""
    constant: tuple[int, ...]
    """Columns that never change."""
    saturated: tuple[int, ...]
    """Columns that stick to their extreme."""


class Skew(NamedTuple):
    """A stream's clock against that of the longest stream."""

    name: str
    reference: str
    start: float
    """s, first stamp minus the reference's."""
    end: float
    """s, last stamp minus the reference's."""
    rate_ratio: float
    """Mean rate over the reference's."""


class Summary(NamedTuple):
    """What `summarize` found."""

    streams: tuple[StreamSummary, ...]
    skews: tuple[Skew, ...]
    warnings: tuple[str, ...]
    """Each names a stream, what was found and what was expected."""


def summarize(log: SensorLog) -> Summary:
    """Describe a log and say what looks wrong.

    Args:
        log: the log.

    Returns:
        Figures for each stream, clocks against each other, and warnings.

    Raises:
        InputError: the log is not valid (`check`).
    """
    check(log)
    streams = tuple(_describe(name, item) for name, item in log.streams.items())
    reference = max(streams, key=lambda s: s.duration)
    skews = tuple(_skew(s, reference) for s in streams if s.name != reference.name)
    warnings: list[str] = []
    for entry in streams:
        warnings += _figures(entry)
        warnings += _units(log, entry.name, log.streams[entry.name])
    for skew in skews:
        warnings += _clocks(skew, {s.name: s for s in streams})
    return Summary(streams, skews, tuple(warnings))


def _describe(name: str, item: Stream) -> StreamSummary:
    steps = np.diff(item.time)
    period = float(np.median(steps)) if len(steps) else float("nan")
    jitter = 1.4826 * float(np.median(np.abs(steps - period))) if len(steps) else 0.0
    long = stamps.gaps(item.time)
    worst = int(long[np.argmax(steps[long])]) if len(long) else -1
    gaps = Gaps(len(long), float(steps[worst]), float(item.time[worst])) if len(long) else Gaps(0, 0.0, float("nan"))
    finite = finite_rows(item.value)
    flat = item.value[finite].reshape(int(finite.sum()), math.prod(item.value.shape[1:]))
    constant = tuple(int(i) for i in np.flatnonzero(np.ptp(_plain(flat), axis=0) == 0)) if len(flat) > 1 else ()
    stuck = flat.dtype != bool and units.kind_of(name) != "orientation"
    saturated = tuple(i for i in range(flat.shape[1]) if i not in constant and _saturated(flat[:, i])) if stuck else ()
    return StreamSummary(
        name, len(item.time), item.value.shape[1:], str(item.value.dtype), item.unit, item.frame, float(item.time[0]),
        float(item.time[-1] - item.time[0]), 1 / period if period > 0 else float("nan"), jitter, gaps,
        int((~finite).sum()), constant, saturated,
    )  # fmt: skip


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    return values.astype(np.uint8) if values.dtype == bool else values


def _saturated(values: NDArray[Any]) -> bool:
    """Say whether the channel sticks to its largest or smallest value as a clipped signal does.

    A slow quantised signal rests at its turning point too, but arrives there in small steps; a clipped one arrives
    at speed.
    """
    if len(values) < _MANY or len(np.unique(values[:: max(1, len(values) // 1000)])) < _MANY:
        return False
    values = values.astype(np.float64)
    steps = np.minimum(np.abs(np.diff(values)), 1e100)  # an absurd value must not overflow when squared
    fast = max(_ARRIVAL * float(np.sqrt(np.mean(steps**2))), _QUANTA * float(np.min(steps[steps > 0])))
    for extreme in (values.max(), values.min()):
        at = values == extreme
        edges = np.diff(np.concatenate([[0], at.astype(np.int8), [0]]))
        first, after = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        arrival = np.abs(values[first] - values[np.maximum(first - 1, 0)])
        runs = (after - first)[(after - first >= RUN) & (arrival > fast)]
        if runs.sum() >= 2 * RUN:  # one short run may be chance
            return True
    return False


def _skew(entry: StreamSummary, reference: StreamSummary) -> Skew:
    end = (entry.start + entry.duration) - (reference.start + reference.duration)
    rates = [(s.n - 1) / s.duration if s.duration > 0 else float("nan") for s in (entry, reference)]
    return Skew(entry.name, reference.name, entry.start - reference.start, end, rates[0] / rates[1])


def _figures(s: StreamSummary) -> list[str]:
    """Return warnings about one stream's figures."""
    found = []
    if s.gaps.number:
        found.append(
            f"{s.name}: {s.gaps.number} gaps, the longest {s.gaps.longest:.4g} s after {s.gaps.at:.6g} s; expected a "
            f"sample each {1 / s.rate:.4g} s"
        )
    if s.missing:
        found.append(f"{s.name}: {s.missing} of {s.n} rows are NaN or infinite; expected numbers")
    if s.constant and s.n > _MANY and not s.dtype.startswith(("bool", "int", "uint")):
        found.append(f"{s.name}: column {_listed(s.constant)} never changes; expected a live channel")
    if s.saturated:
        found.append(f"{s.name}: column {_listed(s.saturated)} sticks to its extreme; expected a range that suffices")
    if s.unit in units.UNITS and units.UNITS[s.unit].si != s.unit:
        found.append(f"{s.name}: stated in {s.unit}; expected {units.UNITS[s.unit].si} (to_si converts)")
    return found


def _listed(columns: tuple[int, ...]) -> str:
    return ", ".join(map(str, columns))


def _clocks(skew: Skew, streams: dict[str, StreamSummary]) -> list[str]:
    entry, reference = streams[skew.name], streams[skew.reference]
    if skew.start > reference.duration or -skew.start > entry.duration:
        return [
            f"{skew.name}: begins {skew.start:.6g} s after {skew.reference} and never overlaps it; expected one clock"
        ]
    apart = abs(entry.duration / reference.duration - 1) if reference.duration > 0 else 0.0
    step = 2 / (reference.rate * reference.duration) if reference.duration > 0 else 0.0
    if entry.n == reference.n and apart > max(DRIFT, step):
        return [
            f"{skew.name}: as many samples as {skew.reference}, but in {entry.duration:.6g} s instead of "
            f"{reference.duration:.6g} s; expected clocks of equal rate"
        ]
    return []


def doubtful_units(log: SensorLog) -> list[str]:
    """Return warnings about streams whose values do not fit their units, such as accelerations near 1.

    Args:
        log: the log.

    Returns:
        A line each.
    """
    return [line for name, item in log.streams.items() if item.value.dtype.kind == "f"
            for line in _units(log, name, item)]  # fmt: skip


def _units(log: SensorLog, name: str, item: Stream) -> list[str]:
    """Return warnings about values that do not fit the stream's unit."""
    kind = units.kind_of(name)
    finite = finite_rows(item.value)
    if not finite.any() or kind not in units.KINDS:
        return []
    if kind == "accelerometer" and item.unit in ("m/s2", ""):
        norm = plausible.median_norm(item.value)
        if plausible.acceleration_unit(item.value) != "m/s2":
            guess = "; is it in g?" if plausible.acceleration_unit(item.value) == "g" else ""
            return [f"{name}: median norm {norm:.4g}; expected near 9.81 m/s2{guess}"]
    if kind == "gyroscope" and item.unit in ("rad/s", ""):
        return _gyroscope(log, name, item)
    if kind == "magnetometer" and item.unit == "T" and plausible.field_unit(item.value) != "T":
        norm, guess = plausible.median_norm(item.value), plausible.field_unit(item.value)
        hint = f"; is it in {guess}?" if guess != "1" else ""
        return [f"{name}: median norm {norm:.4g} T; expected the earth's field, 22e-6 to 67e-6 T{hint}"]
    if kind == "orientation":
        return _quaternions(log, name, item, finite)
    if kind == "joint_position" and item.unit == "rad" and np.abs(item.value[finite]).max() > 4 * np.pi:
        return [f"{name}: angles up to {np.abs(item.value[finite]).max():.4g} rad; expected a few turns; is it in deg?"]
    return []


def _beside(log: SensorLog, name: str, item: Stream) -> NDArray[Any] | None:
    """Return the accelerometer of the same owner at this stream's times, NaN where it says nothing.

    A camera's orientation has none of its own: the only one of the log is taken, if there is only one.
    """
    kind = units.kind_of(name)
    partner = log.streams.get(name.removesuffix(kind) + "accelerometer")
    every = [other for key, other in log.streams.items() if units.kind_of(key) == "accelerometer"]
    if partner is None and kind == "orientation" and len(every) == 1:
        partner = every[0]
    if partner is None or partner.value.dtype.kind != "f":
        return None
    beside = SensorLog({"accelerometer": partner}, log.source)
    reading = interpolate(beside, None, item.time, nan="invalid").readings["accelerometer"]
    return np.where(np.asarray(reading.valid)[:, None], np.asarray(reading.value), np.nan)


def _gyroscope(log: SensorLog, name: str, item: Stream) -> list[str]:
    acc = _beside(log, name, item)
    if acc is not None:
        found = plausible.rate_check(item.time, item.value, acc)
        if plausible.in_degrees(found):
            return [
                f"{name}: the measured gravity turns {found.ratio:.3g} times as far as the rates say; expected 1; "
                "is it in deg/s (0.0175)?"
            ]
        if plausible.in_degrees(found) is False:
            return []
    if plausible.too_fast(item.value):
        return [f"{name}: rates beyond {plausible.FASTEST:g} rad/s; expected less of a gyroscope; is it in deg/s?"]
    return []


def _quaternions(log: SensorLog, name: str, item: Stream, finite: NDArray[np.bool_]) -> list[str]:
    with np.errstate(over="ignore"):
        length = np.linalg.norm(item.value[finite].astype(np.float64), axis=1)
    off = np.abs(length - 1) > _UNIT_LENGTH
    if off.any():
        row = int(np.flatnonzero(finite)[np.argmax(off)])
        return [f"{name}: {int(off.sum())} quaternions are not of length 1, the first in row {row} "
                f"({length[np.argmax(off)]:.4g})"]  # fmt: skip
    acc = _beside(log, name, item)
    order = plausible.quaternion_order(item.value, acc) if acc is not None else ""
    if order not in ("", "wxyz"):
        return [f"{name}: fits the measured gravity as {order}; expected wxyz, sensor to earth"]
    up = plausible.earth_up(item.value, acc) if acc is not None and order else np.array([0, 0, 1.0])
    if up[2] < _UP:
        found = ", ".join(f"{x:.2f}" for x in up + 0.0)
        ned = "; is its earth NED, z down?" if up[2] < -_UP else ""
        return [
            f"{name}: puts the measured gravity along [{found}]; expected [0, 0, 1] in an earth with z up (ENU){ned}"
        ]
    return []
