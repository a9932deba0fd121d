"""ROS bags: ROS 1 `.bag`, folders of ROS 2 (sqlite3 or MCAP), bare `.mcap` and `.db3`, through rosbags.

`/imu/data` of sensor_msgs/Imu gives the streams `imu/data/gyroscope`, `imu/data/accelerometer`, `imu/data/orientation`
(wxyz); a topic that ends in the quantity's name does not repeat it (`/imu0/magnetometer`). Stamps are the header's;
the notes say how far the bag's own are from them. Joint states keep their joints' names. A topic whose messages come
from several frames, or speak of several sets of joints, gives a set of streams each: `joint_states/0/joint_position`.
Point clouds have values (n, points, 3); where they differ in size they are padded with NaN to the largest.
Std_msgs/Float64MultiArray has no header and becomes the topic's own stream. Other types are listed in the notes.
"""

import itertools
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike, existing
from jaxest.io.bag_decode import NS, Bag, Group, Topic, collect
from jaxest.io.bag_messages import TYPES
from jaxest.io.bag_records import Channel, Channels
from jaxest.io.bag_scan import indexed, scan
from jaxest.io.extras import need
from jaxest.io.growth import refuse_excess
from jaxest.io.log import SensorLog, Stream, check
from jaxest.io.raw import Raw
from jaxest.io.units import seconds
from jaxest.types import InputError, unknown_name

Clock = Literal["header", "bag"]
Chosen = Callable[[Channel], bool]


def read(path: PathLike, *, clock: Clock = "header", topics: Collection[str] = (), partial: bool = False) -> SensorLog:
    """Read a bag.

    Memory grows with the numbers that are kept, to two or three times their size at the peak; messages themselves are
    held only until a few thousand of a topic, or 4 MiB, are decoded together.

    Args:
        path: a `.bag`, `.mcap` or `.db3` file, or the folder of a ROS 2 bag.
        clock: whose stamps the streams get: those in the messages' headers, or those that the bag gave to them.
        topics: which topics to read; all by default.
        partial: of a bag that is truncated or damaged, return what comes before the break.

    Returns:
        The log, checked; its notes say what was assumed, what was left out and where a bag breaks.

    Raises:
        InputError: rosbags is not installed; no such bag or topic; nothing in it can be read; or it is damaged and
            `partial` is off, with how far it is readable.
    """
    if clock not in ("header", "bag"):
        raise ValueError(f"clock: got {clock!r}, expected 'header' or 'bag'")
    path = Path(path)
    if not path.is_dir():
        existing(path)
    need("rosbags", "bags", path)
    wanted = {"/" + topic.strip("/") for topic in topics}

    def chosen(channel: Channel) -> bool:
        return channel.kind in TYPES and (not wanted or "/" + channel.topic.strip("/") in wanted)

    channels: Channels = {}
    found, notes = collect(path, indexed(path, channels, chosen), channels), []
    if found.broken:
        reason, channels = found.broken, {}
        found = collect(path, scan(path, channels, chosen), channels)
        # A file that reads to its end record by record has only a bad index.
        reason = found.broken or f"has an index that cannot be used ({reason})"
        if not partial:
            raise InputError(f"{path}: {_readable(found, reason)}")
        notes.append(f"incomplete: {reason}; {found.messages} messages before the break were read")
    if found.messages or not found.broken:
        _known(path, found.channels, wanted)
    else:
        raise InputError(f"{path}: {_readable(found, found.broken)}")
    log = _log(path, found, clock, chosen)
    try:
        return check(log._replace(notes=(*notes, *log.notes)))
    except InputError as error:
        if clock == "header" and "stamp of row" in str(error):
            raise InputError(f"{error}; jaxest.io.bags.read(..., clock='bag') takes the bag's own stamps") from error
        raise


def _readable(found: Bag, reason: str) -> str:
    if not found.messages:
        return f"{reason}; no message can be read"
    return (
        f"{reason}; {found.messages} messages can be read, until {found.last / NS:.6f} s: "
        "jaxest.io.bags.read(..., partial=True) returns them"
    )


def _known(path: Path, channels: Channels, wanted: set[str]) -> None:
    """Refuse topics that the bag does not have, and bags with nothing to read."""
    have = {"/" + c.topic.strip("/"): c.kind for c in channels.values()}
    for topic in wanted:
        if topic not in have:
            raise InputError(f"{path}: {unknown_name('topic', topic, have)}")
    if not any(kind in TYPES for topic, kind in have.items() if not wanted or topic in wanted):
        raise InputError(
            f"{path}: none of its topics can be read: {', '.join(f'{t} ({k})' for t, k in have.items()) or 'none'}; "
            f"expected types {', '.join(TYPES)}"
        )


def is_bag_folder(path: PathLike) -> bool:
    """Say whether a folder holds a ROS 2 bag."""
    return (Path(path) / "metadata.yaml").is_file()


def arrays_of(log: SensorLog) -> Raw:
    """Return a log's arrays as `STREAM/time`, `STREAM/value`, for column tables that rename its streams."""
    pairs = (((f"{n}/time", s.time), (f"{n}/value", s.value)) for n, s in log.streams.items())
    return Raw(log.source, dict(itertools.chain.from_iterable(pairs)))


