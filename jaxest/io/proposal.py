"""A guess at the column table of somebody else's file, from its names, shapes and magnitudes.

What the data settle (an accelerometer of median norm 1 is in g) is applied and listed as assumed; what they leave open
(no sampling rate, two candidates for one stream) is listed as unsure, and the file is not read without an answer.
"""

import json
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.io import columns, plausible, units
from jaxest.io.columns import Column, ColumnTable
from jaxest.io.raw import Raw
from jaxest.io.words import Word, classify
from jaxest.types import InputError, listed

LONG = 100
"""Columns of a matrix of few rows from which on these are taken for its samples."""
_NO_JOINTS = {"heading", "course", "azimuth", "elevation", "lat", "lon", "latitude", "longitude", "phase"}
_EULER = {"roll", "pitch", "yaw", "heading"}


class Proposal(NamedTuple):
    """A guessed table."""

    table: ColumnTable
    assumed: tuple[str, ...]
    """What was taken for granted, one sentence each."""
    unsure: tuple[str, ...]
    """What only the user knows; not empty means that `read` needs a table."""


class _Found(NamedTuple):
    """A stream while it is being guessed."""

    column: Column
    value: NDArray[Any]
    owner: str


def guess(raw: Raw) -> Proposal:
    """Guess the column table of a file.

    Args:
        raw: the file.

    Returns:
        The proposal.

    Raises:
        InputError: a numeric column is damaged, or nothing looks like a stream.
    """
    if raw.broken:
        raise InputError(f"{raw.source}: {next(iter(raw.broken.values()))}")
    words = {name: _word(name, value) for name, value in raw.arrays.items()}
    assumed: list[str] = []
    unsure: list[str] = []
    found = _streams(raw, words, assumed, unsure)
    if not found:
        raise InputError(
            f"{raw.source}: nothing here looks like a stream; {raw.word}s: {_listing(raw)}. Say in a config which is "
            f"which:\n{_example(raw)}"
        )
    hollow = next((name for name, entry in found.items() if not len(entry.value)), None)
    if hollow is not None:
        raise InputError(f"{raw.source}: the log is empty: stream {hollow!r} has no rows")
    streams = {}
    for name, entry in found.items():
        column = _clock(raw, words, name, entry, assumed, unsure)
        streams[name] = entry._replace(column=column)
    left = [n for n in raw.arrays if not _used(n, words[n], streams)]
    if left:
        assumed.append(f"left out: {', '.join(left)}")
    assumed += [f"left out: {reason}" for reason in raw.refused.values()]
    table = {name: _with_unit(raw, name, streams, assumed, unsure) for name in streams}
    return Proposal(_shared(table), tuple(dict.fromkeys(assumed)), tuple(dict.fromkeys(unsure)))


def _word(name: str, value: NDArray[Any]) -> Word:
    """What a name says; dates are stamps whatever they are called."""
    word = classify(name)
    return word if value.dtype.kind != "M" or word.kind == "time" else Word("time", "", "", "")


def _listing(raw: Raw) -> str:
    entries = listed(f"{name} {value.shape}" for name, value in raw.arrays.items())
    return "; ".join([entries, *list(raw.refused.values())[:20]])


def _example(raw: Raw) -> str:
    """Lines of a config to be filled in, with names that the file has."""
    names = [n for n, value in raw.arrays.items() if value.ndim] or ["NAME"]
    wide = next((n for n in names if n in raw.arrays and raw.arrays[n].ndim == 2 and raw.arrays[n].shape[1] > 3), "")
    if wide:
        where = f"array = {json.dumps(wide)}\ncolumns = [1, 2, 3]\ntime = 0  # a column of it"
    elif raw.word == "column" and len(names) > 3:
        where = f"time = {json.dumps(names[0])}\ncolumns = {json.dumps(names[1:4])}"
    else:
        where = f"array = {json.dumps(names[0])}\nrate = 100.0  # Hz, or time = the name of the stamps"
    return f'[columns.gyroscope]  # and so on for "accelerometer", ...\n{where}\nunit = "rad/s"'


