"""Streams of different rates and clocks as one sequence of steps, or interpolated at given times.

`ticks` loses no sample and makes none up: a step for each stamp, with the sensors that spoke then valid and the others
not. `interpolate` makes values up between samples, on request only.
"""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from jaxest.io import units
from jaxest.io.log import SensorLog, Stream, check, finite_rows, refuse_nan, stream, where
from jaxest.types import InputError, Reading

OnNan = Literal["error", "invalid"]


class Steps(NamedTuple):
    """Measurements with a leading time axis, as NumPy arrays."""

    time: NDArray[np.float64]
    """(T,) s."""
    dt: NDArray[Any]
    """(T,) s since the previous step, differenced in float64; 0 for the first."""
    readings: dict[str, Reading]
    """By stream: `value` (T, ...), 0 where invalid, and `valid` (T,), or of `value`'s shape where columns are apart."""


def ticks(
    log: SensorLog,
    names: Sequence[str] | None = None,
    *,
    tolerance: float = 0.0,
    nan: OnNan = "error",
    dtype: DTypeLike | None = None,
    apart: Sequence[str] = (),
) -> Steps:
    """Merge streams into one sequence of steps, one for each stamp.

    The stamps of the stream with the most samples are ticks. A sample of another stream joins the nearest tick if it is
    at most `tolerance` away; of several samples of one stream the nearest joins and the others make ticks of their own.
    So every sample is in exactly one step, in order, and a step holds at most one sample of each stream. A step has the
    stamp of the tick, so that a sample's own stamp may be off by up to `tolerance`.

    Args:
        log: the log.
        names: streams to take, all by default.
        tolerance: s; 0 merges equal stamps only.
        nan: `"error"` refuses values that are not finite, `"invalid"` takes such rows as missing.
        dtype: of floating values and of `dt`; by default values keep theirs and `dt` has the widest of them.
        apart: streams each of whose columns may be missing on its own, as encoders' are; of others a row is.

    Returns:
        The steps.

    Raises:
        InputError: no such stream, or values that are not finite.
        ValueError: a negative tolerance.
    """
    if not tolerance >= 0:
        raise ValueError(f"tolerance: got {tolerance}, expected a time in seconds, 0 or more")
    chosen = _chosen(log, names)
    kept = {name: _masked(log, name, item, nan) for name, item in chosen.items()}
    time, rows = _assign({name: item.time for name, (item, _) in kept.items()}, tolerance)
    readings = {}
    for name, (item, valid) in kept.items():
        if name in apart:
            valid = np.isfinite(item.value)
        there = np.zeros_like(item.value)
        there[valid] = item.value[valid]
        value = np.zeros((len(time), *item.value.shape[1:]), _dtype(item.value, dtype))
        present = np.zeros((len(time), *valid.shape[1:]), bool)
        value[rows[name]], present[rows[name]] = there, valid
        readings[name] = Reading(value, present)  # type: ignore[arg-type]
    return Steps(time, _differences(time, readings, dtype), readings)


def _chosen(log: SensorLog, names: Sequence[str] | None) -> dict[str, Stream]:
    if isinstance(names, str):
        raise ValueError(f"names: got the text {names!r}, expected a sequence of stream names")
    chosen = {name: stream(log, name) for name in (names if names is not None else log.streams)}
    check(SensorLog(chosen, log.source))
    return chosen


def _masked(log: SensorLog, name: str, item: Stream, nan: OnNan) -> tuple[Stream, NDArray[np.bool_]]:
    """Return the stream and which of its rows hold numbers."""
    if nan == "error":
        refuse_nan(item, f"{where(log)}stream {name!r}")
    elif nan != "invalid":
        raise ValueError(f"nan: got {nan!r}, expected 'error' or 'invalid'")
    return item, finite_rows(item.value)


