"""The messages of a bag decoded into typed arrays as they come, many of a topic at once."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.io.bag_layout import Definitions, Layout, layout, matching, values
from jaxest.io.bag_messages import TYPES, names_of
from jaxest.io.bag_records import Channel, Channels, Messages
from jaxest.io.extras import need
from jaxest.types import InputError

_MANY, _LARGE = 4096, 2**22  # messages or bytes of a topic that are decoded at once
_LATEST = 2**62  # ns, 146 years; later ones are damage
NS = 10**9


class Group(NamedTuple):
    """Messages of a topic that share a frame and a set of joints."""

    frame: str
    names: tuple[str, ...]
    parts: dict[str, tuple[str, list[Any], list[NDArray[np.int64]]]]
    """By quantity: unit, values in blocks, and which of the bag's messages they are from."""


class Topic(NamedTuple):
    """What has been decoded of a topic."""

    channel: Channel
    groups: dict[tuple[str, tuple[str, ...]], Group]
    header: list[NDArray[np.int64]]
    """Stamps (ns), in blocks."""
    bag: list[NDArray[np.int64]]
    """The bag's own (ns)."""
    number: list[NDArray[np.int64]]
    """Which of the bag's messages they are."""


class Bag(NamedTuple):
    """What has been read of a bag."""

    channels: Channels
    topics: dict[str, Topic]
    messages: int
    last: int
    """The bag's stamp of the last message, ns."""
    broken: str
    """Why reading stopped before the end, or nothing."""
    standard: bool
    """Whether a type was taken as ROS has it, as the bag does not define it."""


class _Waiting(NamedTuple):
    """Messages of one channel that are not decoded yet."""

    raws: list[bytes]
    stamps: list[int]
    numbers: list[int]
    bytes: list[int]
    """One number: how many."""


def collect(path: Path, messages: Messages, channels: Channels) -> Bag:
    """Decode messages as they come.

    Args:
        path: the bag, for error messages.
        messages: what to decode.
        channels: what they belong to; filled no later than their first message comes.

    Returns:
        Everything that was read until the messages ended or broke off.

    Raises:
        InputError: a message does not hold what its type says.
    """
    waiting: dict[int, _Waiting] = {}
    decoders: dict[int, _Decoder] = {}
    topics: dict[str, Topic] = {}
    count, last, broken = 0, 0, ""
    try:
        for key, stamp, raw in messages:
            if not abs(stamp) < _LATEST:
                raise InputError(f"{path}: message {count} is stamped {stamp} ns, expected a time before {_LATEST} ns")
            if key not in waiting:
                waiting[key] = _Waiting([], [], [], [0])
            mine = waiting[key]
            mine.raws.append(raw)
            mine.stamps.append(stamp)
            mine.numbers.append(count)
            mine.bytes[0] += len(raw)
            count, last = count + 1, stamp
            if len(mine.raws) >= _MANY or mine.bytes[0] >= _LARGE:
                _flush(path, waiting.pop(key), key, channels, decoders, topics)
    except InputError:
        raise
    except Exception as error:  # a damaged file makes rosbags and the decompressors fail in any way
        broken = str(error) or type(error).__name__
    for key, mine in waiting.items():
        _flush(path, mine, key, channels, decoders, topics)
    return Bag(channels, topics, count, last, broken, any(d.standard for d in decoders.values()))


class _Decoder(NamedTuple):
    """What it takes to decode one channel."""

    definitions: Definitions
    standard: bool
    """Whether they are ROS's, as the bag has none."""
    layouts: dict[int, list[Layout]]
    """Met so far, by the length of the message."""


def _flush(
    path: Path, waiting: _Waiting, key: int, channels: Channels, decoders: dict[int, _Decoder], topics: dict[str, Topic]
) -> None:
    channel = channels[key]
    if key not in decoders:
        decoders[key] = _Decoder(*_definitions(path, channel), {})
    # A topic that several nodes publish has several channels.
    topic = topics.setdefault(channel.topic, Topic(channel, {}, [], [], []))
    if topic.channel.kind != channel.kind:
        raise InputError(f"{path}: topic {channel.topic} is both {topic.channel.kind} and {channel.kind}")
    lengths = np.fromiter(map(len, waiting.raws), np.int64, len(waiting.raws))
    for length in np.unique(lengths):
        rows = np.flatnonzero(lengths == length)
        _decode(path, topic, decoders[key], waiting, rows, int(length))


