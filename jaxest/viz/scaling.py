"""A picture of how time grows with size, one panel a study."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxest.viz import canvas

LINE, GUIDE = "#1f4e79", "0.6"


def draw(
    path: str | Path, series: Mapping[str, Sequence[tuple[int, float]]], slopes: Mapping[str, float]
) -> None:  # fmt: skip
    """Draw times over sizes, log-log, with a line of slope 1 to compare with, and write the picture.

    Args:
        path: file to write, `.png` or another suffix that matplotlib knows; replaced if it exists.
        series: name of what is counted -> sizes and times of a call, us.
        slopes: fitted exponents by the same names.
    """
    columns = min(3, len(series))
    figure = canvas.sheet((4.2 * columns, 3.2 * -(-len(series) // columns)))
    for i, (name, points) in enumerate(series.items()):
        axes = figure.add_subplot(-(-len(series) // columns), columns, i + 1)
        sizes, times = (np.array(x, float) for x in zip(*points, strict=True))
        axes.loglog(sizes, times, "o-", color=LINE, markersize=4)
        axes.loglog(sizes, times[-1] * sizes / sizes[-1], "--", color=GUIDE, linewidth=1, zorder=0)
        axes.set_xlabel(name)
        axes.set_ylabel("us a call")
        axes.set_ylim(times.min() / 2, times.max() * 2)
        axes.grid(alpha=0.25, which="major")
        if name in slopes:
            axes.set_title(f"exponent {slopes[name]:.2f} at the larger sizes", fontsize=10)
    canvas.write(path, figure, dpi=130)


__all__ = ["draw"]
