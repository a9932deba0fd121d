"""The papers' figures and tables, computed anew: rows for a report, and pictures like the paper's.

`parts(paper)` names what a paper has, `sections(paper)` computes it, one `Section` after the other. Each paper is a
subpackage here with a table `PARTS`.

A paper whose parts take more than a seed says so in a tuple `TAKES` of the names of `Choice`'s fields, and in a mapping
`NEEDS` which part cannot do without which folder among them.

Host side only. Not here: the estimators themselves (`jaxest.systems`), timings (`jaxest.bench`), and the command
(`jaxest.cli.reproduce`).
"""

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from jaxest.io.report import Row
from jaxest.types import InputError, unknown_name

PAPERS = {
    "sato2023": "jaxest.reproduce.sato2023",
    "sato2024": "jaxest.reproduce.sato2024",
    "iwao2025": "jaxest.reproduce.iwao2025",
    "zakeri2023": "jaxest.reproduce.zakeri2023",
    "santaera2015": "jaxest.reproduce.santaera2015",
}
"""Name of a paper whose figures can be computed, and the module that holds them."""


class Choice(NamedTuple):
    """What a person may choose."""

    seed: int = 0
    small: bool = False
    """Tiny sizes, to see that it runs; the figures mean nothing."""
    runs: int | None = None
    """Monte-Carlo runs of each condition; the part's own number if None."""
    rows: Sequence[str] = ()
    """Rows of a table to compute; all if empty."""
    setting: str | None = None
    """One of the paper's data settings; the paper's module names the default."""
    broad: Path | None = None
    """Folder with the BROAD trials, where the paper's filters are measured on them."""
    work: Path | None = None
    """Folder where finished runs are kept, so that a stopped run goes on from there; kept nowhere if None."""


APART = 100_000
"""Seeds between the first runs of two `--seed`s."""


def seed_of(choice: Choice, run: int = 0) -> int:
    """Return the seed of a part's run, so that no run of one `--seed` is one of another."""
    return APART * choice.seed + run


COMMON = ("seed", "small")
"""Fields of `Choice` that every paper takes."""


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
        InputError: an unknown paper; the closest names are given.
    """
    if paper not in PAPERS:
        raise unknown_name("paper", paper, PAPERS)
    found: Mapping[str, Part] = importlib.import_module(PAPERS[paper]).PARTS
    return found


def possible(paper: str, choice: Choice) -> tuple[str, ...]:
    """Return the names of a paper's parts that nothing is missing for, in its order.

    Args:
        paper: one of `PAPERS`.
        choice: what is given.

    Raises:
        InputError: an unknown paper.
    """
    return tuple(name for name in parts(paper) if _missing(paper, name, choice) is None)


def _missing(paper: str, part: str, choice: Choice) -> str | None:
    """The folder that a part needs and that is not given."""
    field: str | None = getattr(importlib.import_module(PAPERS[paper]), "NEEDS", {}).get(part)
    return field if field and getattr(choice, field) is None else None


def sections(
    paper: str, names: Sequence[str] = (), *, choice: Choice | None = None, say: Say | None = None
) -> Iterator[Section]:
    """Compute figures and tables of a paper.

    Args:
        paper: one of `PAPERS`.
        names: which of its parts; all that are `possible` if empty.
        choice: seed and size.
        say: told what is being computed.

    Yields:
        One section after the other.

    Raises:
        InputError: no such paper or part, a choice that the paper does not take, or a named part without its folder.
    """
    known = parts(paper)
    for name in names:
        if name not in known:
            raise unknown_name(f"part of {paper}", name, known)
    choice = choice or Choice()
    _check(paper, choice)
    for name in names:
        field = _missing(paper, name, choice)
        if field:
            raise InputError(f"--part {name}: got no folder, expected --{field} FOLDER")
    for name in names or possible(paper, choice):
        tell = say or (lambda message: None)
        tell(f"{paper}: {name} ...")
        yield known[name](choice, tell)


def _check(paper: str, choice: Choice) -> None:
    """Refuse what this paper has no use for, rather than ignore it."""
    takes = (*COMMON, *getattr(importlib.import_module(PAPERS[paper]), "TAKES", ()))
    given = [name for name, value in choice._asdict().items() if value != Choice._field_defaults[name]]
    for name in given:
        if name not in takes:
            raise InputError(f"--{name}: {paper} has no such choice; it takes {', '.join('--' + t for t in takes)}")
    if choice.runs is not None and choice.runs < 1:
        raise InputError(f"--runs: got {choice.runs}, expected at least 1")


__all__ = ["APART", "COMMON", "PAPERS", "Choice", "Part", "Say", "Section", "parts", "possible", "sections", "seed_of"]
