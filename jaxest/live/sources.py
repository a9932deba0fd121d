"""Where live samples come from: a queue of this process, a UDP port, a file that grows, standard input or a pipe.

A source is an iterator of `Sample`s that ends when there will be no more. It yields `IDLE` when nothing came for a
while, so that whoever listens can look around, and a text where something came that is no sample.

On the wire and in files a sample is one line of JSON: the stamp `time` in seconds, and a number, a list of numbers or
null (nothing to say) for each stream: `{"time": 12.5, "gyroscope": [0.1, 0, 0], "accelerometer": [0, 0, 9.81]}`.
"""

import contextlib
import json
import os
import queue
import select
import socket
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from jaxest.types import InputError

LARGEST = 65535  # bytes of a datagram
BUFFER = 2**22  # bytes that the system may hold while a step takes long; it grants what it allows
LONGEST = 2**20  # characters of a line that is still to end
PIECE = 2**16  # bytes read at once


class Sample(NamedTuple):
    """What sensors said at one time."""

    time: float
    """s, on the sender's clock."""
    values: Mapping[str, Any]
    """By stream, in SI units: a number, nested lists or an array; None where a sensor had nothing to say."""


IDLE = None
"""Yielded where nothing came within the waiting time."""

Source = Iterator[Sample | str | None]


def parse(line: str | bytes, place: str = "sample") -> Sample:
    """Read one line of JSON.

    Args:
        line: the line.
        place: where it came from, for messages.

    Returns:
        The sample.

    Raises:
        InputError: not a JSON object, no finite stamp `time`, or a stream that is not made of numbers.
    """
    try:
        found = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{place}: not a line of JSON ({error}); expected {{'time': seconds, 'STREAM': [...]}}"
        ) from None
    if not isinstance(found, dict):
        raise InputError(f"{place}: a JSON {type(found).__name__}, expected an object with 'time' and streams")
    stamp = found.pop("time", None)
    if isinstance(stamp, bool) or not isinstance(stamp, int | float) or not abs(stamp) <= sys.float_info.max:
        raise InputError(f"{place}: 'time' is {repr(stamp)[:60]}, expected a finite number of seconds")
    for name, value in found.items():
        if value is not None and not _numbers(value):
            raise InputError(f"{place}: stream {name!r} is {json.dumps(value)[:60]}, expected numbers or null")
    return Sample(float(stamp), found)