def _nearest(time: NDArray[np.float64], stamps: NDArray[np.float64]) -> NDArray[np.intp]:
    """Index of the nearest tick of each stamp; the earlier one of two equally near."""
    right = np.clip(np.searchsorted(time, stamps), 1, max(len(time) - 1, 1))
    right = np.minimum(right, len(time) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(stamps - time[left] <= time[right] - stamps, left, right)


def _winners(
    time: NDArray[np.float64], stamps: NDArray[np.float64], tolerance: float
) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Which stamps join a tick (near enough, and the nearest of those that want the same one), and the nearest tick."""
    tick = _nearest(time, stamps)
    distance = np.abs(stamps - time[tick])
    best = np.full(len(time), np.inf)
    np.minimum.at(best, tick, distance)
    wins = (distance <= tolerance) & (distance == best[tick])
    first = np.full(len(time), len(stamps))
    rows = np.flatnonzero(wins)
    np.minimum.at(first, tick[rows], rows)  # a tie goes to the earlier sample
    return wins & (first[tick] == np.arange(len(stamps))), tick


def _assign(
    stamps: dict[str, NDArray[np.float64]], tolerance: float
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.intp]]]:
    """Return the ticks and the tick of each sample of each stream."""
    order = sorted(stamps, key=lambda name: -len(stamps[name]))  # stable: equal lengths keep the given order
    time = stamps[order[0]]
    rows = {order[0]: np.arange(len(time))}
    for name in order[1:]:
        if np.array_equal(time, stamps[name]):
            rows[name] = np.arange(len(time))
            continue
        wins, tick = _winners(time, stamps[name], tolerance)
        alone = stamps[name][~wins]
        merged = np.concatenate([time, alone])
        by_time = np.argsort(merged, kind="stable")
        place = np.empty_like(by_time)
        place[by_time] = np.arange(len(merged))  # where each tick, old or new, comes to stand
        rows = {other: place[index] for other, index in rows.items()}
        rows[name] = np.empty(len(tick), place.dtype)
        rows[name][wins] = place[tick[wins]]
        rows[name][~wins] = place[len(time) :]
        time = merged[by_time]
    return time, rows


def _differences(time: NDArray[np.float64], readings: dict[str, Reading], dtype: DTypeLike | None) -> NDArray[Any]:
    floating = [r.value.dtype for r in readings.values() if r.value.dtype.kind == "f"]
    widest = np.result_type(*floating) if floating else np.dtype(np.float64)
    return np.diff(time, prepend=time[:1]).astype(widest if dtype is None else dtype)


def _dtype(value: NDArray[Any], dtype: DTypeLike | None) -> np.dtype[Any]:
    return np.dtype(dtype) if dtype is not None and value.dtype.kind == "f" else value.dtype


def interpolate(
    log: SensorLog,
    names: Sequence[str] | None,
    times: ArrayLike,
    *,
    max_gap: float = np.inf,
    nan: OnNan = "error",
    dtype: DTypeLike | None = None,
) -> Steps:
    """Interpolate streams at given times; nothing is extrapolated.

    Floating values are interpolated linearly, quaternions (streams called `orientation`) along the shorter great
    circle, and integers and flags keep the last sample's value.

    Args:
        log: the log.
        names: streams to take; None for all.
        times: (T,) s, increasing.
        max_gap: s; between samples further apart the result is invalid.
        nan: `"error"` refuses values that are not finite; `"invalid"` makes what lies beside such a row invalid.
        dtype: as for `ticks`.

    Returns:
        The steps; invalid before the first and after the last sample of a stream.

    Raises:
        InputError: no such stream, values that are not finite, or times that do not increase.
    """
    time = np.asarray(times, np.float64)
    if time.ndim != 1 or len(time) == 0 or not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        raise InputError(f"times: got shape {time.shape}, expected (T,) finite and strictly increasing, in seconds")
    readings = {}
    for name, item in _chosen(log, names).items():
        item, finite = _masked(log, name, item, nan)
        readings[name] = _at(item, finite, time, max_gap, units.kind_of(name) == "orientation", dtype)
    return Steps(time, _differences(time, readings, dtype), readings)


def _at(
    item: Stream, finite: NDArray[np.bool_], time: NDArray[np.float64], max_gap: float, quaternion: bool,
    dtype: DTypeLike | None,
) -> Reading:  # fmt: skip
    """Interpolate one stream."""
    left = np.clip(np.searchsorted(item.time, time, side="right") - 1, 0, len(item.time) - 1)
    exact = item.time[left] == time
    right = np.where(exact, left, np.minimum(left + 1, len(item.time) - 1))
    inside = (time >= item.time[0]) & (time <= item.time[-1])
    gap = item.time[right] - item.time[left]
    valid = inside & finite[left] & finite[right] & (gap <= max_gap)
    weight = np.where(gap > 0, (time - item.time[left]) / np.where(gap > 0, gap, 1.0), 0.0)
    left, right, weight = left[valid], right[valid], weight[valid]
    target = _dtype(item.value, dtype)
    value = np.zeros((len(time), *item.value.shape[1:]), target)
    if item.value.dtype.kind != "f":
        value[valid] = item.value[left]
    else:
        a, b = item.value[left].astype(np.float64), item.value[right].astype(np.float64)
        w = weight.reshape(-1, *[1] * (a.ndim - 1))
        value[valid] = (slerp(a, b, weight) if quaternion else a + w * (b - a)).astype(target)
    return Reading(value, valid)  # type: ignore[arg-type]


def slerp(a: NDArray[np.float64], b: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate unit quaternions along the shorter great circle.

    Args:
        a: (n, 4) at weight 0; any length but zero.
        b: (n, 4) at weight 1.
        weight: (n,) in [0, 1].

    Returns:
        (n, 4) of unit length, of the sign of `a`.
    """
    a, b = (q / np.linalg.norm(q, axis=-1, keepdims=True) for q in (a, b))
    b = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0, -b, b)
    # 2 atan2(|a - b|, |a + b|) keeps its digits where arccos of the product loses them
    half = np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    angle = 2 * half
    safe = np.where(angle > 1e-8, angle, 1.0)
    w = np.where(angle > 1e-8, np.sin((1 - weight) * safe) / np.sin(safe), 1 - weight)
    v = np.where(angle > 1e-8, np.sin(weight * safe) / np.sin(safe), weight)
    q = w[:, None] * a + v[:, None] * b
    return q / np.linalg.norm(q, axis=-1, keepdims=True)
