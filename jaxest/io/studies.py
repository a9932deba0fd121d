"""Many independent runs, in pieces that are kept and merged to one file: Monte-Carlo runs, recordings, parameter sets.

A piece is a checkpoint (`io.pieces`). The same call with the same folder goes on from those that are there, with the
same results, on any number of devices and processes; of several processes, that of rank 0 reads and writes.
"""

import time
from collections.abc import Callable

import numpy as np

from jaxest.files import PathLike
from jaxest.io import pieces
from jaxest.io.checkpoint import save_state
from jaxest.types import PyTree

MERGED = "results.npz"


def study(
    run: Callable[[PyTree], PyTree],
    items: PyTree,
    *,
    piece: int,
    folder: PathLike | None = None,
    identity: PyTree = (),
    say: Callable[[str], None] | None = None,
) -> PyTree:
    """Run a batch of independent items, a piece at a time.

    Args:
        run: a batch of items, leaves (n, ...), to results with the same leading axis, as `parallel.shards` makes it.
        items: leaves (N, ...), whole on every process.
        piece: items of a piece; the last one is filled up with copies of its last item, so that one program serves.
        folder: where pieces are kept and, at the end, merged to `results.npz`; made if it is not there; kept nowhere
            if None.
        identity: further arrays and texts that results depend on; a folder with pieces of others is refused. Nothing
            else tells one `run` from another: give a name of the function and its settings.
        say: told how far it is, on the process of rank 0.

    Returns:
        The results, leaves (N, ...), NumPy arrays, whole on every process.

    Raises:
        InputError: the folder holds pieces of another study or of other code, or one that cannot be read.
        RuntimeError: another process was lost; pieces that are done are kept.
    """
    import jax

    from jaxest import parallel

    count = len(jax.tree.leaves(items)[0])
    mark = pieces.fingerprint((identity, items, piece))
    leads = jax.process_index() == 0
    place = None if folder is None or not leads else pieces.folder(folder)
    like = jax.eval_shape(run, jax.tree.map(lambda x: x[np.minimum(np.arange(piece), count - 1)], items))
    found, begun, fresh = [], time.monotonic(), 0
    for first in range(0, count, piece):
        file = None if place is None else place / f"items{first:08d}_{piece}.npz"
        old = None if file is None or not file.exists() else pieces.load(file, like, mark)
        if parallel.from_first(np.asarray(old is not None)):
            blank = jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), like)
            part = jax.tree.map(np.asarray, parallel.from_first(blank if old is None else old))
        else:
            rows = np.minimum(np.arange(first, first + piece), count - 1)
            kept = "start all again with the same folder, earlier pieces are kept"
            with parallel.together(f"in the piece from run {first}; {kept}"):
                part = parallel.gather(run(jax.tree.map(lambda x, rows=rows: x[rows], items)))
            fresh += piece
            if file is not None:
                pieces.save(file, part, mark)
        found.append(part)
        done = min(first + piece, count)
        if say and leads:
            left = (time.monotonic() - begun) / max(fresh, 1) * (count - done)
            say(f"{done} of {count} runs" + (f", about {left:.0f} s left" if fresh and left >= 1 else ""))
    whole = jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *found)
    if place is not None:
        save_state(place / MERGED, whole, overwrite=True)
    return whole


__all__ = ["MERGED", "study"]