def _used(name: str, word: Word, streams: dict[str, _Found]) -> bool:
    for entry in streams.values():
        c = entry.column
        if name == c.array or name in c.columns or name in (c.time, c.rate):
            return True
    return word.kind == "period"


def _streams(raw: Raw, words: dict[str, Word], assumed: list[str], unsure: list[str]) -> dict[str, _Found]:
    """Find the streams by name; then take in what has as many rows as they have, then matrices of many columns."""
    found: dict[str, _Found] = {}
    groups: dict[tuple[str, str], list[str]] = {}
    rest = []
    clocks = {raw.arrays[n].size for n, w in words.items() if w.kind == "time"}
    for name, word in words.items():
        value = raw.arrays[name]
        if word.kind in ("time", "rate", "period") or value.ndim == 0 or value.dtype.kind not in "biuf":
            continue
        if value.ndim == 1 and word.component:
            groups.setdefault((word.kind, word.owner), []).append(name)
        elif word.kind:
            turned = _transposed(word.kind, value, clocks)
            if turned:
                unsure.append(f"{name} {value.shape}: seems transposed, expected (n, {len(value)})")
                value = value.T
            column = Column(array=name, unit=word.unit, transposed=turned)
            _add(found, _named(word.kind, value), column, value, word.owner, unsure)
        else:
            rest.append(name)
    for (kind, owner), names in groups.items():
        parts = {words[n].component for n in names}
        names = sorted(names, key=lambda n: _place(words[n].component))
        value = np.stack([raw.arrays[n] for n in names], axis=-1) if _equal(raw, names) else np.zeros((0, 0))
        units_of = {words[n].unit for n in names}
        column = Column(columns=tuple(names), unit=units_of.pop() if len(units_of) == 1 else "")
        kind = kind or ("position" if parts == {"x", "y", "z"} and _is_length(column.unit) else "")
        tilts = parts <= _EULER and len(parts) > 2  # of an IMU, which has no joints
        if kind and len(value) and _named(kind, value) and not (kind.startswith("joint") and tilts):
            joints = tuple(_called(n, words[n]) for n in names) if kind.startswith("joint") else ()
            _add(found, _named(kind, value), column._replace(names=joints), value, owner, unsure)
        else:
            rest += names
    rest = _joints_by_unit(raw, words, rest, found, assumed)
    rows = {len(entry.value) for entry in found.values()} | clocks
    for name in rest:
        value = raw.arrays[name]
        if not _matrix(found, name, value, assumed, unsure) and len(value) in rows and len(value) > 1:
            _add(found, name.strip("/") or "column", Column(array=name), value, words[name].owner, unsure, named=True)
            assumed.append(f"{name}: kept as a stream of its own, unit not known")
    return found


def _joints_by_unit(
    raw: Raw, words: dict[str, Word], rest: list[str], found: dict[str, _Found], assumed: list[str]
) -> list[str]:
    """Take columns called by a name and a unit of angles (`lift_deg`, `knee_deg`) for joints; return the rest."""
    angles = [n for n in rest if words[n].owner and words[n].unit and units.lookup(words[n].unit).si == "rad"]
    angles = [n for n in angles if raw.arrays[n].ndim == 1 and not words[n].component]
    called = [words[n].owner for n in angles]
    alike = len({words[n].unit for n in angles}) == 1 and _equal(raw, angles)
    if "joint_position" in found or len(angles) < 2 or not alike or _NO_JOINTS & set(called) or set(called) <= _EULER:
        return rest
    column = Column(columns=tuple(angles), unit=words[angles[0]].unit, names=tuple(called))
    found["joint_position"] = _Found(column, np.stack([raw.arrays[n] for n in angles], axis=-1), "")
    assumed.append(f"joint_position: {listed(angles)} taken for angles of joints, by their unit")
    return [n for n in rest if n not in angles]


