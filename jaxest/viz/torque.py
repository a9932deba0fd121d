"""A picture of estimated joint torques over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.viz import canvas
from jaxest.viz.joints import INK, POINTS, TRUTH


def draw(
    path: str | Path,
    time: NDArray[Any],
    mean: NDArray[Any],
    lower: NDArray[Any],
    upper: NDArray[Any],
    *,
    names: Sequence[str],
    logged: NDArray[Any] | None = None,
    title: str = "",
) -> None:
    """Draw joint torques with their 95 % band, a panel for each joint, and write the picture.

    Args:
        path: file to write, `.png` or another suffix that matplotlib knows; replaced if it exists.
        time: (T,) s.
        mean: (T, d) N m.
        lower: (T, d) N m, lower end of the interval.
        upper: (T, d) N m, upper end.
        names: of the d joints.
        logged: (T, d) N m, the log's own torque.
        title: line above the picture.
    """
    pick = slice(None, None, max(1, len(time) // POINTS))
    at = np.asarray(time)[pick] - np.asarray(time)[0]
    figure = canvas.sheet((9, 1.6 * len(names) + 0.8), title)
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for j, axis in enumerate(axes):
        low, high, middle = (np.asarray(x)[pick, j] for x in (lower, upper, mean))
        axis.fill_between(at, low, high, color=INK, alpha=0.18, linewidth=0, label="95 % band")
        if logged is not None:
            axis.plot(at, np.asarray(logged)[pick, j], color=TRUTH, linewidth=0.9, label="logged")
        axis.plot(at, middle, color=INK, linewidth=0.9, label="estimate")
        axis.set_ylabel(f"{names[j]}\n[N m]", fontsize=8)
        axis.grid(alpha=0.25, linewidth=0.6)
        axis.spines[["top", "right"]].set_visible(False)
        # A start that nothing is known of would flatten everything after it.
        shown = np.concatenate([x[len(x) // 50 :] for x in (low, high, *([] if logged is None else [logged[pick, j]]))])
        bottom, top = np.quantile(shown, [0.002, 0.998])
        margin = 0.15 * max(top - bottom, 1e-9)
        axis.set_ylim(bottom - margin, top + margin)
    axes[0].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, fontsize=8, frameon=False)
    axes[-1].set_xlabel("time [s]")
    canvas.write(path, figure)
