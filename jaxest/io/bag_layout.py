"""Where the fields of a ROS message are, so that thousands of messages of one layout are decoded at once.

Walking one message by its definition finds the bytes that fix the layout of everything behind them: lengths of strings
and sequences, and the strings themselves. Messages of the same length in which those bytes are equal have their numbers
at the same places, so that each field is one slice of an (n, length) array of bytes.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Definitions = Mapping[str, Any]
"""Fields of each message type as rosbags parses them: name -> (constants, ((field, (node, details)), ...))."""

_SIZES = {"bool": "u1", "byte": "u1", "octet": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2",
          "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4",
          "float64": "f8"}  # fmt: skip
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4  # rosbags.interfaces.Nodetype
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_STEM = 4  # bytes in front of a CDR message; alignment counts from behind them


class Field(NamedTuple):
    """Numbers at a fixed place."""

    offset: int
    dtype: np.dtype[Any]
    length: int | None
    """Numbers of an array or sequence; None for a single one."""


class Layout(NamedTuple):
    """One arrangement of the bytes of a message type."""

    fields: dict[str, Field]
    """By path, such as `header.stamp.sec`; members of the i-th struct of a sequence have `.i.` in theirs."""
    texts: dict[str, str]
    """Strings by path; those of a sequence end in `.0`, `.1`, ..."""
    fixed: tuple[tuple[int, bytes], ...]
    """Offset and content of the bytes that settle the layout."""


class _Walk(NamedTuple):
    """What is the same all the way down, and what is gathered."""

    raw: bytes
    definitions: Definitions
    order: str
    cdr: bool
    fields: dict[str, Field]
    texts: dict[str, str]
    fixed: list[tuple[int, bytes]]


def layout(raw: bytes, kind: str, definitions: Definitions, cdr: bool) -> Layout:
    """Find the layout of one message.

    Args:
        raw: the message.
        kind: its type, such as `sensor_msgs/msg/Imu`.
        definitions: of that type and of all that it is made of.
        cdr: whether it is in CDR (ROS 2) or in ROS 1's packed form.

    Returns:
        The layout.

    Raises:
        ValueError: the message is shorter than its type needs, or in a form that is not supported.
    """
    if cdr and raw[:2] not in (b"\0\0", b"\0\1"):
        raise ValueError(f"begins with {raw[:2].hex()}, expected plain CDR")
    order = ">" if cdr and raw[1] == 0 else "<"
    walk = _Walk(raw, definitions, order, cdr, {}, {}, [])
    if cdr:
        walk.fixed.append((0, raw[:2]))
    _struct(walk, _STEM if cdr else 0, kind, "")
    return Layout(walk.fields, walk.texts, tuple(_joined(walk.fixed)))


def _joined(spans: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """Put spans that touch into one."""
    found: list[tuple[int, bytes]] = []
    for start, content in spans:
        if found and found[-1][0] + len(found[-1][1]) == start:
            found[-1] = (found[-1][0], found[-1][1] + content)
        else:
            found.append((start, content))
    return found


def _struct(walk: _Walk, at: int, kind: str, path: str) -> int:
    if kind in _TIMES:
        members: Any = [("sec", (_BASE, ("int32", 0))), ("nanosec", (_BASE, ("uint32", 0)))]
    elif kind in walk.definitions:
        members = walk.definitions[kind][1]
    else:
        raise ValueError(f"the bag does not define {kind}")
    for name, what in members:
        at = _member(walk, at, what, f"{path}{name}")
    return at


def _member(walk: _Walk, at: int, what: Any, path: str) -> int:
    node, details = int(what[0]), what[1]
    if node == _NAME:
        return _struct(walk, at, details, f"{path}.")
    if node == _BASE:
        return _text(walk, at, path) if details[0] == "string" else _numbers(walk, at, details[0], None, path)
    inner, count = details
    if node == _SEQUENCE:
        at, count = _count(walk, at)
    elif node != _ARRAY:
        raise ValueError(f"{path} is of a kind that is not supported ({node})")
    if int(inner[0]) == _BASE and inner[1][0] != "string":
        return _numbers(walk, at, inner[1][0], count, path)
    if count > len(walk.raw):  # of parts without a byte, say, which would never end
        raise ValueError(f"{path} claims {count} parts in {len(walk.raw)} bytes")
    for i in range(count):
        at = _member(walk, at, inner, f"{path}.{i}")
    return at


def _count(walk: _Walk, at: int) -> tuple[int, int]:
    start = _aligned(walk, at, 4)
    content = _bytes(walk, start, 4)
    walk.fixed.append((start, content))
    return start + 4, int.from_bytes(content, "little" if walk.order == "<" else "big")


def _text(walk: _Walk, at: int, path: str) -> int:
    at, length = _count(walk, at)
    content = _bytes(walk, at, length)
    walk.fixed.append((at, content))
    walk.texts[path] = content.rstrip(b"\0").decode(errors="replace")
    return at + length


def _numbers(walk: _Walk, at: int, name: str, count: int | None, path: str) -> int:
    if name not in _SIZES:
        raise ValueError(f"{path} is of type {name}, which is not supported")
    dtype = np.dtype(walk.order + _SIZES[name])
    at = _aligned(walk, at, dtype.itemsize) if count != 0 else at
    size = dtype.itemsize * (1 if count is None else count)
    if at + size > len(walk.raw):
        raise ValueError(f"ends after {len(walk.raw)} bytes, expected {at + size} or more for {path}")
    walk.fields[path] = Field(at, dtype, count)
    return at + size


def _aligned(walk: _Walk, at: int, size: int) -> int:
    return at + (-(at - _STEM) % size) if walk.cdr else at


def _bytes(walk: _Walk, at: int, size: int) -> bytes:
    if at + size > len(walk.raw):
        raise ValueError(f"ends after {len(walk.raw)} bytes, expected {at + size} or more")
    return walk.raw[at : at + size]


def matching(block: NDArray[np.uint8], item: Layout) -> NDArray[np.bool_]:
    """Say which messages have a layout.

    Args:
        block: (n, length) messages of the length of the one that the layout is of.
        item: the layout.

    Returns:
        (n,) bool.
    """
    same = np.ones(len(block), bool)
    for start, content in item.fixed:
        same &= (block[:, start : start + len(content)] == np.frombuffer(content, np.uint8)).all(axis=1)
    return same


def values(block: NDArray[np.uint8], item: Layout, path: str) -> NDArray[Any]:
    """Return a field of each message.

    Args:
        block: (n, length) messages of that layout.
        item: the layout.
        path: of a field.

    Returns:
        (n,) or (n, count), a copy.
    """
    field = item.fields[path]
    count = 1 if field.length is None else field.length
    part = np.ascontiguousarray(block[:, field.offset : field.offset + count * field.dtype.itemsize])
    found = part.view(field.dtype).astype(field.dtype.newbyteorder("="), copy=True) if count else np.zeros(
        (len(block), 0), field.dtype.newbyteorder("=")
    )  # fmt: skip
    return found[:, 0] if field.length is None else found