def _called(name: str, word: Word) -> str:
    """A joint's name in its column's: `elbow` of `elbow_pos [deg]`; `q1` and `elbow_joint` are whole."""
    whole = word.component.isdigit() or "joint" in name.lower() or not word.component
    return name if whole else word.component


def _place(component: str) -> int:
    """Order of a component among others: a number's own, `wxyz`; joints by their names stay as they are in the file."""
    return int(component) if component.isdigit() else "wxyz".find(component)


def _transposed(kind: str, value: NDArray[Any], clocks: set[int]) -> bool:
    """Say whether a matrix has a column for each sample, by the stamps or by the number of components of its kind."""
    if value.ndim != 2:
        return False
    rows, columns = value.shape
    known = units.shape_of(kind)
    if known is None or kind == "accelerometer":  # `acc` may be of joints
        return rows not in clocks and (columns in clocks or columns >= max(LONG, 10 * rows))
    return (rows,) == known != (columns,)


def _is_length(unit: str) -> bool:
    return bool(unit) and units.lookup(unit).si == "m"


def _equal(raw: Raw, names: list[str]) -> bool:
    return len({raw.arrays[n].shape for n in names}) == 1


def _named(kind: str, value: NDArray[Any]) -> str:
    """Return the stream's name for a kind and shape: `q` of four columns may be a quaternion."""
    if kind == "joint_position" and value.ndim == 2 and value.shape[1] == 4:
        norm = plausible.median_norm(value)
        return "orientation" if abs(norm - 1) < 1e-2 and np.ptp(np.linalg.norm(value, axis=1)) < 1e-2 else kind
    if kind == "accelerometer" and value.ndim == 2 and value.shape[1] != 3:
        return "joint_acceleration"
    return kind


def _add(
    found: dict[str, _Found], kind: str, column: Column, value: NDArray[Any], owner: str, unsure: list[str],
    named: bool = False,
) -> None:  # fmt: skip
    name = f"{owner}/{kind}" if owner and not named else kind
    shape = units.shape_of(name)
    if shape is not None and value.shape[1:] != shape:
        what = column.array or ", ".join(map(str, column.columns))
        unsure.append(f"{name}: {what} has shape {value.shape}, expected (n, {shape[0]})")
        return
    if name in found:
        other = found[name].column
        unsure.append(f"{name}: both {other.array or other.columns} and {column.array or column.columns} could be it")
        name = f"{name}_{sum(n.startswith(name) for n in found) + 1}"
    found[name] = _Found(column, value, owner)


def _matrix(found: dict[str, _Found], name: str, value: NDArray[Any], assumed: list[str], unsure: list[str]) -> bool:
    """Take an unnamed (n, 7 or 8) array apart as stamps, a gyroscope and an accelerometer."""
    if value.ndim != 2 or value.shape[1] not in (7, 8) or value.dtype.kind != "f" or len(value) < 2:
        return False
    if not (np.diff(value[:, 0]) > 0).all():
        return False
    first = value.shape[1] - 6
    parts = [tuple(range(first, first + 3)), tuple(range(first + 3, first + 6))]
    norms = [plausible.median_norm(value[:, list(part)]) for part in parts]
    gyr, acc = parts if norms[0] < norms[1] else parts[::-1]
    owner = name if name != "imu" else ""
    time = 0
    for kind, part in (("gyroscope", gyr), ("accelerometer", acc)):
        _add(found, kind, Column(array=name, columns=part, time=time), value[:, list(part)], owner, unsure)
    unsure.append(
        f"{name} {value.shape}: column 0 may be stamps, columns {list(gyr)} a gyroscope and {list(acc)} an "
        f"accelerometer (median norms {norms[0]:.3g} and {norms[1]:.3g})"
    )
    return True


