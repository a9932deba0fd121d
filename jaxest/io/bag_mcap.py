"""MCAP files record by record, as far as they are whole."""

import contextlib
import struct
import zlib
from pathlib import Path
from typing import IO

from jaxest.io.bag_records import Channel, Channels, Messages, Wanted, decompress, exactly

MAGIC = b"\x89MCAP0\r\n"
Schemas = dict[int, tuple[str, str, str]]
"""Name, encoding and text, by number."""


def claimed(file: IO[bytes], size: int) -> tuple[int, int]:
    """Read the head of a record.

    Args:
        file: at the record's beginning.
        size: of the file, bytes.

    Returns:
        How many bytes a chunk in it claims to have once it is unpacked, and how many of the record are left.
    """
    op, length = struct.unpack("<BQ", exactly(file, 9, size, "record"))
    if op != 0x06:
        return 0, length
    return struct.unpack("<16xQ", exactly(file, 24, size, "chunk"))[0], length - 24


def scan(path: Path, channels: Channels, wanted: Wanted) -> Messages:
    """Read a file; arguments and errors as `bag_scan.scan`."""
    size, schemas = path.stat().st_size, Schemas()
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise EOFError("does not begin as an MCAP file does")
        while True:
            at = file.tell()
            if at == size:
                raise EOFError(f"ends at byte {size} without its footer")
            op, length = struct.unpack("<BQ", exactly(file, 9, size, "record"))
            if op == 0x02:
                return
            if op == 0x06 and at + 9 + length > size:
                yield from _cut(file.read(), schemas, channels, wanted)
                raise EOFError(f"breaks off in the chunk at byte {at}: the file ends at byte {size}")
            if op == 0x06:
                chunk = _chunk(path, exactly(file, length, size, "chunk"), at)
                yield from _records(chunk, schemas, channels, wanted)
            elif op in (0x03, 0x04, 0x05):
                record = struct.pack("<BQ", op, length) + exactly(file, length, size, "record")
                yield from _records(record, schemas, channels, wanted)
            elif length > size - file.tell():
                raise EOFError(f"breaks off in the record at byte {at}: the file ends at byte {size}")
            else:
                file.seek(length, 1)


def _cut(record: bytes, schemas: Schemas, channels: Channels, wanted: Wanted) -> Messages:
    """Read the messages of a chunk that has lost its end, if it is not compressed."""
    with contextlib.suppress(ValueError, struct.error):
        kind, start = _string(record, 28)
        if not kind:
            yield from _records(record[start + 8 :], schemas, channels, wanted)


def _chunk(path: Path, record: bytes, at: int) -> bytes:
    _, _, whole, crc = struct.unpack_from("<QQQI", record)
    kind, start = _string(record, 28)
    try:
        data = decompress(path, kind, record[start + 8 :], whole)
    except Exception as error:  # each decompressor has its own
        raise ValueError(f"the chunk at byte {at} is damaged ({error})") from error
    if len(data) != whole or (crc and zlib.crc32(data) != crc):
        raise ValueError(f"the chunk at byte {at} is damaged: its length or checksum is not what it says")
    return data


def _records(data: bytes, schemas: Schemas, channels: Channels, wanted: Wanted) -> Messages:
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


def _string(data: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", data, at)
    if at + 4 + length > len(data):
        raise ValueError("a text is longer than its record")
    return data[at + 4 : at + 4 + length].decode(), at + 4 + length
