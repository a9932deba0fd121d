"""Long runs of Markov chains on the host: in pieces that are kept, with progress, and as ArviZ `InferenceData`.

A piece is a checkpoint (`io.pieces`): the chains after it and its draws. The same call with the same folder goes on
from the last one, and gives the same draws as a run that was never stopped.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike
from jaxest.io import pieces
from jaxest.io.extras import need
from jaxest.io.pieces import fingerprint
from jaxest.types import PyTree

Advance = Callable[[Any, int], tuple[Any, Any]]
"""`(chains, iterations) -> (chains, history)`, leaves of the history (iterations, ...)."""


def sample(
    advance: Advance,
    chains: PyTree,
    iterations: int,
    *,
    piece: int = 250,
    folder: PathLike | None = None,
    identity: PyTree = (),
    say: Callable[[str], None] | None = None,
) -> tuple[PyTree, PyTree]:
    """Run chains in pieces.

    Args:
        advance: runs all chains for some iterations.
        chains: where they start.
        iterations: how many in all.
        piece: iterations of a piece; two lengths at most are compiled.
        folder: where pieces are kept, made if it is not there; kept nowhere if None.
        identity: arrays and texts that the draws depend on (data, parameters, sampler); a folder with pieces of others
            is refused. Nothing else tells one `advance` from another: give a name of the sampler and its settings.
        say: told how far it is and how long it will take.

    Returns:
        The chains, and the history with leaves (iterations, ...), NumPy arrays.

    Raises:
        InputError: the folder holds pieces of another run or of other code, or one that cannot be read.
    """
    import jax

    mark = fingerprint((identity, chains, piece))
    place = None if folder is None else pieces.folder(folder)
    found, done, begun, fresh = list[PyTree](), 0, time.monotonic(), 0
    while done < iterations:
        size = min(piece, iterations - done)
        file = None if place is None else place / f"piece{done:07d}_{size}.npz"
        if file is not None and file.exists():
            like = jax.eval_shape(lambda c, size=size: advance(c, size), chains)
            chains, history = pieces.load(file, like, mark)
        else:
            chains, history = jax.block_until_ready(advance(chains, size))
            fresh += size
            if file is not None:
                pieces.save(file, (chains, history), mark)
        found.append(jax.tree.map(np.asarray, history))
        done += size
        if say:
            left = (time.monotonic() - begun) / max(fresh, 1) * (iterations - done)
            say(f"{done} of {iterations} iterations" + (f", about {left:.0f} s left" if fresh and left >= 1 else ""))
    return chains, jax.tree.map(lambda *parts: np.concatenate(parts), *found)


def inference_data(
    draws: Mapping[str, NDArray[Any]],
    statistics: Mapping[str, NDArray[Any]] | None = None,
    *,
    names: Mapping[str, tuple[str, Sequence[Any]]] | None = None,
    attributes: Mapping[str, Any] | None = None,
) -> Any:
    """Put draws into ArviZ's `InferenceData`; its `to_netcdf` writes the file.

    Args:
        draws: name -> (C, S, ...), posterior draws.
        statistics: name -> (C, S, ...), what the sampler says of itself.
        names: name of a quantity -> name and labels of its last axis.
        attributes: kept with the posterior.

    Returns:
        The `arviz.InferenceData`.

    Raises:
        InputError: ArviZ is not installed.
    """
    arviz = need("arviz", "diagnostics", "InferenceData")
    labels = dict(names or {})
    dims = {name: [axis] for name, (axis, _) in labels.items()}
    coords = {axis: list(values) for axis, values in labels.values()}
    return arviz.from_dict(
        posterior=dict(draws), sample_stats=dict(statistics or {}), dims=dims, coords=coords,
        posterior_attrs=dict(attributes or {}),
    )  # fmt: skip


__all__ = ["Advance", "fingerprint", "inference_data", "sample"]
