"""The messages of a bag one after the other: through rosbags, and record by record where a file is damaged.

rosbags needs the index at a file's end, which a recording that broke off does not have. The scans below read a file
from its beginning and raise `EOFError` or another error where it breaks; what came before stands.
"""

import bz2
import contextlib
import sqlite3
import struct
import sys
import zlib
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

_MCAP = b"\x89MCAP0\r\n"
_ROS1 = b"#ROSBAG V2.0\n"


def indexed(path: Path, channels: Channels, wanted: Wanted) -> Messages:
    """Read a bag through rosbags, in the order of the bag's stamps.

    Args:
        path: a `.bag`, `.mcap` or `.db3` file, or the folder of a ROS 2 bag.
        channels: filled with what the bag has, before the first message.
        wanted: which channels to read.

    Yields:
        Messages.
    """
    one = path.suffix.lower() == ".bag"
    for part in sorted(path.glob("*.mcap")) if path.is_dir() else [path]:
        _refuse_excess(part)
    with need("rosbags.rosbag1" if one else "rosbags.rosbag2", "bags", path).Reader(path) as reader:
        for c in reader.connections:
            idl = c.msgdef.format.name == "IDL"
            channels[c.id] = Channel(c.topic, c.msgtype, c.msgdef.data, idl, not one, c.msgcount)
        chosen = [c for c in reader.connections if wanted(channels[c.id])]
        if chosen:  # none would mean all
            for connection, stamp, raw in reader.messages(chosen):
                yield connection.id, stamp, raw


def scan(path: Path, channels: Channels, wanted: Wanted) -> Messages:
    """Read a bag record by record, as far as it is whole.

    Args:
        path: as for `indexed`; of a folder, its storage files one after the other.
        channels: filled as channels are met.
        wanted: which channels to read.

    Yields:
        Messages in the order in which they were written.

    Raises:
        EOFError: the file breaks off; the message says where. A damaged record raises whatever reading it raises.
    """
    if path.is_dir():
        for part in sorted(p for p in path.iterdir() if p.suffix in (".mcap", ".db3")):
            own: Channels = {}
            base = len(channels)
            for key, stamp, raw in scan(part, own, wanted):
                channels.update({base + k: c for k, c in own.items() if base + k not in channels})
                yield base + key, stamp, raw
        return
    scanner = {".mcap": _scan_mcap, ".bag": _scan_ros1, ".db3": _scan_sqlite}[path.suffix.lower()]
    yield from scanner(path, channels, wanted)


def _decompress(path: Path, kind: str, data: bytes, whole: int) -> bytes:
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


def _refuse_excess(path: Path) -> None:
    """Look at what chunks say of their sizes, before rosbags unpacks them; a broken file is left to the readers."""
    if path.suffix.lower() not in (".mcap", ".bag"):
        return
    claimed, size = 0, path.stat().st_size
    with path.open("rb") as file, contextlib.suppress(EOFError, KeyError, struct.error, UnicodeDecodeError):
        one = file.read(len(_ROS1)) == _ROS1
        file.seek(len(_ROS1) if one else len(_MCAP))
        while file.tell() < size:
            if one:
                header = _ros1_header(_exactly(file, _length(file, size), size, "record"))
                length = _length(file, size)
                claimed += int.from_bytes(header["size"], "little") if header["op"] == b"\x05" else 0
            else:
                op, length = struct.unpack("<BQ", _exactly(file, 9, size, "record"))
                if op == 0x06:
                    claimed += struct.unpack("<16xQ", _exactly(file, 24, size, "chunk"))[0]
                    length -= 24
            refuse_excess(path, "its chunks", claimed, size)
            if not 0 <= length <= size:
                return
            file.seek(length, 1)


def _length(file: IO[bytes], size: int) -> int:
    return int.from_bytes(_exactly(file, 4, size, "record"), "little")


def _exactly(file: IO[bytes], count: int, size: int, what: str) -> bytes:
    """Read so many bytes of a file of that size."""
    at = file.tell()
    if at + count > size:
        raise EOFError(f"breaks off in the {what} at byte {at}: the file ends at byte {size}")
    return file.read(count)


