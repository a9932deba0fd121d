"""How `inspect` shows a log: a table of streams, clocks, what looks wrong, and a config to paste."""

import json
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.syntax import Syntax
from rich.table import Table

from jaxest.cli.methods.imu_steps import KINDS
from jaxest.cli.tables import grid, number
from jaxest.io.inspect import StreamSummary, Summary
from jaxest.io.report import Row
from jaxest.io.units import kind_of


def rows(summary: Summary) -> list[Row]:
    """Return a log's figures as rows of a report.

    Args:
        summary: from `jaxest.io.inspect.summarize`.

    Returns:
        For each stream samples, duration, rate, jitter, gaps, longest gap and missing rows.
    """
    made = []
    for s in summary.streams:
        figures: tuple[tuple[str, float, str], ...] = (
            ("samples", s.n, "1"), ("duration", s.duration, "s"), ("rate", s.rate, "Hz"), ("jitter", s.jitter, "s"),
            ("gaps", s.gaps.number, "1"), ("longest gap", s.gaps.longest, "s"), ("missing rows", s.missing, "1"),
        )  # fmt: skip
        made += [Row(metric, s.name, float(value), unit, n=s.n) for metric, value, unit in figures]
    return made


def show(summary: Summary, title: str, out: Console) -> None:
    """Print the streams, their clocks and the warnings.

    Args:
        summary: from `jaxest.io.inspect.summarize`.
        title: line above the table.
        out: where to.
    """
    out.print(_streams(summary, title))
    apart = [skew for skew in summary.skews if skew.start or skew.end or abs(skew.rate_ratio - 1) > 1e-6]
    if apart:
        lines = [(k.name, f"{k.start:+.6g} s", f"{k.end:+.6g} s", number(k.rate_ratio, 6)) for k in apart]
        out.print(
            grid(("clock", "first stamp", "last stamp", "rate"), lines, f"against {apart[0].reference}", (1, 2, 3))
        )
    for line in summary.warnings:
        out.print(f"[yellow]warning:[/] {escape(line)}", soft_wrap=True)
    if not summary.warnings:
        out.print("[green]nothing looks wrong[/]")


def with_settings(text: str, summary: Summary, imus: list[str], deflection: str = "", onsite: str = "") -> str:
    """Put around a config what `estimate` needs to be told about a log, beside its layout.

    Args:
        text: the lines of `[columns]`, or nothing.
        summary: from `jaxest.io.inspect.summarize`.
        imus: names of the IMUs; one of several is to be chosen.
        deflection: the lines of `[deflection]`, if there are any.
        onsite: the lines of `[onsite]`, likewise.

    Returns:
        TOML text; nothing where nothing needs to be said.
    """
    missing = sum(s.missing for s in summary.streams if kind_of(s.name) in KINDS)
    parts = []
    if missing:
        parts.append(f'nan = "missing"  # {missing} rows are not finite; without this line they are refused\n')
    parts += [text] if text else []
    if len(imus) > 1:
        others = ", ".join(json.dumps(name) for name in imus[1:])
        parts.append(f"[orientation]\nimu = {json.dumps(imus[0])}  # or {others}\n")
    parts += [lines for lines in (deflection, onsite) if lines]
    return "\n".join(parts)


def show_config(text: str, out: Console) -> None:
    """Print a config, to be pasted."""
    if out.is_terminal:
        out.print(Syntax(text.rstrip(), "toml", background_color="default", word_wrap=True))
    else:
        out.print(text.rstrip(), markup=False, soft_wrap=True)


def _streams(summary: Summary, title: str) -> Table:
    headers = ("stream", "samples", "shape", "unit", "rate", "duration", "gaps", "NaN", "frame")
    lines = [_line(s) for s in summary.streams]
    kept = [i for i, header in enumerate(headers) if header != "frame" or any(line[i] for line in lines)]
    right = [headers[i] for i in kept]
    return grid(right, [[line[i] for i in kept] for line in lines], title, range(1, len(right)))


def _line(s: StreamSummary) -> tuple[str, ...]:
    rate = f"{number(s.rate, 4)} Hz" if np.isfinite(s.rate) else ""
    gaps = f"{s.gaps.number} (to {number(s.gaps.longest)} s)" if s.gaps.number else "-"
    shape = " x ".join(map(str, s.shape)) or "1"
    return (s.name, str(s.n), shape, s.unit, rate, f"{number(s.duration, 4)} s", gaps, str(s.missing or "-"), s.frame)


def plain(summary: Summary) -> dict[str, Any]:
    """Return the summary as data that JSON can hold."""
    return {
        "streams": [{**s._asdict(), "gaps": s.gaps._asdict()} for s in summary.streams],
        "skews": [s._asdict() for s in summary.skews],
        "warnings": list(summary.warnings),
    }
