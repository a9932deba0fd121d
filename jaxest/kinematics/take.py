"""Static selection of rows in a form that XLA on CPU keeps fast, forwards and backwards.

A gather with fixed indices is read entry by entry, at strides once `vmap` has moved the batch to the front: for the
41 frames of a humanoid that costs four times what their kinematics cost. The transpose of slices is a sum of padded
arrays, for each entry of which all of them are computed: 100 times slower for a robot of short branches. One
`lax.split` and one concatenation of its pieces have neither fault, and are each other's transposes.
"""

from collections.abc import Sequence
from itertools import pairwise

import jax
import jax.numpy as jnp

from jaxest.types import Array, ArrayLike


def take(array: Array, rows: Sequence[int], missing: ArrayLike = 0.0) -> Array:
    """Take rows of an array.

    Args:
        array: (n, ...).
        rows: static, which ones, in any order and as often as needed; -1 takes a row of `missing`.
        missing: what fills such rows, broadcast to (...).

    Returns:
        (len(rows), ...).
    """
    array = jnp.asarray(array)
    count = array.shape[0]
    if list(rows) == list(range(count)):
        return array
    runs = _runs(rows)
    cuts = sorted({0, count, *(first for first, _ in runs if first >= 0), *(end for first, end in runs if first >= 0)})
    pieces = dict(zip(cuts, jax.lax.split(array, [b - a for a, b in pairwise(cuts)]), strict=False)) if count else {}
    ends = dict(pairwise(cuts))
    parts: list[Array] = []
    for first, end in runs:
        if first < 0:
            parts.append(jnp.broadcast_to(jnp.asarray(missing, array.dtype), (end - first, *array.shape[1:])))
            continue
        at = first
        while at < end:
            parts.append(pieces[at])
            at = ends[at]
    if not parts:
        return jnp.zeros((0, *array.shape[1:]), array.dtype)
    return jnp.concatenate(parts) if len(parts) > 1 else parts[0]


def _runs(rows: Sequence[int]) -> list[tuple[int, int]]:
    """Join consecutive rows to (first, end); rows of -1 to (-1, count - 1)."""
    runs: list[tuple[int, int]] = []
    for row in rows:
        if runs and ((row >= 0) == (runs[-1][0] >= 0)) and (row < 0 or row == runs[-1][1]):
            runs[-1] = runs[-1][0], runs[-1][1] + 1
        else:
            runs.append((row, row + 1))
    return runs
