"""A picture of a tuning: how the objective fell from every start, and where each parameter went."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.viz import canvas

BEST, OTHER, HELD = "#1f4e79", "0.72", "#d1495b"


def draw(
    path: str | Path,
    values: NDArray[Any],
    points: NDArray[Any],
    *,
    names: Sequence[str],
    best: int,
    held_out: NDArray[Any] | None = None,
    label: str = "objective",
    title: str = "",
) -> None:
    """Draw the objective and the parameters over the evaluations and write the picture.

    Args:
        path: file to write, `.png` or another suffix that matplotlib knows; replaced if it exists.
        values: (evaluations, starts) the objective at the points that were taken so far, NaN before.
        points: (evaluations, starts, m) their parameters.
        names: of the m parameters.
        best: number of the start that ended lowest.
        held_out: (evaluations, starts) the objective on held-out recordings; None without.
        label: what the objective is.
        title: line above the picture.
    """
    rows = 1 + len(names)
    figure = canvas.sheet((9, 1.6 + 1.7 * rows), title)
    axes = np.atleast_1d(figure.subplots(rows, 1, sharex=True, height_ratios=[1.8] + [1] * len(names)))
    if (values <= 0).any():  # a log-likelihood: what counts is how far above the lowest, over many powers of ten
        values = values - np.nanmin(values)
        values, label = np.where(values > 0, values, np.nan), f"{label}, above the lowest"
        held_out = None
    count = np.arange(1, len(values) + 1)
    order = [start for start in range(values.shape[1]) if start != best] + [best]
    for start in order:
        style: dict[str, Any] = {"color": BEST if start == best else OTHER, "linewidth": 1.8 if start == best else 1.0}
        axes[0].plot(count, values[:, start], **style)
        for i, axis in enumerate(axes[1:]):
            axis.plot(count, points[:, start, i], **style)
    if held_out is not None:
        axes[0].plot(count, held_out[:, best], color=HELD, linewidth=1.4, linestyle="--")
    axes[0].set_ylabel(label, fontsize=9)
    _scale(axes[0], values)
    handles = [("best start", BEST, "-"), ("other starts", OTHER, "-"), ("held out, best start", HELD, "--")]
    shown = [h for h, there in zip(handles, (True, values.shape[1] > 1, held_out is not None), strict=True) if there]
    for text, color, line in shown:
        axes[0].plot([], [], color=color, linestyle=line, label=text)
    axes[0].legend(fontsize=8, frameon=False, loc="upper right")
    for i, (axis, name) in enumerate(zip(axes[1:], names, strict=True)):
        axis.set_title(name, fontsize=9, loc="left")
        _scale(axis, points[:, :, i])
    for axis in axes:
        axis.grid(alpha=0.25, linewidth=0.6)
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=8, which="both")
    axes[-1].set_xlabel("evaluations", fontsize=9)
    axes[-1].xaxis.get_major_locator().set_params(integer=True)
    canvas.write(path, figure)


def _scale(axis: Any, values: NDArray[Any]) -> None:
    """Use a logarithmic axis where positive values differ by more than three times."""
    there = values[np.isfinite(values)]
    if there.size and (there > 0).all() and there.max() > 3 * there.min():
        canvas.logarithmic(axis)


__all__ = ["draw"]
