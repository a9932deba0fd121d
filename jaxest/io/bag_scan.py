"""The messages of a bag one after the other: through rosbags, and record by record where a file is damaged.

rosbags needs the index at a file's end, which a recording that broke off does not have. The scans below read a file
from its beginning and raise `EOFError` or another error where it breaks; what came before stands.
"""

import contextlib
import sqlite3
import struct
from pathlib import Path

from jaxest.io import bag_mcap, bag_ros1
from jaxest.io.bag_records import Channel, Channels, Messages, Wanted
from jaxest.io.extras import need
from jaxest.io.growth import refuse_excess


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


def _refuse_excess(path: Path) -> None:
    """Look at what chunks say of their sizes, before rosbags unpacks them; a broken file is left to the readers."""
    if path.suffix.lower() not in (".mcap", ".bag"):
        return
    total, size = 0, path.stat().st_size
    with path.open("rb") as file, contextlib.suppress(EOFError, KeyError, struct.error, UnicodeDecodeError):
        form = bag_ros1 if file.read(len(bag_ros1.MAGIC)) == bag_ros1.MAGIC else bag_mcap
        file.seek(len(form.MAGIC))
        while file.tell() < size:
            claimed, length = form.claimed(file, size)
            total += claimed
            refuse_excess(path, "its chunks", total, size)
            if not 0 <= length <= size:
                return
            file.seek(length, 1)


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
    scanner = {".mcap": bag_mcap.scan, ".bag": bag_ros1.scan, ".db3": _scan_sqlite}[path.suffix.lower()]
    yield from scanner(path, channels, wanted)


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