def _clock(raw: Raw, words: dict[str, Word], name: str, entry: _Found, assumed: list[str], unsure: list[str]) -> Column:
    """Find the stamps or the rate of a stream: those of the same owner first."""
    column, n = entry.column, len(entry.value)
    if column.time is not None:
        stamps, unit = raw.arrays[column.array][:, 0], ""
    else:
        times = [t for t, w in words.items() if w.kind == "time" and raw.arrays[t].size == n]
        times = [t for t in times if words[t].owner == entry.owner] or [t for t in times if not words[t].owner] or times
        if not times:
            return _rate(raw, words, name, entry, assumed, unsure)
        if len(times) > 1:
            unsure.append(f"{name}: stamps could be any of {', '.join(times)}")
        stamps, unit = raw.arrays[times[0]].ravel(), words[times[0]].unit
        column = column._replace(time=times[0])
    time_unit = unit or plausible.time_unit(stamps)
    if not time_unit:
        step = float(np.median(np.diff(stamps.astype(np.float64))))
        time_unit = plausible.likely_time_unit(step)
        likely = f"; {time_unit} is likely" if time_unit else ""
        unsure.append(f"{name}: the unit of its stamps {column.time!r} is open (median step {step:g}){likely}")
    elif time_unit != "s":
        assumed.append(f"stamps {column.time!r} taken as {time_unit}")
    return column._replace(time_unit=time_unit)


def _rate(raw: Raw, words: dict[str, Word], name: str, entry: _Found, assumed: list[str], unsure: list[str]) -> Column:
    scalars = {n: w for n, w in words.items() if w.kind in ("rate", "period") and raw.arrays[n].size == 1}
    mine = [n for n in scalars if scalars[n].owner == entry.owner] or [n for n in scalars if not scalars[n].owner]
    if not mine:
        unsure.append(f"{name}: no stamps of {len(entry.value)} rows and no sampling rate found; add rate = ... in Hz")
        return entry.column
    if len(mine) > 1:
        unsure.append(f"{name}: the sampling rate could be any of {', '.join(mine)}")
    value = float(raw.arrays[mine[0]].reshape(()))
    assumed.append(f"{mine[0]} = {value:.6g} taken as sampling {scalars[mine[0]].kind}")
    rate: float | str = 1 / value if scalars[mine[0]].kind == "period" and value > 0 else mine[0]
    return entry.column._replace(rate=rate)


def _with_unit(raw: Raw, name: str, streams: dict[str, _Found], assumed: list[str], unsure: list[str]) -> Column:
    """Settle the unit by the name, else by magnitude."""
    column, value, _ = streams[name]
    kind = units.kind_of(name)
    if column.unit or kind not in units.KINDS:
        return column
    unit = units.default_unit(name)
    partner = f"{name.removesuffix(kind)}accelerometer"
    acc = streams[partner].value if partner in streams and len(streams[partner].value) == len(value) else None
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


def _in_degrees(raw: Raw, name: str, streams: dict[str, _Found]) -> bool | None:
    """Say whether a gyroscope is in deg/s by how its accelerometer turned; None where this does not tell."""
    column, value, _ = streams[name]
    partner = f"{name.removesuffix('gyroscope')}accelerometer"
    if partner not in streams or len(streams[partner].value) != len(value):
        return None
    seconds = _seconds(raw, column, len(value))
    return plausible.in_degrees(plausible.rate_check(seconds, value, streams[partner].value))


def _as_others(raw: Raw, name: str, streams: dict[str, _Found]) -> str:
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
        return np.arange(n) / (columns.rate_of(raw, column.rate, raw.source) if column.rate is not None else 100.0)
    stamps = raw.arrays[column.array][:, 0] if isinstance(column.time, int) else raw.arrays[column.time].ravel()
    return columns.seconds(stamps, column.time_unit or "s")


def _shared(streams: dict[str, Column]) -> ColumnTable:
    """Move to the top what all streams have in common."""
    every = list(streams.values())
    table = ColumnTable(streams)
    first = every[0]
    if not isinstance(first.time, int) and all(
        (c.time, c.rate, c.time_unit) == (first.time, first.rate, first.time_unit) for c in every
    ):
        table = table._replace(time=first.time, rate=first.rate, time_unit=first.time_unit)
        streams = {name: c._replace(time=None, rate=None, time_unit="") for name, c in streams.items()}
    return table._replace(streams=streams)
