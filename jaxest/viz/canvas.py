"""What all pictures share: matplotlib off screen, files that are whole or not there, plain axes, colours."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from jaxest.files import replacing
from jaxest.io.report import Row

BLUE, RED, GREEN, ORANGE, GREY = "#1f4e79", "#d1495b", "#3a7d44", "#e08e45", "0.45"


def sheet(size: tuple[float, float], title: str = "") -> Any:
    """Return an empty matplotlib figure that needs no screen.

    Args:
        size: inches, width and height.
        title: line above it.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    return figure


def write(path: str | Path, figure: Any, dpi: int = 110) -> None:
    """Write a figure, whole or not at all.

    Args:
        path: `.png` or another suffix that matplotlib knows; replaced if it exists.
        figure: of `sheet`.
        dpi: pixels an inch.

    Raises:
        InputError: it cannot be written.
    """
    with replacing(path, overwrite=True) as file:
        figure.savefig(file, format=Path(path).suffix[1:] or "png", dpi=dpi)


def save(path: str | Path, size: tuple[float, float], paint: Callable[[Any], None], title: str = "") -> None:
    """Paint a figure and write it.

    Args:
        path: file to write, replaced if it exists.
        size: inches.
        paint: adds axes and lines to the figure.
        title: line above it.
    """
    figure = sheet(size, title)
    paint(figure)
    write(path, figure)


def plain(axis: Any, **labels: str) -> Any:
    """Take the frame off an axis, add a grid and labels (`xlabel`, `ylabel`, `title`); return it."""
    axis.grid(alpha=0.25, linewidth=0.6)
    axis.spines[["top", "right"]].set_visible(False)
    axis.set(**labels)
    return axis


def bars(path: str | Path, rows: Sequence[Row], title: str = "") -> None:
    """Write rows of one unit as bars, each above that of its reference.

    Args:
        path: file to write, replaced if it exists.
        rows: at least one; named by their metrics, or by their conditions where the metric is one.
        title: line above them.
    """
    several = len({row.metric for row in rows}) > 1
    names = [row.metric if several else row.condition for row in rows]
    references = sorted({row.reference_name or "reference" for row in rows if row.reference is not None})

    def paint(figure: Any) -> None:
        axis = plain(figure.subplots(), xlabel=f"{'' if several else rows[0].metric} [{rows[0].unit}]".strip())
        for i, row in enumerate(rows):
            axis.barh(i, row.value or 0, -0.38, xerr=row.spread, align="edge", color=BLUE)
            axis.barh(i, row.reference or 0, 0.38, align="edge", color=ORANGE)
        axis.set_yticks(range(len(rows)), names)
        axis.invert_yaxis()
        if references:
            kinds = {"jaxest": BLUE, " or ".join(references): ORANGE}
            axis.legend([axis.barh(0, 0, color=c) for c in kinds.values()], list(kinds), frameon=False, fontsize=8)

    save(path, (8, 1.2 + 0.4 * len(rows)), paint, title)


def logarithmic(axis: Any) -> None:
    """Make the y axis logarithmic, with plain numbers at 1, 2 and 5 of each decade."""
    axis.set_yscale("log")
    for part in (axis.yaxis.set_major_formatter, axis.yaxis.set_minor_formatter):
        part(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "125" else "")


def legend(figure: Any, axis: Any, **options: Any) -> None:
    """Say once, above all panels on the right, what the lines of a panel are."""
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(
        handles, labels, **{"loc": "upper right", "ncols": len(labels), "fontsize": 8, "frameon": False, **options}
    )


__all__ = ["BLUE", "GREEN", "GREY", "ORANGE", "RED", "bars", "legend", "logarithmic", "plain", "save", "sheet", "write"]
