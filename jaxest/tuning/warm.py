"""Starts far apart, brought near their optima on a part of long recordings, so that few are left for the whole."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxest.tuning.descent import Method
from jaxest.tuning.optimise import Problem, Result, minimise
from jaxest.tuning.recordings import Recording, Windows, sample_windows
from jaxest.types import Array

APART = 0.05
"""Distance of two points, of logarithms 5 %, below which they are one optimum."""


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
    """Search from every start on windows, drawn once, and keep one point of each optimum.

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
        (optima, n) starts for the whole, the lowest first, and the search on windows. A start that found nothing
        finite is left out.
    """
    part = sample_windows(batch, windows, key)
    found = minimise(problem, part, method=method, starts=starts, evaluations=evaluations, progress=progress,
                     key=key if problem.objective.random else None, **options)  # fmt: skip
    points = np.asarray(found.points)
    kept: list[int] = []
    for i in np.argsort(np.where(np.isfinite(found.values), found.values, np.inf)):
        if np.isfinite(found.values[i]) and all(np.linalg.norm(points[i] - points[j]) > APART for j in kept):
            kept.append(i)
    return jnp.asarray(points[kept]), found


__all__ = ["warm_start"]