def _log(path: Path, found: Bag, clock: Clock, chosen: Chosen) -> SensorLog:
    streams: dict[str, Stream] = {}
    notes = ["message types that the bag does not define are taken as ROS has them"] if found.standard else []
    for topic in found.topics.values():
        number, bag = np.concatenate(topic.number), np.concatenate(topic.bag)
        stamps, note = _clock(topic, np.concatenate(topic.header), bag, clock)
        notes.append(note)
        groups = sorted((g for g in topic.groups.values() if g.parts), key=_first)
        if len(groups) > 1:
            sets = "; ".join(f"{i}: {' '.join(g.names) or g.frame or '-'}" for i, g in enumerate(groups))
            notes.append(f"{topic.channel.topic}: messages of several frames or sets of joints ({sets})")
        sort = np.argsort(number)
        for i, group in enumerate(groups):
            owner = topic.channel.topic.strip("/") + (f"/{i}" if len(groups) > 1 else "")
            for quantity in list(group.parts):
                unit, kept, which = group.parts.pop(quantity)  # so that two copies of one stream are the most there is
                numbers = np.concatenate(which)
                place = sort[np.searchsorted(number, numbers, sorter=sort)]
                turn = np.lexsort((numbers, bag[place]))  # the bag's order
                value, more = _clouds(path, kept, turn) if quantity == "points" else (_joined(path, kept, turn), [])
                name = _name(owner, quantity)
                if name in streams:
                    raise InputError(f"{path}: two topics give the stream {name!r}")
                notes += [f"{name}: {line}" for line in (*more, *_meaning(quantity))]
                streams[name] = Stream(seconds(stamps[place[turn]], "ns"), value, unit, group.frame, group.names)
    notes += _left_out(found.channels.values(), chosen, streams)
    return SensorLog(streams, str(path), tuple(dict.fromkeys(notes)))


def _first(group: Group) -> int:
    """Return which of the bag's messages is the first of a group."""
    return min(int(block.min()) for _, _, which in group.parts.values() for block in which)


def _name(owner: str, quantity: str) -> str:
    return owner if not quantity or owner.rsplit("/", 1)[-1] == quantity else f"{owner}/{quantity}"


def _meaning(quantity: str) -> list[str]:
    if quantity == "orientation":
        return ["quaternions are stored xyzw in ROS and wxyz here"]
    return ["taken as revolute joints; ROS does not say"] if quantity == "joint_position" else []


def _joined(path: Path, kept: list[NDArray[Any]], turn: NDArray[np.int64]) -> NDArray[Any]:
    shapes = {value.shape[1:] for value in kept}
    if len(shapes) > 1:
        raise InputError(f"{path}: the messages of one topic hold values of shapes {sorted(shapes)}")
    value = np.concatenate(kept)
    return value if (np.diff(turn) == 1).all() else value[turn]


def _clouds(path: Path, kept: list[NDArray[Any]], turn: NDArray[np.int64]) -> tuple[NDArray[Any], list[str]]:
    """Put clouds of points into one array, and say where that took padding."""
    sizes = [len(cloud) for cloud in kept]
    refuse_excess(path, "clouds padded to the largest", 24 * len(kept) * max(sizes), 24 * sum(sizes))
    value = np.full((len(kept), max(sizes), 3), np.nan, kept[0].dtype)
    for i, row in enumerate(turn):
        value[i, : sizes[row]] = kept[row]
    padded = [f"clouds of {min(sizes)} to {max(sizes)} points, padded with NaN"] if len(set(sizes)) > 1 else []
    return value, padded


def _clock(topic: Topic, header: NDArray[np.int64], bag: NDArray[np.int64], clock: Clock) -> tuple[Any, str]:
    """Choose the stamps of a topic, and say how far the header's and the bag's are apart."""
    name = topic.channel.topic
    if topic.channel.kind.startswith("std_msgs"):
        return bag, f"{name}: has no header, so that the bag's own stamps are used"
    if not header.any():
        return bag, f"{name}: the stamps of all headers are 0, so that the bag's own are used"
    low, middle, high = np.percentile((bag - header) / NS, [0, 50, 100])
    apart = f"{middle:+.6g} s from the header's in the median ({low:+.6g} to {high:+.6g})"
    return (bag if clock == "bag" else header), f"{name}: the bag's own stamps are {apart}; the {clock}'s are used"


def _left_out(channels: Iterable[Channel], chosen: Chosen, streams: dict[str, Stream]) -> list[str]:
    notes = []
    for c in channels:
        if not chosen(c) and c.kind not in TYPES:
            number = "" if c.messages is None else f", {c.messages} messages"
            notes.append(f"left out: {c.topic} ({c.kind}{number})")
        elif chosen(c) and not any(n == (own := c.topic.strip("/")) or n.startswith(f"{own}/") for n in streams):
            notes.append(f"left out: {c.topic} has no messages with readings")
    return notes
