"""Starts far apart, brought near their optima on a part of long recordings, so that few are left for the whole."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxest.tuning.descent import PROBE, Method, lbfgs, unseen
from jaxest.tuning.optimise import Result, minimise
from jaxest.tuning.problem import Problem, values_at
from jaxest.tuning.recordings import Recording, Windows, sample_windows
from jaxest.types import Array

APART = 0.05
"""Distance of two points, of logarithms 5 %, below which they are one optimum."""
BETWEEN = 0.25, 0.5, 0.75
"""Shares of the way from one point to another at which the objective is asked whether it rises between them."""


def warm_start(
    problem: Problem,
    batch: Recording,
    starts: Array,
    *,
    windows: Windows,
    key: Array,
    method: Method | None = None,
    evaluations: int = 60,
    progress: Callable[[str], None] = lambda message: None,
    **options: Any,
) -> tuple[Array, Result]:
    """Search from every start on windows, drawn once, and keep that point of each optimum which is lowest on the whole.

    Args:
        problem: what is tuned, on whole recordings.
        batch: recordings (B, T, ...).
        starts: (starts, n).
        windows: which part of the recordings.
        key: random key, of windows and of what is drawn.
        method: as for `minimise`.
        evaluations: as for `minimise`, on windows.
        progress: as for `minimise`.
        options: others of `minimise`.

    Returns:
        (optima, n) starts for the whole, the lowest first, and the search on windows. Points are of one optimum where
        they are close, or where the objective rises nowhere on the way between them: on a plateau, as a parameter has
        that hardly matters in windows, they may end far apart. A start that found nothing finite is left out.
    """
    part = sample_windows(batch, windows, key)
    method = lbfgs() if method is None else method
    draw = key if problem.objective.random else None
    found = minimise(problem, part, method=method, starts=starts, evaluations=evaluations, progress=progress,
                     key=draw, **options)  # fmt: skip
    points = np.asarray(found.points)

    def rises(i: int, j: int) -> bool:
        """Whether the objective is higher between two points than at the higher one, by what a descent would see."""
        way = np.asarray(BETWEEN, points.dtype)[:, None]
        higher = np.maximum(found.values[i], found.values[j])
        between = np.asarray(values_at(problem, (1 - way) * points[i] + way * points[j], part, draw))
        return not (between <= higher + PROBE * np.asarray(unseen(method, jnp.asarray(higher)))).all()

    optima: list[list[int]] = []
    for i in np.argsort(np.where(np.isfinite(found.values), found.values, np.inf)):
        if not np.isfinite(found.values[i]):
            continue
        for one in optima:
            if np.linalg.norm(points[i] - points[one[0]]) <= APART or not rises(i, one[0]):
                one.append(int(i))
                break
        else:
            optima.append([int(i)])
    return jnp.asarray(points[_lowest(problem, optima, found.points, batch, draw)]), found


def _lowest(problem: Problem, optima: list[list[int]], points: Array, batch: Recording, key: Array | None) -> list[int]:
    """Which of the points of each optimum is lowest on the whole, the lowest optimum first."""
    values = np.asarray(values_at(problem, points, batch, key))
    values = np.where(np.isfinite(values), values, np.inf)
    return sorted((min(one, key=lambda i: values[i]) for one in optima), key=lambda i: values[i])


__all__ = ["warm_start"]
