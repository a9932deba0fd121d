"""Files that claim to hold far more than they store: an attack on memory, or damage, but no recording."""

from jaxest.files import PathLike
from jaxest.types import InputError

LARGE = 2**30
"""Bytes that any file may claim."""
RATIO = 100
"""How many times its stored bytes a file may claim beyond those."""


def excessive(claimed: int, stored: int) -> bool:
    """Say whether a file or a part of it claims more than any recording shrinks.

    Args:
        claimed: bytes once it is read.
        stored: bytes on the disk.

    Returns:
        Whether both limits are passed.
    """
    return claimed > LARGE and claimed > RATIO * max(stored, 1)


def refuse_excess(path: PathLike, what: str, claimed: int, stored: int) -> None:
    """Refuse what claims too much, before memory is asked for.

    Args:
        path: the file.
        what: which part of it, for the message.
        claimed: bytes once it is read.
        stored: bytes on the disk.

    Raises:
        InputError: it claims over 1 GiB and a hundred times what is stored.
    """
    if excessive(claimed, stored):
        raise InputError(
            f"{path}: {what} claims {claimed} bytes out of {stored} stored; refused, as no recording shrinks "
            "like that; store it uncompressed"
        )


__all__ = ["LARGE", "RATIO", "excessive", "refuse_excess"]
