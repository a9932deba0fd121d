"""Recordings in a batch: padded to one length and masked, cut into windows, held out."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.types import Array, PyTree, Reading


class Recording(NamedTuple):
    """One recording, or a batch of them with a leading axis B on every leaf."""

    measurements: PyTree
    """Leaves (T, ...), as `run` takes them; has a field `dt`."""
    counts: Any
    """(T,) bool, the steps that an objective looks at."""
    truth: PyTree = None
    """Leaves (T, ...), finite also where nothing counts; None without one."""


class Windows(NamedTuple):
    """How mini-batches are drawn; static."""

    recordings: int
    """How many windows, each of a recording of its own while there are enough."""
    length: int
    """Steps of a window."""
    settle: int = 0
    """Its first steps, over which the estimator settles from `init` and which do not count."""


def recording(measurements: PyTree, truth: PyTree = None, counts: Any = None) -> Recording:
    """Bundle a recording; what is not finite in the truth does not count.

    Args:
        measurements: leaves (T, ...).
        truth: leaves (T, ...), NaN where unknown.
        counts: (T,) bool, the steps that are looked at; all if None.

    Returns:
        The recording, whose truth is finite throughout: where unknown, the last known one or the next.

    Raises:
        ValueError: leaves differ in their number of steps.
    """
    lengths = {np.shape(leaf)[:1] for leaf in jax.tree.leaves((measurements, truth))}
    if len(lengths) != 1 or () in lengths:
        raise ValueError(f"recording: leading axes {sorted(lengths)}, expected one number of steps on every leaf")
    length = next(iter(lengths))[0]
    there = np.ones(length, bool) if counts is None else np.array(counts, bool)
    for leaf in jax.tree.leaves(truth):
        there &= np.isfinite(np.asarray(leaf)).reshape(length, -1).all(axis=1)
    known = np.flatnonzero(there)
    if not known.size:
        return Recording(measurements, there, jax.tree.map(lambda x: np.zeros_like(np.asarray(x)), truth))
    nearest = known[np.clip(np.searchsorted(known, np.arange(length), side="right") - 1, 0, None)]
    return Recording(measurements, there, jax.tree.map(lambda x: np.asarray(x)[nearest], truth))


def padded(recordings: Sequence[Recording]) -> Recording:
    """Put recordings into one batch.

    Args:
        recordings: of one kind, of any lengths.

    Returns:
        Leaves (B, longest, ...). Behind the end of a recording nothing is valid, counts, or takes time.

    Raises:
        ValueError: there is none.
    """
    if not recordings:
        raise ValueError("recordings: got none, expected at least one")
    longest = max(len(one.counts) for one in recordings)
    filled = [_filled(one, longest - len(one.counts)) for one in recordings]
    return jax.tree.map(lambda *x: np.stack(x), *filled)


def _filled(one: Recording, missing: int) -> Recording:
    def repeat(x: Any) -> NDArray[Any]:
        x = np.asarray(x)
        return np.concatenate([x, np.repeat(x[-1:], missing, axis=0)])

    def silent(x: Any) -> NDArray[Any]:
        x = np.asarray(x)
        return np.concatenate([x, np.zeros((missing, *x.shape[1:]), x.dtype)])

    def fill(leaf: Any) -> Any:
        if not isinstance(leaf, Reading):
            return repeat(leaf)
        valid: Any = silent(leaf.valid)
        return Reading(jax.tree.map(repeat, leaf.value), valid)

    measurements = jax.tree.map(fill, one.measurements, is_leaf=lambda x: isinstance(x, Reading))
    measurements = measurements._replace(dt=silent(one.measurements.dt))
    return Recording(measurements, silent(one.counts), jax.tree.map(repeat, one.truth))


def sample_windows(batch: Recording, windows: Windows, key: Array) -> Recording:
    """Draw a mini-batch.

    Args:
        batch: leaves (B, T, ...).
        windows: how many, how long.
        key: random key.

    Returns:
        Leaves (windows, length, ...), each cut at a uniform place of its recording, at latest where its last step that
        counts is the window's last; all of a short one, padded.

    Raises:
        ValueError: a window is longer than the batch, or no longer than it takes to settle.
    """
    items, longest = np.shape(batch.counts)
    if not windows.settle < windows.length <= longest:
        raise ValueError(
            f"windows: got length {windows.length} of which {windows.settle} settle, expected settle < length and "
            f"length <= {longest}"
        )
    who, where = jax.random.split(key)
    order = jax.random.permutation(who, items)
    chosen = jnp.concatenate([order] * -(-windows.recordings // items))[: windows.recordings]
    steps = jnp.arange(longest)
    ends = jnp.max(jnp.where(jnp.asarray(batch.counts), steps[None] + 1, 0), axis=1)[chosen]
    last = jnp.maximum(ends - windows.length, 0)
    start = jnp.floor(jax.random.uniform(where, last.shape) * (last + 1)).astype(jnp.int32)
    return jax.vmap(lambda i, s: _window(batch, windows, i, s))(chosen, start)


def _window(batch: Recording, windows: Windows, item: Array, start: Array) -> Recording:
    def cut(x: Any) -> Array:
        row = jnp.asarray(x)[item]
        return jax.lax.dynamic_slice_in_dim(row, start, windows.length)

    found = jax.tree.map(cut, batch)
    return found._replace(counts=found.counts & (jnp.arange(windows.length) >= windows.settle))


def take(batch: Recording, rows: Sequence[int] | NDArray[Any] | slice) -> Recording:
    """Return some recordings of a batch, such as the even ones (`slice(0, None, 2)`)."""
    return jax.tree.map(lambda x: x[rows], batch)


__all__ = ["Recording", "Windows", "padded", "recording", "sample_windows", "take"]