def _numbers(value: Any, depth: int = 0) -> bool:
    if isinstance(value, list):
        return depth < 4 and all(_numbers(entry, depth + 1) for entry in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def from_queue(
    samples: "queue.SimpleQueue[Sample | None] | queue.Queue[Sample | None]", *, wait: float = 0.1
) -> Source:
    """Take samples that another thread puts into a queue.

    Args:
        samples: the queue; None in it ends the source.
        wait: s, between two `IDLE`s while the queue is empty.

    Yields:
        The samples, `IDLE` where none came.
    """
    while True:
        try:
            sample = samples.get(timeout=wait)
        except queue.Empty:
            yield IDLE
            continue
        if sample is None:
            return
        yield sample


def from_udp(port: int, host: str = "127.0.0.1", *, wait: float = 0.1, ready: Any = None, busy: bool = False) -> Source:
    """Listen on a UDP port, one datagram a sample; an empty datagram ends the source.

    Anybody who reaches the port can send: bind it to an address that only the robot reaches.

    Args:
        port: to listen on; 0 takes a free one.
        host: address to bind.
        wait: s, between two `IDLE`s while nothing comes.
        ready: called with `(host, port)` once it listens.
        busy: ask again and again instead of sleeping until something comes. This takes a whole core, and keeps it awake
            and its caches warm: the step behind it is the sooner done.

    Yields:
        Samples; a text for a datagram that is none; `IDLE` where none came.

    Raises:
        InputError: the port cannot be opened.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        try:
            listener.bind((host, port))
        except (OSError, OverflowError) as error:
            raise InputError(f"udp {host}:{port}: cannot listen ({error}); choose another port") from error
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        listener.settimeout(0 if busy else wait)
        if ready:
            ready(listener.getsockname())
        while True:
            try:
                datagram, sender = _asked(listener, wait) if busy else listener.recvfrom(LARGEST)
            except TimeoutError:
                yield IDLE
                continue
            if not datagram:
                return
            yield _sample_or_text(datagram, f"datagram from {sender[0]}:{sender[1]}")


def _asked(listener: socket.socket, wait: float) -> tuple[bytes, Any]:
    """What a socket that does not block received; asks until it did, or for `wait` (s)."""
    until = time.perf_counter() + wait
    while True:
        with contextlib.suppress(BlockingIOError):
            return listener.recvfrom(LARGEST)
        if time.perf_counter() > until:
            raise TimeoutError


def from_file(path: Path | str, *, follow: bool = True, wait: float = 0.005) -> Source:
    """Read a file of JSON lines, and go on as it grows.

    A line counts once its end is written. A file that is replaced is read to its end, then the new one from its start.
    One that is cut short is read again from its start, unless it has by then grown beyond what was read of it: nobody
    sees that, and lines are lost.

    Args:
        path: the file; it may not exist yet if it is followed.
        follow: whether to wait for more at its end; otherwise the source ends there.
        wait: s, between two looks at its end.

    Yields:
        Samples; a text for a line that is none; `IDLE` where there is no new line.

    Raises:
        InputError: there is no such file and it is not followed, or it cannot be read.
    """
    path, number, rest, place = Path(path), 0, b"", None
    file: BinaryIO | None = None
    try:
        while True:
            if file is None:
                file = _opened(path, follow)
                if file is None:
                    yield IDLE
                    time.sleep(wait)
                    continue
                place, number, rest = os.fstat(file.fileno()).st_ino, 0, b""
            replaced = _replaced(path, file, place)  # asked before reading, as lines may come between
            piece = file.read(PIECE)
            *lines, rest = (rest + piece).split(b"\n")
            for line in lines:
                number += 1
                if line.strip():
                    yield _sample_or_text(line, f"{path}: line {number}")
            _refuse_endless(rest, f"{path}: line {number + 1}")
            if not piece:
                if rest.strip() and (replaced or not follow):
                    yield _sample_or_text(rest, f"{path}: line {number + 1}")
                if not follow:
                    return
                if replaced:
                    file.close()
                    file = None
                    continue
                yield IDLE
                time.sleep(wait)
    finally:
        if file is not None:
            file.close()


def from_stream(stream: BinaryIO, *, wait: float = 0.1) -> Source:
    """Read JSON lines from standard input, a pipe or a device, as they come; where it is closed, the source ends.

    For POSIX: on Windows only sockets can be waited for.

    Args:
        stream: an open binary file, such as `sys.stdin.buffer` or `open("/dev/ttyUSB0", "rb", buffering=0)`. What
            somebody has read of it before is gone.
        wait: s, between two `IDLE`s while nothing comes.

    Yields:
        Samples; a text for a line that is none; `IDLE` where none came.

    Raises:
        InputError: a line that does not end, or the stream cannot be read.
    """
    number, rest, place = 0, b"", getattr(stream, "name", "stream")
    while True:
        try:
            if not select.select([stream], [], [], wait)[0]:
                yield IDLE
                continue
            piece = os.read(stream.fileno(), PIECE)  # what is there; a buffered read would wait for all of it
        except OSError as error:
            raise InputError(f"{place}: cannot be read ({error.strerror or error})") from error
        *lines, rest = (rest + piece).split(b"\n")
        if not piece:
            lines = [rest]
        for line in lines:
            number += 1
            if line.strip():
                yield _sample_or_text(line, f"{place}: line {number}")
        if not piece:
            return
        _refuse_endless(rest, f"{place}: line {number + 1}")


def _opened(path: Path, follow: bool) -> BinaryIO | None:
    """Return the open file, or None where there is none yet."""
    try:
        if path.exists() and not path.is_dir() and not path.is_file():
            raise InputError(f"{path}: is a pipe or a device, expected a file; open it and take live.from_stream")
        return path.open("rb")
    except FileNotFoundError:
        if not follow:
            raise InputError(f"{path}: no such file") from None
        return None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def _refuse_endless(rest: bytes, place: str) -> None:
    if len(rest) > LONGEST:
        raise InputError(f"{place} has over {LONGEST} characters, expected JSON lines")


def _replaced(path: Path, file: Any, inode: int | None) -> bool:
    """Whether the file at this path is another one by now, or shorter than what was read of it."""
    try:
        found = path.stat()
    except OSError:
        return False
    return found.st_ino != inode or found.st_size < file.tell()


def _sample_or_text(line: bytes, place: str) -> Sample | str:
    try:
        return parse(line, place)
    except InputError as error:
        return str(error)


__all__ = ["IDLE", "Sample", "Source", "from_file", "from_queue", "from_stream", "from_udp", "parse"]
