"""Point clouds in files: PLY and PCD for viewers, NPZ for ourselves."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.files import existing, write_bytes
from jaxest.io import npz
from jaxest.types import InputError

SUFFIXES = (".ply", ".pcd", ".npz")
_PLY = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
        "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
        "float32": "f4", "float64": "f8"}  # fmt: skip


class Cloud(NamedTuple):
    """Points, with how many readings each stands for."""

    point: NDArray[np.float64]
    """(n, 3) m."""
    count: NDArray[np.float64]  # type: ignore[assignment]  # the word hides a method of tuple
    """(n,), 1 where a file does not say."""


def write_cloud(cloud: Cloud, path: str | Path) -> None:
    """Write points, whole or not at all; a file that is there is replaced.

    Args:
        cloud: the points.
        path: ends in `.ply` (binary), `.pcd` (binary) or `.npz`.

    Raises:
        InputError: another suffix, shapes that do not fit, or the file cannot be written.
    """
    path = Path(path)
    if _suffix(path) == ".npz":
        point, count = _checked(cloud, path)
        npz.save(path, {"point": point, "count": count}, overwrite=True)
        return
    write_bytes(path, encoded(cloud, path), overwrite=True)


def encoded(cloud: Cloud, path: str | Path) -> bytes:
    """Return the bytes of a file of points, for whoever writes files himself.

    Args:
        cloud: the points.
        path: ends in `.ply` or `.pcd`.

    Raises:
        InputError: another suffix, or shapes that do not fit.
    """
    path = Path(path)
    point, count = _checked(cloud, path)
    rows = np.column_stack([point, count]).astype("<f4")
    if _suffix(path, SUFFIXES[:2]) == ".ply":
        names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "count"))
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{names}end_header\n"
    else:
        head = (
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z count\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
            f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA binary\n"
        )
    return head.encode() + rows.tobytes()


def _checked(cloud: Cloud, path: Path) -> Cloud:
    point = np.asarray(cloud.point, float).reshape(-1, 3) if np.size(cloud.point) else np.zeros((0, 3))
    count = np.asarray(cloud.count, float)
    if count.shape != (len(point),):
        raise InputError(f"{path}: {count.shape} counts for {len(point)} points")
    return Cloud(point, count)


def read_cloud(path: str | Path) -> Cloud:
    """Read points.

    Args:
        path: a PLY (ASCII or binary), PCD (ASCII or binary) or NPZ file; fields other than x, y, z, count are skipped.

    Returns:
        The points that are finite.

    Raises:
        InputError: no such file, or it is no point cloud; the message says why.
    """
    path = Path(path)
    suffix = _suffix(path)
    if suffix == ".npz":
        point, count = _npz(path)
    else:
        data = existing(path).read_bytes()
        table = _ply(path, data) if suffix == ".ply" else _pcd(path, data)
        missing = [name for name in "xyz" if name not in (table.dtype.names or ())]
        if missing:
            raise InputError(f"{path}: has no field {', '.join(missing)}; found {', '.join(table.dtype.names or ())}")
        with np.errstate(invalid="ignore"):  # of signalling NaNs, which are left out below
            point = np.column_stack([table[name].astype(float) for name in "xyz"])
            known = "count" in (table.dtype.names or ())
            count = table["count"].astype(float) if known else np.ones(len(point))
    good = np.isfinite(point).all(axis=1)
    return Cloud(point[good], count[good])


def _suffix(path: Path, known: Sequence[str] = SUFFIXES) -> str:
    if path.suffix.lower() not in known:
        raise InputError(f"{path}: ends in {path.suffix or 'nothing'!r}, expected one of {', '.join(known)}")
    return path.suffix.lower()


def _npz(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    raw = npz.load(path)
    if "point" not in raw.arrays:
        raise InputError(f"{path}: holds {', '.join(raw.arrays) or 'nothing'}, expected arrays 'point' and 'count'")
    point = raw.arrays["point"]
    count = raw.arrays.get("count", np.ones(point.shape[:1]))
    if point.ndim != 2 or point.shape[1] != 3 or count.shape != (len(point),):
        raise InputError(f"{path}: shapes {point.shape} and {count.shape}, expected (n, 3) and (n,)")
    if not {point.dtype.kind, count.dtype.kind} <= set("biuf"):
        raise InputError(f"{path}: points of {point.dtype} and counts of {count.dtype}, expected real numbers")
    return point.astype(np.float64), count.astype(np.float64)


def _ply(path: Path, data: bytes) -> NDArray[np.void]:
    head, mark, body = data.partition(b"end_header\n")
    lines = head.decode("ascii", "replace").split("\n")
    if not mark or lines[0].strip() != "ply":
        raise InputError(f"{path}: is no PLY file, it begins with {data[:12]!r}")
    kind, count, fields, inside = "", 0, [], False
    for line in lines[1:]:
        match line.split():
            case ["format", kind, *_]:
                pass
            case ["element", name, number, *_]:
                inside = name == "vertex"
                count = _number(path, line, number) if inside else count
            case ["property", code, name] if inside and code in _PLY:
                fields.append((name, _PLY[code]))
            case ["property", *_] if inside:
                raise InputError(f"{path}: property {line[:60]!r}, expected numbers")
    order = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}.get(kind)
    if order is None:
        raise InputError(f"{path}: format {kind!r}, expected ascii or binary")
    dtype = _dtype(path, [(name, order + code) for name, code in fields])
    return _table(path, body, count, dtype, kind == "ascii")


def _pcd(path: Path, data: bytes) -> NDArray[np.void]:
    found: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in found:
        end = data.find(b"\n", at)
        if end < 0 or len(found) > 40:
            raise InputError(f"{path}: is no PCD file, it has no line DATA")
        words = data[at:end].decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            found[words[0]] = words[1:]
        at = end + 1
    try:
        sizes, kinds, names = found["SIZE"], found["TYPE"], found["FIELDS"]
        repeats = [int(x) for x in found.get("COUNT", ["1"] * len(names))]
        code = {"F": "f", "I": "i", "U": "u"}
        fields = [(n, f"<{code[k]}{s}") if r == 1 else (n, f"<{code[k]}{s}", (r,))
                  for n, k, s, r in zip(names, kinds, sizes, repeats, strict=True)]  # fmt: skip
        count = _number(path, "POINTS", found["POINTS"][0])
    except (KeyError, ValueError, IndexError) as error:
        raise InputError(f"{path}: header without or with a wrong {error}") from None
    if found["DATA"] not in (["ascii"], ["binary"]):
        raise InputError(f"{path}: DATA {' '.join(found['DATA'])}, expected ascii or binary")
    return _table(path, data[at:], count, _dtype(path, fields), found["DATA"] == ["ascii"])


def _number(path: Path, line: str, text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 16):
        raise InputError(f"{path}: {line[:60]!r}: found {text[:30]!r}, expected a number of points")
    return int(text)


def _dtype(path: Path, fields: list[Any]) -> np.dtype[Any]:
    """The layout of a point, of single numbers under different names."""
    try:
        dtype = np.dtype(fields)
        if not fields or not all(dtype[i].base.kind in "iuf" for i in range(len(fields))):
            raise ValueError("no fields of numbers")
        if any(dtype[name].shape for name in "xyz" if name in (dtype.names or ())):
            raise ValueError("several numbers in x, y or z")
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: fields that no point has ({error}), expected x, y, z and other numbers") from None
    return dtype


def _table(path: Path, body: bytes, count: int, dtype: np.dtype, text: bool) -> NDArray[np.void]:
    if not text:
        if len(body) < count * dtype.itemsize:
            raise InputError(f"{path}: {len(body)} bytes of points, expected {count * dtype.itemsize}")
        return np.frombuffer(body[: count * dtype.itemsize], dtype)
    rows = [tuple(line.split()) for line in body.decode("ascii", "replace").splitlines() if line.strip()][:count]
    wrong = next((i for i, row in enumerate(rows) if len(row) != len(dtype.names or ())), None)
    if len(rows) < count or wrong is not None:
        raise InputError(f"{path}: {len(rows)} rows of points, expected {count} of {len(dtype.names or ())} numbers")
    try:
        with np.errstate(over="ignore"):  # what a float32 cannot hold is infinite, and left out
            return np.array([tuple(float(x) for x in row) for row in rows], dtype)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: {error}") from None


__all__ = ["SUFFIXES", "Cloud", "encoded", "read_cloud", "write_cloud"]
