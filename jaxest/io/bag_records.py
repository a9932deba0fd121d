"""What a bag is made of, whatever its format: channels, messages, and bytes that may be missing or compressed."""

import bz2
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, NamedTuple

from jaxest.io.extras import need
from jaxest.io.growth import refuse_excess


class Channel(NamedTuple):
    """One publisher's messages of one topic."""

    topic: str
    kind: str
    """Message type, as in `sensor_msgs/msg/Imu`."""
    definition: str
    """Of the type and all that it is made of; empty where the bag has none."""
    idl: bool
    cdr: bool
    """Whether messages are in ROS 2's form rather than in ROS 1's."""
    messages: int | None = None
    """Of messages, where the index says."""


Channels = dict[int, Channel]
Messages = Iterator[tuple[int, int, bytes]]
"""Key of the channel, the bag's own stamp (ns), and the message."""
Wanted = Callable[[Channel], bool]


def exactly(file: IO[bytes], count: int, size: int, what: str) -> bytes:
    """Read so many bytes of a file of that size."""
    at = file.tell()
    if at + count > size:
        raise EOFError(f"breaks off in the {what} at byte {at}: the file ends at byte {size}")
    return file.read(count)


def decompress(path: Path, kind: str, data: bytes, whole: int) -> bytes:
    """Return a chunk, which says that it has `whole` bytes; no more than one above that is ever made."""
    if kind in ("", "none"):
        return data
    refuse_excess(path, "a chunk", whole, len(data))
    if kind == "bz2":
        return bz2.BZ2Decompressor().decompress(data, whole + 1)
    if kind == "lz4":
        return bytes(need("lz4.frame", "bags", path).LZ4FrameDecompressor().decompress(data, whole + 1))
    if kind == "zstd":
        module = need("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd", "bags", path)
        return bytes(module.ZstdDecompressor().decompress(data, whole + 1))
    raise ValueError(f"chunk compression {kind!r} is not supported")
