"""The papers' figures and tables, computed anew: rows for a report, and pictures like the paper's.

`parts(paper)` names what a paper has, `sections(paper)` computes it, one `Section` after the other. Each paper is a
subpackage here with a table `PARTS`.

Host side only. Not here: the estimators themselves (`jaxest.systems`), timings (`jaxest.bench`), and the command
(`jaxest.cli.reproduce`).
"""

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from jaxest.io.report import Row
from jaxest.types import InputError, unknown_name

PAPERS = {"sato2023": "jaxest.reproduce.sato2023"}
"""Name of a paper whose figures can be computed, and the module that holds them."""
COMING = ("sato2024", "iwao2025", "zakeri2023", "santaera2015")


class Choice(NamedTuple):
    """What a person may choose."""

    seed: int = 0
    small: bool = False
    """Tiny sizes, to see that it runs; the figures mean nothing."""


class Section(NamedTuple):
    """One figure or table."""

    name: str
    """Also of the picture's file."""
    title: str
    rows: Sequence[Row]
    draw: Callable[[Path], None] | None = None
    """Writes the picture, if there is one to draw."""


Say = Callable[[str], None]
Part = Callable[[Choice, Say], Section]


def parts(paper: str) -> Mapping[str, Part]:
    """Return what can be computed of a paper.

    Args:
        paper: one of `PAPERS`.

    Returns:
        Functions by name, in the paper's order.

    Raises:
        InputError: an unknown paper, or one that is not there yet; those that are there are listed.
    """
    if paper in COMING:
        raise InputError(f"paper {paper!r}: its figures cannot be computed yet; there are: {', '.join(PAPERS)}")
    if paper not in PAPERS:
        raise unknown_name("paper", paper, [*PAPERS, *COMING])
    found: Mapping[str, Part] = importlib.import_module(PAPERS[paper]).PARTS
    return found


def sections(
    paper: str, names: Sequence[str] = (), *, choice: Choice | None = None, say: Say | None = None
) -> Iterator[Section]:
    """Compute figures and tables of a paper.

    Args:
        paper: one of `PAPERS`.
        names: which of its parts; all if empty.
        choice: seed and size.
        say: told what is being computed.

    Yields:
        One section after the other.

    Raises:
        InputError: no such paper or part.
    """
    known = parts(paper)
    for name in names:
        if name not in known:
            raise unknown_name(f"part of {paper}", name, known)
    for name in names or known:
        tell = say or (lambda message: None)
        tell(f"{paper}: {name} ...")
        yield known[name](choice or Choice(), tell)


__all__ = ["COMING", "PAPERS", "Choice", "Part", "Say", "Section", "parts", "sections"]
