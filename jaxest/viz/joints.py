"""A picture of joint angles over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

INK, TRUTH, READ = "#1f4e79", "#d1495b", "0.35"
POINTS = 3000  # more do not fit on the paper


def draw(
    path: str | Path,
    time: NDArray[Any],
    mean: NDArray[Any],
    lower: NDArray[Any],
    upper: NDArray[Any],
    *,
    names: Sequence[str],
    reference: NDArray[Any] | None = None,
    truth: NDArray[Any] | None = None,
    title: str = "",
) -> None:
    """Draw joint angles with their 95 % band and write the picture.

    Args:
        path: file to write, `.png` or another suffix that matplotlib knows; replaced if it exists.
        time: (T,) s.
        mean: (T, d) rad.
        lower: (T, d) rad, lower end of the interval.
        upper: (T, d) rad, upper end.
        names: of the d joints.
        reference: (T, d) rad, what encoders read, NaN where they did not.
        truth: (T, d) rad, NaN where unknown.
        title: line above the picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    pick = slice(None, None, max(1, len(time) // POINTS))
    time = np.asarray(time)[pick] - np.asarray(time)[0]
    mean, lower, upper = (np.rad2deg(np.asarray(x, float)[pick]) for x in (mean, lower, upper))
    others = [None if x is None else np.rad2deg(np.asarray(x, float)[pick]) for x in (reference, truth)]
    columns = 1 if len(names) <= 5 else 2
    lines = -(-len(names) // columns)
    figure = Figure(figsize=(5 + 5 * columns, 1.8 * lines + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(lines, columns, sharex=True, squeeze=False).T.ravel()
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    for joint, axis in enumerate(axes):
        axis.spines[["top", "right"]].set_visible(False)
        if joint >= len(names):
            axis.axis("off")
            continue
        axis.fill_between(time, lower[:, joint], upper[:, joint], color=INK, alpha=0.18, linewidth=0, label="95 % band")
        for values, colour, style, label in zip(others, (READ, TRUTH), (":", "-"), ("encoder", "truth"), strict=True):
            if values is not None and np.isfinite(values[:, joint]).any():
                shown = _beside(values[:, joint], mean[:, joint])
                axis.plot(time, shown, color=colour, linestyle=style, linewidth=1.4, label=label)
        axis.plot(time, mean[:, joint], color=INK, linewidth=0.9, label="estimate")
        axis.set_ylabel(f"{names[joint]} [deg]")
        axis.grid(alpha=0.25, linewidth=0.6)
        axis.margins(x=0)
    axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, fontsize=8, frameon=False)
    for axis in axes[lines - 1 :: lines]:
        axis.set_xlabel("time [s]")
    figure.savefig(path, dpi=130)


def _beside(value: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """Take whole turns off angles, deg, so that they stand within half a turn of others."""
    return np.asarray(other + (value - other + 180) % 360 - 180)
