"""A guess at the column table of somebody else's file, from its names, shapes and magnitudes.

What the data settle (an accelerometer of median norm 1 is in g) is applied and listed as assumed; what they leave open
(no sampling rate, two candidates for one stream) is listed as unsure, and the file is not read without an answer.
"""

import json
from typing import Any, NamedTuple

from numpy.typing import NDArray

from jaxest.io.columns import Column, ColumnTable
from jaxest.io.proposal_streams import Found, find
from jaxest.io.proposal_units import clock, with_unit
from jaxest.io.raw import Raw
from jaxest.io.words import Word, classify
from jaxest.types import InputError, listed


class Proposal(NamedTuple):
    """A guessed table."""

    table: ColumnTable
    assumed: tuple[str, ...]
    """What was taken for granted, one sentence each."""
    unsure: tuple[str, ...]
    """What only the user knows; not empty means that `read` needs a table."""


def guess(raw: Raw) -> Proposal:
    """Guess the column table of a file.

    Args:
        raw: the file.

    Returns:
        The proposal.

    Raises:
        InputError: a numeric column is damaged, or nothing looks like a stream.
    """
    if raw.broken:
        raise InputError(f"{raw.source}: {next(iter(raw.broken.values()))}")
    words = {name: _word(name, value) for name, value in raw.arrays.items()}
    assumed: list[str] = []
    unsure: list[str] = []
    found = find(raw, words, assumed, unsure)
    if not found:
        raise InputError(
            f"{raw.source}: nothing here looks like a stream; {raw.word}s: {_listing(raw)}. Say in a config which is "
            f"which:\n{_example(raw)}"
        )
    hollow = next((name for name, entry in found.items() if not len(entry.value)), None)
    if hollow is not None:
        raise InputError(f"{raw.source}: the log is empty: stream {hollow!r} has no rows")
    streams = {}
    for name, entry in found.items():
        column = clock(raw, words, name, entry, assumed, unsure)
        streams[name] = entry._replace(column=column)
    left = [n for n in raw.arrays if not _used(n, words[n], streams)]
    if left:
        assumed.append(f"left out: {', '.join(left)}")
    assumed += [f"left out: {reason}" for reason in raw.refused.values()]
    table = {name: with_unit(raw, name, streams, assumed, unsure) for name in streams}
    return Proposal(_shared(table), tuple(dict.fromkeys(assumed)), tuple(dict.fromkeys(unsure)))


def _word(name: str, value: NDArray[Any]) -> Word:
    """What a name says; dates are stamps whatever they are called."""
    word = classify(name)
    if value.dtype.kind != "M":
        return word
    return word._replace(unit="") if word.kind == "time" else Word("time", "", "", "")


def _listing(raw: Raw) -> str:
    entries = listed(f"{name} {value.shape}" for name, value in raw.arrays.items())
    return "; ".join([entries, *list(raw.refused.values())[:20]])


def _example(raw: Raw) -> str:
    """Lines of a config to be filled in, with names that the file has."""
    names = [n for n, value in raw.arrays.items() if value.ndim] or ["NAME"]
    wide = next((n for n in names if n in raw.arrays and raw.arrays[n].ndim == 2 and raw.arrays[n].shape[1] > 3), "")
    if wide:
        where = f"array = {json.dumps(wide)}\ncolumns = [1, 2, 3]\ntime = 0  # a column of it"
    elif raw.word == "column" and len(names) > 3:
        where = f"time = {json.dumps(names[0])}\ncolumns = {json.dumps(names[1:4])}"
    else:
        where = f"array = {json.dumps(names[0])}\nrate = 100.0  # Hz, or time = the name of the stamps"
    return f'[columns.gyroscope]  # and so on for "accelerometer", ...\n{where}\nunit = "rad/s"'


def _used(name: str, word: Word, streams: dict[str, Found]) -> bool:
    for entry in streams.values():
        c = entry.column
        if name == c.array or name in c.columns or name in (c.time, c.rate):
            return True
    return word.kind == "period"


def _shared(streams: dict[str, Column]) -> ColumnTable:
    """Move to the top what all streams have in common."""
    every = list(streams.values())
    table = ColumnTable(streams)
    first = every[0]
    if not isinstance(first.time, int) and all(
        (c.time, c.rate, c.time_unit) == (first.time, first.rate, first.time_unit) for c in every
    ):
        table = table._replace(time=first.time, rate=first.rate, time_unit=first.time_unit)
        streams = {name: c._replace(time=None, rate=None, time_unit="") for name, c in streams.items()}
    return table._replace(streams=streams)
