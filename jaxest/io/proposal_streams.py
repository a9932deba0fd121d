"""Which streams a file of somebody else's holds, by its names and shapes."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.io import plausible, units
from jaxest.io.columns import Column
from jaxest.io.raw import Raw
from jaxest.io.words import Word
from jaxest.types import listed

LONG = 100
"""Columns of a matrix of few rows from which on these are taken for its samples."""
_NO_JOINTS = {"heading", "course", "azimuth", "elevation", "lat", "lon", "latitude", "longitude", "phase"}
_EULER = {"roll", "pitch", "yaw", "heading"}


class Found(NamedTuple):
    """A stream while it is being guessed."""

    column: Column
    value: NDArray[Any]
    owner: str


def find(raw: Raw, words: dict[str, Word], assumed: list[str], unsure: list[str]) -> dict[str, Found]:
    """Find the streams by name; then take in what has as many rows as they have, then matrices of many columns.

    Args:
        raw: the file.
        words: what its names say.
        assumed: gets a sentence for each thing that is taken for granted.
        unsure: gets a sentence for each thing that only the user knows.

    Returns:
        The streams by name, without clocks, their units as names state them, known or not.
    """
    found: dict[str, Found] = {}
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
        stated = list(dict.fromkeys(words[n].unit for n in names))
        unit = stated[0] if len(stated) == 1 else ", ".join(text or "none" for text in stated) if kind else ""
        column = Column(columns=tuple(names), unit=unit)
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
    raw: Raw, words: dict[str, Word], rest: list[str], found: dict[str, Found], assumed: list[str]
) -> list[str]:
    """Take columns called by a name and a unit of angles (`lift_deg`, `knee_deg`) for joints; return the rest."""
    angles = [n for n in rest if words[n].owner and raw.arrays[n].ndim == 1 and not words[n].component]
    angles = [n for n in angles if words[n].unit and units.lookup(words[n].unit).si == "rad"]
    called = [words[n].owner for n in angles]
    alike = len({words[n].unit for n in angles}) == 1 and _equal(raw, angles)
    if "joint_position" in found or len(angles) < 2 or not alike or _NO_JOINTS & set(called) or set(called) <= _EULER:
        return rest
    column = Column(columns=tuple(angles), unit=words[angles[0]].unit, names=tuple(called))
    found["joint_position"] = Found(column, np.stack([raw.arrays[n] for n in angles], axis=-1), "")
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
    found: dict[str, Found], kind: str, column: Column, value: NDArray[Any], owner: str, unsure: list[str],
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
    found[name] = Found(column, value, owner)


def _matrix(found: dict[str, Found], name: str, value: NDArray[Any], assumed: list[str], unsure: list[str]) -> bool:
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
