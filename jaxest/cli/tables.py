"""Tables of figures for the terminal."""

import math
from collections.abc import Iterable, Sequence

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from jaxest.io.report import Row


def number(value: float | None, digits: int = 3) -> str:
    """Write a number with that many significant digits, without an exponent where it stays readable."""
    if value is None:
        return ""
    if not math.isfinite(value):
        return str(value)
    if value == int(value) and abs(value) < 1e6:
        return str(int(value))
    size = int(f"{value:.{digits - 1}e}".partition("e")[2])
    return f"{value:.{max(digits - 1 - size, 0)}f}" if -4 <= size < 6 else f"{value:.{digits - 1}e}"


def speed(ratio: float | None) -> str:
    """Say how much quicker a time is than its reference, from ratio = reference / value."""
    if ratio is None:
        return ""
    return f"[green]{number(ratio, 2)} x faster[/]" if ratio >= 1 else f"[yellow]{number(1 / ratio, 2)} x slower[/]"


def figures(rows: Sequence[Row], title: str = "", *, timing: bool = False) -> Table:
    """Lay out rows; columns that nobody fills are left out.

    Args:
        rows: what was measured.
        title: line above the table.
        timing: whether ratios are of times, and read as faster or slower.

    Returns:
        The table.
    """
    table = Table(
        title=escape(title) or None, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False
    )
    cells = [_cells(row, timing) for row in rows]
    headers = ("metric", "condition", "value", "spread", "n", "reference", "ratio")
    kept = [i for i, _ in enumerate(headers) if any(cell[i] for cell in cells)]
    for i in kept:
        table.add_column(headers[i], justify="right" if headers[i] in ("value", "spread", "n") else "left",
                         no_wrap=headers[i] in ("value", "spread", "n", "ratio"))  # fmt: skip
    for cell in cells:
        table.add_row(*(cell[i] for i in kept))
    return table


def grid(headers: Iterable[str], lines: Iterable[Sequence[str]], title: str = "", right: Sequence[int] = ()) -> Table:
    """Lay out plain text, escaped; the columns numbered in `right` are aligned there."""
    table = Table(
        title=escape(title) or None, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False
    )
    for i, header in enumerate(headers):
        table.add_column(header, justify="right" if i in right else "left")
    for line in lines:
        table.add_row(*(escape(cell) for cell in line))
    return table


def _cells(row: Row, timing: bool) -> tuple[str, ...]:
    unit = "" if row.unit in ("", "1") else f" {row.unit}"
    value = f"[bold]{number(row.value)}[/]{escape(unit)}" if row.value is not None else ""
    reference = f"{number(row.reference)}{unit} " if row.reference is not None else ""
    ratio = speed(row.ratio) if timing else number(row.ratio, 2)
    return (
        escape(row.metric),
        escape(row.condition or ""),
        value,
        f"± {number(row.spread, 2)}" if row.spread is not None else "",
        str(row.n) if row.n is not None else "",
        escape(f"{reference}{row.reference_name or ''}"),
        ratio,
    )
