"""What pictures of reproduced figures share: matplotlib off screen, plain axes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

BLUE, RED, GREEN, ORANGE, GREY = "#1f4e79", "#d1495b", "#3a7d44", "#e08e45", "0.45"


def save(path: Path, size: tuple[float, float], paint: Callable[[Any], None], title: str = "") -> None:
    """Paint a figure and write it.

    Args:
        path: file to write, replaced if it exists.
        size: inches.
        paint: adds axes and lines to the figure.
        title: line above it.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    paint(figure)
    figure.savefig(path, dpi=110)


def plain(axis: Any, **labels: str) -> Any:
    """Take the frame off an axis, add a grid and labels (`xlabel`, `ylabel`, `title`); return it."""
    axis.grid(alpha=0.25, linewidth=0.6)
    axis.spines[["top", "right"]].set_visible(False)
    axis.set(**labels)
    return axis
