"""A picture of joint angles over time."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.viz import canvas

INK, TRUTH, READ = "#1f4e79", "#d1495b", "0.35"
POINTS = 3000  # more do not fit on the paper


class Lines(NamedTuple):
    """One joint's lines, each (T,) deg or mm, or None."""

    mean: Any
    lower: Any
    upper: Any
    read: Any
    true: Any


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
    slides: int = 0,
) -> None:
    """Draw joint angles with their 95 % band and write the picture.

    A line of panels for each joint: the angle, and beside it how far it is from the reference, where there is one.

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
        slides: how many of the last joints are slides, m.
    """
    pick = slice(None, None, max(1, len(time) // POINTS))
    time = np.asarray(time)[pick] - np.asarray(time)[0]
    turning = np.arange(len(names)) < len(names) - slides
    scale = np.where(turning, np.rad2deg(1.0), 1e3)
    mean, lower, upper = (np.asarray(x, float)[pick] * scale for x in (mean, lower, upper))
    read, true = (None if x is None else np.asarray(x, float)[pick] * scale for x in (reference, truth))
    columns = 1 if read is None else 2
    figure = canvas.sheet((5 + 4 * columns, 1.6 * len(names) + 0.8), title)
    axes = figure.subplots(len(names), columns, sharex=True, squeeze=False)
    for j, name in enumerate(names):
        now = Lines(*(None if x is None else x[:, j] for x in (mean, lower, upper, read, true)))
        beside = _beside if turning[j] else lambda value, other: value
        _panel(axes[j, 0], time, now, beside)
        axes[j, 0].set_ylabel(f"{name}\n[{'deg' if turning[j] else 'mm'}]", fontsize=8)
        if now.read is not None:
            zero = np.where(np.isfinite(now.read), now.read, np.nan)
            _panel(axes[j, 1], time, Lines(*(None if x is None else beside(x - zero, 0.0) for x in now)), beside)
    axes[0, 0].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4, fontsize=8, frameon=False)
    if read is not None:
        axes[0, 1].set_title("from the encoder's reading", fontsize=9, loc="left")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    canvas.write(path, figure)


def _panel(axis: Any, time: NDArray[Any], now: Lines, beside: Callable[..., Any]) -> None:
    axis.fill_between(time, now.lower, now.upper, color=INK, alpha=0.18, linewidth=0, label="95 % band")
    if now.read is not None:
        axis.plot(time, beside(now.read, now.mean), color=READ, linestyle=":", linewidth=1.4, label="encoder")
    if now.true is not None:
        axis.plot(time, beside(now.true, now.mean), color=TRUTH, linewidth=1.6, label="truth")
    axis.plot(time, now.mean, color=INK, linewidth=0.8, label="estimate")
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.6)
    axis.margins(x=0)


def _beside(value: NDArray[Any], other: Any) -> NDArray[Any]:
    """Take whole turns off angles, deg, so that they stand within half a turn of others."""
    return np.asarray(other + (value - other + 180) % 360 - 180)
