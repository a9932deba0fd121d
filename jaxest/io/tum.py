"""TUM trajectory files: lines `timestamp tx ty tz qx qy qz qw`, in s and m, the quaternion's w last.

They hold one pose: the streams `position` (m) and `orientation` (wxyz, as everywhere in jaxest).
"""

import numpy as np

from jaxest.files import PathLike, existing, write_text
from jaxest.io.log import SensorLog, Stream, check, finite_rows
from jaxest.types import InputError

_WXYZ, _XYZW = [3, 0, 1, 2], [1, 2, 3, 0]


def read_log(path: PathLike) -> SensorLog:
    """Read a trajectory.

    Args:
        path: the file; lines that begin with `#` are comments.

    Returns:
        The log, checked, with the streams `position` and `orientation`.

    Raises:
        InputError: not text, no poses, or a line that is not eight numbers, with how many lines before it are good.
    """
    path = existing(path)
    rows: list[list[float]] = []
    try:
        text = path.read_text("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not text; expected lines of eight numbers") from error
    for number, line in enumerate(text.splitlines(), 1):
        cells = line.replace(",", " ").split()
        if not cells or cells[0].startswith("#"):
            continue
        try:
            row = [float(cell) for cell in cells]
        except ValueError as error:
            raise InputError(f"{path}: line {number}: {error}; the {len(rows)} poses before it can be read") from error
        if len(row) != 8:
            raise InputError(
                f"{path}: line {number}: {len(row)} numbers, expected 8 (timestamp tx ty tz qx qy qz qw); the "
                f"{len(rows)} poses before it can be read"
            )
        rows.append(row)
    if not rows:
        raise InputError(f"{path}: the log is empty: it holds no poses")
    table = np.array(rows)
    time, notes = table[:, 0].copy(), ("quaternions are stored xyzw in TUM files and wxyz here",)
    streams = {
        "position": Stream(time, table[:, 1:4].copy(), "m"),
        "orientation": Stream(time, table[:, 4:][:, _WXYZ], "1"),
    }
    return check(SensorLog(streams, str(path), notes))


def write_log(log: SensorLog, path: PathLike, overwrite: bool = False) -> None:
    """Write the one pose of a log; further streams, such as a covariance, are an error, as TUM files hold no more.

    Args:
        log: a checked log with `position` and `orientation`, alone or behind a common prefix (`tool/position`).
        path: where it goes.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: no pose or several, other streams, different stamps, or a pose that is not finite; or the output
            exists or cannot be written.
    """
    owners = {name.rpartition("/")[0] for name in log.streams}
    prefix = f"{owners.pop()}/" if len(owners) == 1 and owners != {""} else ""
    wanted = {f"{prefix}position", f"{prefix}orientation"}
    if set(log.streams) != wanted:
        raise InputError(
            f"{path}: a TUM file holds one pose, the streams position and orientation; this log has "
            f"{', '.join(sorted(log.streams))}"
        )
    position, orientation = log.streams[f"{prefix}position"], log.streams[f"{prefix}orientation"]
    if not np.array_equal(position.time, orientation.time):
        raise InputError(f"{path}: position and orientation have different stamps, expected one pose at each")
    if position.value.shape[1:] != (3,) or position.unit not in ("m", ""):
        raise InputError(f"{path}: position is {position.value.shape} in {position.unit!r}, expected (n, 3) in m")
    bad = ~(finite_rows(position.value) & finite_rows(orientation.value))
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            f"{path}: the pose of row {row} at {position.time[row]:.6f} s is not finite ({int(bad.sum())} of "
            f"{len(bad)} rows); a TUM file cannot hold it, leave such rows out"
        )
    table = [position.time.astype(str), *(position.value.astype(str).T), *(orientation.value.astype(str)[:, _XYZW].T)]
    lines = (" ".join(row) for row in zip(*table, strict=True))
    write_text(path, "\n".join(["# timestamp tx ty tz qx qy qz qw", *lines, ""]), overwrite)
