"""Checkpoints of a live run, written beside it so that no step waits for the disk."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from jaxest.files import refuse_existing
from jaxest.io.checkpoint import load_state, save_state
from jaxest.types import InputError, PyTree


class Checkpoint(NamedTuple):
    """What a live run goes on from."""

    state: PyTree
    time: float
    """s, stamp of the last sample in the state."""


def resume(path: Path | str, like: PyTree) -> Checkpoint:
    """Read the checkpoint of a live run.

    Args:
        path: what `drive(..., save=path)` wrote.
        like: a state of the same estimator, for example `system.init(params)`.

    Returns:
        State and stamp, for `drive(..., state, ..., last=checkpoint.time)`.

    Raises:
        InputError: no such file, not a checkpoint, or that of another estimator.
    """
    found: Checkpoint = load_state(path, Checkpoint(like, 0.0))
    return found


class Keeper:
    """A thread that writes the newest checkpoint every so often, and the last one when it is closed.

    The one mutable object here: two threads need a place to meet.
    """

    def __init__(self, path: Path | str | None, every: float) -> None:
        self._path, self._every = path, every
        self._newest: Checkpoint | None = None
        self._state: Callable[[Any], PyTree] = lambda state: state
        self._closing = threading.Event()
        self._failure = ""
        self._thread = threading.Thread(target=self._write_now_and_then, name="jaxest-checkpoint", daemon=True)
        if path is not None:
            refuse_existing(path, overwrite=True)  # a folder that is not there is told now, not after hours

    def start(self, state: Callable[[Any], PyTree]) -> None:
        """Begin to write now and then.

        Args:
            state: makes the state of an estimator from what `offer` is given.
        """
        self._state = state
        if self._path is not None:
            self._thread.start()

    @property
    def failure(self) -> str:
        """Why the newest checkpoint could not be written; empty where it could, or there was none yet."""
        return self._failure

    def offer(self, carry: Any, time: float) -> None:
        """Take a state as the newest; costs nothing."""
        self._newest = Checkpoint(carry, time)

    def close(self) -> None:
        """Write the newest state and end the thread; `failure` says whether that went well."""
        self._closing.set()
        if self._path is not None:
            self._thread.join()
            self._write()

    def _write_now_and_then(self) -> None:
        while not self._closing.wait(self._every):
            self._write()

    def _write(self) -> None:
        newest = self._newest
        if newest is None or self._path is None:
            return
        try:
            save_state(self._path, newest._replace(state=self._state(newest.state)), overwrite=True)
            self._failure = ""
        except InputError as error:  # a full disk must not stop a robot
            self._failure = str(error)


__all__ = ["Checkpoint", "Keeper", "resume"]
