"""How long steps took: a histogram of fixed size, so that a run of days needs no more memory than one of seconds."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LOWEST, DECADES, PER_DECADE = 1e-6, 7, 50
EDGES: NDArray[np.float64] = LOWEST * 10.0 ** (np.arange(DECADES * PER_DECADE + 1) / PER_DECADE)
"""(351,) s, edges of the bins: 1 us to 10 s, each 4.7 % wide."""


class Latency(NamedTuple):
    """Counts of durations, and their extremes."""

    counts: NDArray[np.int64]
    """(350,) per bin of `EDGES`; what is shorter or longer is in the first or last."""
    longest: float = 0.0
    """s."""
    total: float = 0.0
    """s, sum of all."""

    @property
    def number(self) -> int:
        """How many durations were counted."""
        return int(self.counts.sum())

    def quantile(self, probability: float) -> float:
        """Return the duration (s) that the given share does not exceed, to the width of a bin (4.7 %).

        Args:
            probability: from 0 to 1.

        Returns:
            Upper edge of the bin, at most the longest; NaN where nothing was counted.
        """
        if not self.number:
            return float("nan")
        at = int(np.searchsorted(np.cumsum(self.counts), probability * self.number))
        return float(min(EDGES[min(at, len(self.counts) - 1) + 1], self.longest))

    def share_within(self, limit: float) -> float:
        """Return the share of durations in bins that end at or below `limit` (s); from below, to a bin's width."""
        whole = int(np.searchsorted(EDGES, limit * (1 + 1e-9), side="right")) - 1
        return float(self.counts[: max(whole, 0)].sum()) / max(self.number, 1)


def empty() -> Latency:
    """Return a histogram that has counted nothing."""
    return Latency(np.zeros(len(EDGES) - 1, np.int64))


def counted(latency: Latency, seconds: float) -> Latency:
    """Return the histogram with one more duration; the counts are updated in place."""
    at = min(max(int(math.log10(max(seconds, LOWEST) / LOWEST) * PER_DECADE), 0), len(latency.counts) - 1)
    latency.counts[at] += 1
    return Latency(latency.counts, max(latency.longest, seconds), latency.total + seconds)


def joined(one: Latency, two: Latency) -> Latency:
    """Return the histogram of both runs together."""
    return Latency(one.counts + two.counts, max(one.longest, two.longest), one.total + two.total)


__all__ = ["EDGES", "Latency", "counted", "empty", "joined"]
