"""ROS 1 bags record by record, as far as they are whole."""

import io
import struct
from pathlib import Path
from typing import IO

from jaxest.io.bag_records import Channel, Channels, Messages, Wanted, decompress, exactly

MAGIC = b"#ROSBAG V2.0\n"


def claimed(file: IO[bytes], size: int) -> tuple[int, int]:
    """Read the header of a record.

    Args:
        file: at the record's beginning.
        size: of the file, bytes.

    Returns:
        How many bytes a chunk in it claims to have once it is unpacked, and how many of the record are left.
    """
    header = _header(exactly(file, _length(file, size), size, "record"))
    length = _length(file, size)
    return (int.from_bytes(header["size"], "little") if header["op"] == b"\x05" else 0), length


def scan(path: Path, channels: Channels, wanted: Wanted) -> Messages:
    """Read a bag; arguments and errors as `bag_scan.scan`."""
    size, index = path.stat().st_size, 0
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise EOFError("does not begin as a ROS 1 bag of version 2.0 does")
        while file.tell() < (index or size):
            at = file.tell()
            header, data = _record(file, size)
            if header["op"] == b"\x03":
                index = int.from_bytes(header["index_pos"], "little")
            elif header["op"] == b"\x05":
                try:
                    whole = int.from_bytes(header["size"], "little")
                    chunk = decompress(path, header["compression"].decode(), data, whole)
                    if len(chunk) != whole:
                        raise ValueError("its length is not what it says")
                except Exception as error:  # each decompressor has its own
                    raise ValueError(f"the chunk at byte {at} is damaged ({error})") from error
                inner = io.BytesIO(chunk)
                while inner.tell() < len(chunk):
                    yield from _message(*_record(inner, len(chunk)), channels, wanted)
            else:
                yield from _message(header, data, channels, wanted)
    if not index:
        raise EOFError(f"was never closed: it ends at byte {size} without an index")


def _message(header: dict[str, bytes], data: bytes, channels: Channels, wanted: Wanted) -> Messages:
    if header["op"] == b"\x07":
        more = _header(data)
        package, _, name = more["type"].decode().partition("/")
        key = int.from_bytes(header["conn"], "little")
        text = more["message_definition"].decode()
        channels[key] = Channel(header["topic"].decode(), f"{package}/msg/{name}", text, False, False)
    elif header["op"] == b"\x02":
        key = int.from_bytes(header["conn"], "little")
        if wanted(channels[key]):
            seconds, rest = struct.unpack("<II", header["time"])
            yield key, seconds * 10**9 + rest, data


def _record(file: IO[bytes], size: int) -> tuple[dict[str, bytes], bytes]:
    header = exactly(file, _length(file, size), size, "record")
    return _header(header), exactly(file, _length(file, size), size, "record")


def _header(data: bytes) -> dict[str, bytes]:
    found, at = {}, 0
    while at < len(data):
        (length,) = struct.unpack_from("<I", data, at)
        name, _, value = data[at + 4 : at + 4 + length].partition(b"=")
        found[name.decode()] = value
        at += 4 + length
    return found


def _length(file: IO[bytes], size: int) -> int:
    return int.from_bytes(exactly(file, 4, size, "record"), "little")
