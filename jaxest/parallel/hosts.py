"""Several processes, on one host or many, as one JAX program."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import jax
import numpy as np

from jaxest.types import InputError, PyTree

PATIENCE = 30
"""s without a sign of life after which a process counts as lost."""

LOST = ("Gloo", "NCCL", "UNAVAILABLE", "heartbeat")
"""Words of JAX's errors where another process has gone."""


class Place(NamedTuple):
    """Where a process stands among the others."""

    rank: int
    """From 0; that one writes files and prints."""
    processes: int
    """How many there are."""


def start(
    coordinator: str | None = None, rank: int | None = None, count: int | None = None, *, patience: int = PATIENCE
) -> Place:
    """Join the other processes of a run; each calls this before anything else of JAX.

    Args:
        coordinator: `HOST:PORT` at which the process of rank 0 listens; under Slurm or Open MPI it is found if None.
        rank: number of this process, from 0.
        count: how many there are.
        patience: s without a sign of life after which one counts as lost. JAX then says on standard error which, and
            ends all others: start the same commands again, and what `io.studies.study` and checkpoints kept is not
            lost.

    Returns:
        The rank and count.

    Raises:
        InputError: some of the three are given and others not, the rank is out of range, or the others are not found.
    """
    given = [value is not None for value in (coordinator, rank, count)]
    if any(given) and not all(given):
        raise InputError("start: coordinator, rank and count go together; under Slurm or Open MPI leave all three out")
    if count is not None and rank is not None and not 0 <= rank < count:
        raise InputError(f"start: got rank {rank} of {count}, expected 0 to {count - 1}")
    try:
        jax.distributed.initialize(coordinator, count, rank, heartbeat_timeout_seconds=patience)
    except (RuntimeError, ValueError) as error:
        raise InputError(f"start: {error}") from error
    return Place(jax.process_index(), jax.process_count())


def parse(text: str) -> tuple[str, int, int] | tuple[None, None, None]:
    """Read `HOST:PORT,RANK/COUNT`, or `auto` where Slurm or Open MPI tells, as a command line has it.

    Args:
        text: the words.

    Returns:
        Arguments of `start`.

    Raises:
        InputError: it is neither.
    """
    if text == "auto":
        return None, None, None
    address, _, place = text.partition(",")
    rank, _, count = place.partition("/")
    if ":" not in address or not rank.isdecimal() or not count.isdecimal():
        raise InputError(f"got {text!r}, expected HOST:PORT,RANK/COUNT such as host0:1234,0/4, or auto under Slurm")
    return address, int(rank), int(count)


@contextmanager
def together(words: str) -> Iterator[None]:
    """Say it plainly where another process goes while this one computes with it.

    Args:
        words: where that was, and what to do now.

    Raises:
        RuntimeError: another process was lost, as JAX tells in one of many ways.
    """
    try:
        yield
    except (jax.errors.JaxRuntimeError, ValueError) as error:
        if jax.process_count() == 1 or not any(word in str(error) for word in LOST):
            raise
        raise RuntimeError(f"another process was lost {words} ({str(error).splitlines()[0]})") from error


def from_first(tree: PyTree) -> PyTree:
    """Bring what the process of rank 0 holds to all: what it has read from a file, say.

    Args:
        tree: leaves of the same shapes and dtypes on every process.

    Returns:
        Rank 0's, NumPy arrays; the tree itself where there is but one process.
    """
    if jax.process_count() == 1:
        return tree
    from jax.experimental.multihost_utils import broadcast_one_to_all

    return jax.tree.map(np.asarray, broadcast_one_to_all(tree))


__all__ = ["PATIENCE", "Place", "from_first", "parse", "start", "together"]