def _definitions(path: Path, channel: Channel) -> tuple[Definitions, bool]:
    """Return the bag's own definition of a type, or ROS's where it has none, and whether it is ROS's."""
    system = need("rosbags.typesys", "bags", path)
    if not channel.definition:
        stores = system.Stores
        return system.get_typestore(stores.LATEST if channel.cdr else stores.ROS1_NOETIC).fielddefs, True
    try:
        if not channel.idl:
            return system.get_types_from_msg(channel.definition, channel.kind), False
        mark = "=" * 80 + "\n"
        texts = [part.split("\n", 1)[-1] for part in channel.definition.split(mark) if part.strip()]
        return {k: v for text in texts for k, v in system.get_types_from_idl(text).items()}, False
    except Exception as error:  # rosbags' parsers raise several kinds
        raise InputError(f"{path}: the definition of {channel.kind} in the bag cannot be read ({error})") from error


def _decode(
    path: Path, topic: Topic, decoder: _Decoder, waiting: _Waiting, rows: NDArray[np.int64], length: int
) -> None:
    """Append the samples of some messages of one length."""
    block = np.frombuffer(b"".join(waiting.raws[i] for i in rows), np.uint8).reshape(len(rows), length)
    stamps, numbers = np.array(waiting.stamps, np.int64), np.array(waiting.numbers, np.int64)
    known, tried = decoder.layouts.setdefault(length, []), 0
    while len(rows):
        try:
            if tried == len(known):
                first = waiting.raws[rows[0]]
                known.append(layout(first, topic.channel.kind, decoder.definitions, topic.channel.cdr))
            same = matching(block, known[tried])
            if same.any():
                here = block if same.all() else block[same]
                _append(topic, known[tried], here, stamps[rows[same]], numbers[rows[same]])
        except (ValueError, KeyError, RecursionError) as error:
            place = f"{topic.channel.topic} ({topic.channel.kind}), the message at {stamps[rows[0]] / NS:.6f} s"
            raise InputError(f"{path}: {place}: {error}") from error
        block, rows, tried = block[~same], rows[~same], tried + 1
    if len(known) > 64:  # texts that change all the time are not worth remembering
        known.clear()


def _append(
    topic: Topic, item: Layout, block: NDArray[np.uint8], stamps: NDArray[np.int64], numbers: NDArray[np.int64]
) -> None:
    channel = topic.channel
    names, frame = names_of(item), item.texts.get("header.frame_id", "")
    joints, turn = (names, None) if channel.kind == "sensor_msgs/msg/JointState" else ((), None)
    for known in topic.groups.values():
        if known.frame == frame and known.names != joints and sorted(known.names) == sorted(joints):
            turn, joints = [joints.index(name) for name in known.names], known.names
            break
    group = topic.groups.setdefault((frame, joints), Group(frame, joints, {}))
    header = stamps
    if "header.stamp.sec" in item.fields:
        header = values(block, item, "header.stamp.sec").astype(np.int64) * NS
        header += values(block, item, "header.stamp.nanosec")
    topic.header.append(header)
    topic.bag.append(stamps)
    topic.number.append(numbers)
    for part in TYPES[channel.kind](block, item):
        if not part.there.any():
            continue
        _, kept, which = group.parts.setdefault(part.name, (part.unit, [], []))
        if isinstance(part.value, list):
            kept.extend(part.value)
        else:
            value = part.value if part.there.all() else part.value[part.there]
            if joints and value.shape[1] != len(joints):
                raise ValueError(f"{part.name} has {value.shape[1]} numbers for {len(joints)} joints")
            kept.append(value if turn is None else value[:, turn])
        which.append(numbers[part.there])