def _string(data: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", data, at)
    if at + 4 + length > len(data):
        raise ValueError("a text is longer than its record")
    return data[at + 4 : at + 4 + length].decode(), at + 4 + length


def _scan_mcap(path: Path, channels: Channels, wanted: Wanted) -> Messages:
    size, schemas = path.stat().st_size, dict[int, tuple[str, str, str]]()
    with path.open("rb") as file:
        if file.read(8) != _MCAP:
            raise EOFError("does not begin as an MCAP file does")
        while True:
            at = file.tell()
            if at == size:
                raise EOFError(f"ends at byte {size} without its footer")
            op, length = struct.unpack("<BQ", _exactly(file, 9, size, "record"))
            if op == 0x02:
                return
            if op == 0x06 and at + 9 + length > size:
                yield from _mcap_cut(file.read(), schemas, channels, wanted)
                raise EOFError(f"breaks off in the chunk at byte {at}: the file ends at byte {size}")
            if op == 0x06:
                chunk = _mcap_chunk(path, _exactly(file, length, size, "chunk"), at)
                yield from _mcap_records(chunk, schemas, channels, wanted)
            elif op in (0x03, 0x04, 0x05):
                record = struct.pack("<BQ", op, length) + _exactly(file, length, size, "record")
                yield from _mcap_records(record, schemas, channels, wanted)
            elif length > size - file.tell():
                raise EOFError(f"breaks off in the record at byte {at}: the file ends at byte {size}")
            else:
                file.seek(length, 1)


def _mcap_cut(record: bytes, schemas: dict[int, tuple[str, str, str]], channels: Channels, wanted: Wanted) -> Messages:
    """Read the messages of a chunk that has lost its end, if it is not compressed."""
    with contextlib.suppress(ValueError, struct.error):
        kind, start = _string(record, 28)
        if not kind:
            yield from _mcap_records(record[start + 8 :], schemas, channels, wanted)


def _mcap_chunk(path: Path, record: bytes, at: int) -> bytes:
    _, _, whole, crc = struct.unpack_from("<QQQI", record)
    kind, start = _string(record, 28)
    try:
        data = _decompress(path, kind, record[start + 8 :], whole)
    except Exception as error:  # each decompressor has its own
        raise ValueError(f"the chunk at byte {at} is damaged ({error})") from error
    if len(data) != whole or (crc and zlib.crc32(data) != crc):
        raise ValueError(f"the chunk at byte {at} is damaged: its length or checksum is not what it says")
    return data


def _mcap_records(
    data: bytes, schemas: dict[int, tuple[str, str, str]], channels: Channels, wanted: Wanted
) -> Messages:
    """Read schemas, channels and messages of a piece of an MCAP file."""
    at, end = 0, len(data)
    chosen = {key for key, channel in channels.items() if wanted(channel)}
    while at + 9 <= end:
        op, length = struct.unpack_from("<BQ", data, at)
        at += 9
        if at + length > end:
            raise ValueError("a record is longer than its chunk")
        if op == 0x05:
            key, _, stamp = struct.unpack_from("<HIQ", data, at)
            if key in chosen:
                yield key, stamp, data[at + 22 : at + length]
        elif op == 0x03:
            (key,) = struct.unpack_from("<H", data, at)
            name, place = _string(data, at + 2)
            encoding, place = _string(data, place)
            schemas[key] = name, encoding, _string(data, place)[0]
        elif op == 0x04:
            key, schema = struct.unpack_from("<HH", data, at)
            topic, place = _string(data, at + 4)
            cdr = _string(data, place)[0] == "cdr"
            name, encoding, text = schemas.get(schema, ("", "", ""))
            kind = name if cdr else f"{name} that is not in CDR"
            channels[key] = Channel(topic, kind, text, encoding != "ros2msg", True)
            if wanted(channels[key]):
                chosen.add(key)
        at += length


def _ros1_header(data: bytes) -> dict[str, bytes]:
    found, at = {}, 0
    while at < len(data):
        (length,) = struct.unpack_from("<I", data, at)
        name, _, value = data[at + 4 : at + 4 + length].partition(b"=")
        found[name.decode()] = value
        at += 4 + length
    return found


def _ros1_record(file: IO[bytes], size: int) -> tuple[dict[str, bytes], bytes]:
    header = _exactly(file, _length(file, size), size, "record")
    return _ros1_header(header), _exactly(file, _length(file, size), size, "record")


def _scan_ros1(path: Path, channels: Channels, wanted: Wanted) -> Messages:
    import io

    size, index = path.stat().st_size, 0
    with path.open("rb") as file:
        if file.read(len(_ROS1)) != _ROS1:
            raise EOFError("does not begin as a ROS 1 bag of version 2.0 does")
        while file.tell() < (index or size):
            at = file.tell()
            header, data = _ros1_record(file, size)
            if header["op"] == b"\x03":
                index = int.from_bytes(header["index_pos"], "little")
            elif header["op"] == b"\x05":
                try:
                    whole = int.from_bytes(header["size"], "little")
                    chunk = _decompress(path, header["compression"].decode(), data, whole)
                    if len(chunk) != whole:
                        raise ValueError("its length is not what it says")
                except Exception as error:  # each decompressor has its own
                    raise ValueError(f"the chunk at byte {at} is damaged ({error})") from error
                inner = io.BytesIO(chunk)
                while inner.tell() < len(chunk):
                    yield from _ros1_message(*_ros1_record(inner, len(chunk)), channels, wanted)
            else:
                yield from _ros1_message(header, data, channels, wanted)
    if not index:
        raise EOFError(f"was never closed: it ends at byte {size} without an index")


def _ros1_message(header: dict[str, bytes], data: bytes, channels: Channels, wanted: Wanted) -> Messages:
    if header["op"] == b"\x07":
        more = _ros1_header(data)
        package, _, name = more["type"].decode().partition("/")
        key = int.from_bytes(header["conn"], "little")
        text = more["message_definition"].decode()
        channels[key] = Channel(header["topic"].decode(), f"{package}/msg/{name}", text, False, False)
    elif header["op"] == b"\x02":
        key = int.from_bytes(header["conn"], "little")
        if wanted(channels[key]):
            seconds, rest = struct.unpack("<II", header["time"])
            yield key, seconds * 10**9 + rest, data


def _scan_sqlite(path: Path, channels: Channels, wanted: Wanted) -> Messages:
    connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    try:
        connection.execute("PRAGMA writable_schema = ON")  # else SQLite opens no file that has lost its end
        definitions: dict[str, tuple[str, bool]] = {}
        if connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
            rows = connection.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            definitions = {kind: (str(text), encoding == "ros2idl") for kind, encoding, text in rows}
        for key, topic, kind in connection.execute("SELECT id, name, type FROM topics"):
            text, idl = definitions.get(kind, ("", False))
            channels[key] = Channel(topic, kind, text, idl, True)
        for key, stamp, raw in connection.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
            if wanted(channels[key]):
                yield key, stamp, raw
    finally:
        connection.close()
