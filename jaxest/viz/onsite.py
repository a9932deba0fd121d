"""A picture of poses that become known while something is shaken."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.viz import canvas

COLOURS = ("#d1495b", "#3a7d44", "#1f4e79")


def draw(
    path: str | Path,
    time: NDArray[Any],
    curves: Mapping[str, tuple[NDArray[Any], NDArray[Any]]],
    final: Mapping[str, NDArray[Any]],
    truth: Sequence[NDArray[Any]] | None = None,
    *,
    title: str = "",
) -> None:
    """Draw positions over time, a panel for each pose, and below it what 95 % of its uncertainty is.

    Args:
        path: file to write, replaced if it exists.
        time: (T,) s.
        curves: by name, positions (T, 3) m and covariances (T, 6, 6) of rotation and position; NaN while not known.
        final: by name, a position (3,) from the whole recording, drawn as a line.
        truth: (3,) m for each pose, drawn dashed.
        title: line above the picture.
    """
    figure = canvas.sheet((5 + 3 * len(curves), 6.5), title)
    axes = figure.subplots(3, len(curves), squeeze=False, sharex=True)
    seconds = np.asarray(time) - np.asarray(time)[0]
    for column, (name, (position, covariance)) in enumerate(curves.items()):
        limit = 0.0
        known = np.all(np.isfinite(position), axis=1)
        for k, colour in enumerate(COLOURS):
            axes[0, column].plot(seconds, 1e3 * position[:, k], color=colour, linewidth=1.1, label="xyz"[k])
            if name in final:
                axes[0, column].axhline(1e3 * final[name][k], color=colour, linewidth=0.7, alpha=0.6)
            if truth is not None:
                axes[0, column].axhline(1e3 * truth[column][k], color=colour, linestyle="--", linewidth=0.8)
        limit = 1.4e3 * float(np.abs(position[known][-1]).max()) + 30 if known.any() else 100.0
        axes[0, column].set(title=name, ylabel="position [mm]" if column == 0 else "", ylim=(-limit, limit))
        for row, (half, scale, label) in enumerate(
            ((slice(3, 6), 1e3, "position, 95 % [mm]"), (slice(0, 3), np.rad2deg(1), "rotation, 95 % [deg]")), 1
        ):
            spread = 2 * scale * np.sqrt(np.maximum(np.trace(covariance[:, half, half], axis1=1, axis2=2), 0))
            axes[row, column].plot(seconds, np.where(spread > 0, spread, np.nan), color=COLOURS[2], linewidth=1.1)
            canvas.logarithmic(axes[row, column])
            axes[row, column].set_ylabel(label if column == 0 else "")
        axes[2, column].set_xlabel("time [s]")
    for axis in axes.flat:
        axis.grid(alpha=0.25, linewidth=0.6)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0, 0].legend(fontsize=8, frameon=False, ncols=3)
    canvas.write(path, figure)


__all__ = ["draw"]
