"""Time stamps of recordings: one rule, on the host, for what a gap is."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

GAP = 2.5
"""A gap is a step longer than this many median steps: two samples are lost. Nothing is made up across one."""


def longest(time: NDArray[np.float64]) -> float:
    """Return the longest step that is no gap.

    Args:
        time: (n,) s, increasing.

    Returns:
        s, `GAP` median steps; 0 for less than two stamps.
    """
    return GAP * float(np.median(np.diff(time))) if len(time) > 1 else 0.0


def gaps(time: NDArray[np.float64]) -> NDArray[Any]:
    """Return the rows (k,) after which there is a gap.

    Args:
        time: (n,) s, increasing.
    """
    return np.flatnonzero(np.diff(time) > longest(time))


def apart(known: NDArray[np.float64], time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far apart the stamps before and after each time are.

    Args:
        known: (n,) s, increasing.
        time: (T,) s.

    Returns:
        (T,) s, 0 at a stamp, infinite before the first and after the last.
    """
    ends = np.concatenate([[-np.inf], known, [np.inf]])
    return ends[np.searchsorted(known, time) + 1] - ends[np.searchsorted(known, time, side="right")]


def around(time: NDArray[np.float64], query: NDArray[np.float64]) -> NDArray[Any]:
    """Return the rows of the two samples around each time; of one outside, those at that end.

    Args:
        time: (n,) s, increasing, two at least.
        query: (Q,) s.

    Returns:
        (Q, 2)
    """
    right = np.clip(np.searchsorted(time, query), 1, len(time) - 1)
    return np.stack([right - 1, right], axis=1)


def near(time: NDArray[np.float64], query: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which times (Q,) are a sample's or lie between two that no gap parts, arguments as for `around`."""
    return apart(time, query) <= longest(time)


__all__ = ["GAP", "apart", "around", "gaps", "longest", "near"]
