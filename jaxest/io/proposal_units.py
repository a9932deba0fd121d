"""Clocks and units of the streams that were found in a file, by its names and by what its numbers can be."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.io import plausible, units
from jaxest.io.columns import Column
from jaxest.io.proposal_streams import Found
from jaxest.io.raw import Raw
from jaxest.io.table_streams import rate_of
from jaxest.io.words import Word, fits
from jaxest.types import listed


def clock(raw: Raw, words: dict[str, Word], name: str, entry: Found, assumed: list[str], unsure: list[str]) -> Column:
    """Find the stamps or the rate of a stream: those of the same owner first.

    Args:
        raw: the file.
        words: what its names say.
        name: the stream's.
        entry: the stream.
        assumed: gets a sentence for each thing that is taken for granted.
        unsure: gets a sentence for each thing that only the user knows.

    Returns:
        Its column, with the clock.
    """
    column, n, unit = entry.column, len(entry.value), ""
    if column.time is None:
        times = [t for t, w in words.items() if w.kind == "time" and raw.arrays[t].size == n]
        times = [t for t in times if words[t].owner == entry.owner] or [t for t in times if not words[t].owner] or times
        if not times:
            return _rate(raw, words, name, entry, assumed, unsure)
        if len(times) > 1:
            unsure.append(f"{name}: stamps could be any of {', '.join(times)}")
        column, unit = column._replace(time=times[0]), words[times[0]].unit
    stamps = _stamps(raw, column)
    time_unit = unit or plausible.time_unit(stamps)
    if not fits("time", unit or "s"):
        unsure.append(f"{name}: the unit of its stamps {column.time!r} is {unit!r}, expected s, ms, us or ns")
    elif not time_unit:
        step = float(np.median(np.diff(stamps.astype(np.float64))))
        time_unit = plausible.likely_time_unit(step)
        likely = f"; {time_unit} is likely" if time_unit else ""
        unsure.append(f"{name}: the unit of its stamps {column.time!r} is open (median step {step:g}){likely}")
    elif time_unit != "s":
        assumed.append(f"stamps {column.time!r} taken as {time_unit}")
    return column._replace(time_unit=time_unit)


def _rate(raw: Raw, words: dict[str, Word], name: str, entry: Found, assumed: list[str], unsure: list[str]) -> Column:
    scalars = {n: w for n, w in words.items() if w.kind in ("rate", "period") and raw.arrays[n].size == 1}
    mine = [n for n in scalars if scalars[n].owner == entry.owner] or [n for n in scalars if not scalars[n].owner]
    if not mine:
        unsure.append(f"{name}: no stamps of {len(entry.value)} rows and no sampling rate found; add rate = ... in Hz")
        return entry.column
    if len(mine) > 1:
        unsure.append(f"{name}: the sampling rate could be any of {', '.join(mine)}")
    if scalars[mine[0]].unit not in ("", "Hz", "s"):
        unsure.append(f"{name}: the unit of {mine[0]} is not Hz or s; add rate = ... in Hz")
    value = float(raw.arrays[mine[0]].reshape(()))
    assumed.append(f"{mine[0]} = {value:.6g} taken as sampling {scalars[mine[0]].kind}")
    rate: float | str = 1 / value if scalars[mine[0]].kind == "period" and value > 0 else mine[0]
    return entry.column._replace(rate=rate)


def with_unit(raw: Raw, name: str, streams: dict[str, Found], assumed: list[str], unsure: list[str]) -> Column:
    """Settle the unit of a stream by the name, else by magnitude.

    Args:
        raw: the file.
        name: the stream's.
        streams: all that were found, with their clocks.
        assumed: gets a sentence for each thing that is taken for granted.
        unsure: gets a sentence for each thing that only the user knows.

    Returns:
        Its column, with the unit.
    """
    column, value, _ = streams[name]
    kind = units.kind_of(name)
    unit = units.default_unit(name)
    if column.unit or kind not in units.KINDS:
        if column.unit and kind in units.KINDS and not fits(kind, column.unit):
            what = column.array or listed(map(str, column.columns))
            unsure.append(f"{name}: the unit of {what} is {column.unit!r}, expected one known unit, such as {unit!r}")
        return column
    acc = _beside(name, streams)
    if kind == "accelerometer":
        unit = plausible.acceleration_unit(value)
        if not unit:
            norm = plausible.median_norm(value)
            odd = f"median norm {norm:.4g} is neither m/s2 nor g" if np.isfinite(norm) else "no row of it is finite"
            unsure.append(f"{name}: {odd}; at rest it reads 1 g, 9.81 m/s2")
    elif kind == "magnetometer":
        unit = plausible.field_unit(value)
    elif kind == "gyroscope" and acc is not None:
        turned = _in_degrees(raw, name, streams)
        unit = "deg/s" if turned else unit
        if turned is None and plausible.too_fast(value):
            unit = _degrees(name, unsure)
        elif turned is None and (others := _as_others(raw, name, streams)):
            assumed.append(f"{name}: its motion does not tell its unit, taken from {others}")
            unit = "deg/s"
    elif kind == "gyroscope" and plausible.too_fast(value):
        unit = _degrees(name, unsure)
    elif kind == "joint_position" and (most := _largest(value)) > 4 * np.pi:
        unit = "deg"
        unsure.append(f"{name}: values up to {most:.4g}, in rad more than two turns, so probably in deg")
    elif kind == "orientation" and acc is not None:
        order = plausible.quaternion_order(value, acc)
        if order.endswith("inverse"):
            unsure.append(f"{name}: seems to map earth to sensor; jaxest's maps sensor to earth")
        if order.startswith("xyzw"):
            assumed.append(f"{name}: quaternions taken as xyzw, as they put gravity in place")
            column = column._replace(order="xyzw")
    assumed.append(f"{name}: unit {unit or 'unknown'} assumed")
    return column._replace(unit=unit)


def _in_degrees(raw: Raw, name: str, streams: dict[str, Found]) -> bool | None:
    """Say whether a gyroscope is in deg/s by how its accelerometer turned; None where this does not tell."""
    column, value, _ = streams[name]
    acc = _beside(name, streams)
    if acc is None or not fits("time", column.time_unit or "s"):
        return None
    return plausible.in_degrees(plausible.rate_check(_seconds(raw, column, len(value)), value, acc))


def _beside(name: str, streams: dict[str, Found]) -> NDArray[Any] | None:
    """Return the readings of the accelerometer of a stream's IMU, where they are as many as the stream's."""
    partner = f"{name.removesuffix(units.kind_of(name))}accelerometer"
    there = partner in streams and len(streams[partner].value) == len(streams[name].value)
    return streams[partner].value if there else None


def _as_others(raw: Raw, name: str, streams: dict[str, Found]) -> str:
    """Return which other gyroscope of the file is in deg/s, where all that tell are: one logger writes one unit."""
    others = [n for n in streams if units.kind_of(n) == "gyroscope" and n != name and not streams[n].column.unit]
    told = {n: _in_degrees(raw, n, streams) for n in others}
    known = [n for n, degrees in told.items() if degrees is not None]
    return known[0] if known and all(told[n] for n in known) else ""


def _degrees(name: str, unsure: list[str]) -> str:
    """Say that a gyroscope's rates cannot be rad/s, and return the unit to propose."""
    unsure.append(f"{name}: faster than any gyroscope in rad/s, so probably in deg/s")
    return "deg/s"


def _largest(value: NDArray[Any]) -> float:
    size = np.abs(value.astype(np.float64))
    return float(np.max(size[np.isfinite(size)], initial=0))


def _seconds(raw: Raw, column: Column, n: int) -> NDArray[np.float64]:
    if column.time is None:
        return np.arange(n) / (rate_of(raw, column.rate, raw.source) if column.rate is not None else 100.0)
    return units.seconds(_stamps(raw, column), column.time_unit or "s")


def _stamps(raw: Raw, column: Column) -> NDArray[Any]:
    at = column.time
    return raw.arrays[column.array][:, at] if isinstance(at, int) else raw.arrays[str(at)].ravel()
