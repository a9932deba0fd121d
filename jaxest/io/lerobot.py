"""LeRobot datasets: a folder with `meta/info.json` and Parquet files, in the layouts v2 (a file an episode) and v3.

Each episode restarts its clock, so that each has streams of its own: `episode0/observation.state`, `episode0/action`,
with the names that info.json gives to their columns. Units differ from one dataset to the next (rad, degrees, percent
of a range) and are not recorded; state them in a column table. Videos, images and text are listed in the notes.
"""

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike
from jaxest.io.arrow import read_table, to_numpy
from jaxest.io.log import SensorLog, Stream, check
from jaxest.types import InputError

_INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")
_NUMBERS = ("float16", "float32", "float64", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64",
            "bool")  # fmt: skip


def is_dataset(path: PathLike) -> bool:
    """Say whether a folder holds a LeRobot dataset."""
    return (Path(path) / "meta" / "info.json").is_file()


def read(path: PathLike, *, episodes: Collection[int] = ()) -> SensorLog:
    """Read a dataset.

    Args:
        path: its folder.
        episodes: which episodes to read; all by default.

    Returns:
        The log, checked; each numeric feature of each episode is a stream on the episode's own clock.

    Raises:
        InputError: pyarrow is not installed; info.json is absent, damaged or lacks features; a Parquet file is
            damaged; a column has another shape than info.json says; or an episode is not there.
    """
    path = Path(path)
    info = _info(path)
    kinds = {name: str(entry.get("dtype")) for name, entry in info["features"].items()}
    wanted = [name for name, kind in kinds.items() if kind in _NUMBERS and name not in _INDICES]
    if not wanted:
        raise InputError(f"{path}: none of its features is numeric: {', '.join(kinds)}")
    streams: dict[str, Stream] = {}
    seen: set[int] = set()
    frames = 0
    for file in sorted((path / "data").glob("**/*.parquet")):
        table = read_table(file, [*wanted, "timestamp", "episode_index"])
        columns = {name: _column(file, table, name) for name in (*wanted, "timestamp", "episode_index")}
        frames += len(columns["timestamp"])
        for episode in np.unique(columns["episode_index"]):
            number = int(episode)
            seen.add(number)
            if not episodes or number in episodes:
                rows = np.flatnonzero(columns["episode_index"] == episode)
                _episode(path, streams, f"episode{number}", columns, rows, wanted, info["features"])
    if not seen:
        raise InputError(f"{path}: holds no episode: there is no Parquet file with rows in its folder data")
    absent = sorted(set(episodes) - seen)
    if absent:
        raise InputError(f"{path}: there is no episode {absent[0]}; it has {len(seen)}, {min(seen)} to {max(seen)}")
    return check(SensorLog(streams, str(path), _notes(info, kinds, wanted, len(seen), frames)))


def _info(path: Path) -> dict[str, Any]:
    file = path / "meta" / "info.json"
    if not file.is_file():
        raise InputError(f"{path}: has no meta/info.json, which a LeRobot dataset has")
    try:
        info = json.loads(file.read_text())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: is not JSON: {error}") from error
    features = info.get("features") if isinstance(info, dict) else None
    if not isinstance(features, dict) or not all(isinstance(entry, dict) for entry in features.values()):
        raise InputError(f"{file}: has no table of features")
    return dict(info)


def _column(file: Path, table: Any, name: str) -> NDArray[Any]:
    if name not in table.column_names:
        raise InputError(f"{file}: column {name!r} is missing; it has {', '.join(table.column_names) or 'none'}")
    try:
        value, blank = to_numpy(table[name])
    except ValueError as error:
        raise InputError(f"{file}: column {name!r} {error}") from error
    if blank.any():
        raise InputError(f"{file}: column {name!r} is empty in row {int(np.argmax(blank))}, expected a number")
    scalar = name in ("timestamp", "episode_index")
    return value.reshape(len(value)) if scalar and value.size == len(value) else value


def _episode(
    path: Path, streams: dict[str, Stream], owner: str, columns: dict[str, NDArray[Any]], rows: NDArray[np.int64],
    wanted: list[str], features: dict[str, Any],
) -> None:  # fmt: skip
    time = columns["timestamp"][rows].astype(np.float64)
    for name in wanted:
        value, shape = columns[name][rows], tuple(int(n) for n in features[name].get("shape") or ())
        if value[:1].size != np.prod(shape, dtype=int):
            raise InputError(f"{path}: {owner}: {name} has {value[:1].size} numbers a frame, info.json says {shape}")
        value = value.reshape(len(value), *(() if shape == (1,) else shape))
        names = _names(features[name].get("names"))
        fits = value.ndim == 2 and len(names) == value.shape[1]
        stream = Stream(time, value, "", "", names if fits else ())
        key = f"{owner}/{name}"
        if key in streams:  # an episode that goes on in the next file
            before = streams[key]
            stream = before._replace(
                time=np.concatenate([before.time, time]), value=np.concatenate([before.value, value])
            )
        streams[key] = stream


def _names(stated: Any) -> tuple[str, ...]:
    """Names of a feature's columns, a list or a table with one (`{"motors": [...]}`)."""
    if isinstance(stated, dict):
        lists = [entry for entry in stated.values() if isinstance(entry, list)]
        flat = [entry for entry in stated if isinstance(stated[entry], int)]  # {"x": 0, "y": 1}
        stated = lists[0] if len(lists) == 1 else sorted(flat, key=stated.__getitem__)
    return tuple(map(str, stated)) if isinstance(stated, list) else ()


def _notes(
    info: dict[str, Any], kinds: dict[str, str], wanted: list[str], episodes: int, frames: int
) -> tuple[str, ...]:
    notes = ["LeRobot does not record units; each episode has its own clock"]
    left = [f"{name} ({kind})" for name, kind in kinds.items() if name not in wanted and name not in _INDICES]
    if left:
        notes.append(f"left out: {', '.join(left)}")
    if "fps" in info:
        notes.append(f"recorded at {info['fps']} frames a second")
    for found, key, what in ((episodes, "total_episodes", "episodes"), (frames, "total_frames", "frames")):
        if info.get(key, found) != found:
            notes.append(f"incomplete: {found} of the {info[key]} {what} that info.json states are there")
    return tuple(notes)
