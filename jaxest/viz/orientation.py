"""A picture of one sensor's orientation over time."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.metrics import orientation_error
from jaxest.viz import canvas

INK, TRUTH, HEADING, INCLINATION = "#1f4e79", "#d1495b", "#d1495b", "#1f4e79"
POINTS = 3000  # more do not fit on the paper
NORMAL_95, CHI_2_95 = 1.959964, 5.991465


class Angles(NamedTuple):
    """Roll, pitch and heading with their standard deviations."""

    value: NDArray[np.float64]
    """(T, 3) deg: about the sensor's x, the once rotated y, the vertical z; heading from east, counter-clockwise."""
    sd: NDArray[np.float64]
    """(T, 3) deg, first order; capped at 180."""


def angles(quaternion: NDArray[Any], covariance: NDArray[Any] | None = None) -> Angles:
    """Return roll, pitch and heading.

    Args:
        quaternion: (T, 4) wxyz, sensor to earth.
        covariance: (T, 3, 3) rad2, of the perturbation on the right (in the sensor); None means exactly known.

    Returns:
        The angles; near pitch +-90 deg roll and heading are not apart and their standard deviation grows.
    """
    w, x, y, z = np.moveaxis(np.asarray(quaternion, np.float64), -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    value = np.rad2deg(np.stack([roll, pitch, heading], axis=-1))
    if covariance is None:
        return Angles(value, np.zeros_like(value))
    level = np.maximum(np.cos(pitch), 1e-3)
    zero, s, c = np.zeros_like(roll), np.sin(roll), np.cos(roll)
    slope = np.stack(
        [
            np.stack([zero + 1, s * np.sin(pitch) / level, c * np.sin(pitch) / level], -1),
            np.stack([zero, c, -s], -1),
            np.stack([zero, s / level, c / level], -1),
        ],
        axis=-2,
    )
    variance = np.einsum("tij,tjk,tik->ti", slope, np.asarray(covariance, np.float64), slope)
    return Angles(value, np.minimum(np.rad2deg(np.sqrt(np.maximum(variance, 0))), 180.0))


def claimed_deg(quaternion: NDArray[Any], covariance: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return what an estimate claims of its own error: the bounds that 95 % of the errors should keep.

    Args:
        quaternion: (T, 4) wxyz, sensor to earth.
        covariance: (T, 3, 3) rad2, perturbation on the right.

    Returns:
        Bound of the heading error and of the inclination error, each (T,), deg.
    """
    w, x, y, z = np.moveaxis(np.asarray(quaternion, np.float64), -1, 0)
    up = np.stack(
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1
    )  # the vertical, in the sensor
    covariance = np.asarray(covariance, np.float64)
    heading = np.einsum("ti,tij,tj->t", up, covariance, up)
    rest = np.maximum(np.trace(covariance, axis1=1, axis2=2) - heading, 0)
    bounds = NORMAL_95 * np.sqrt(np.maximum(heading, 0)), np.sqrt(CHI_2_95 * rest / 2)
    return tuple(np.minimum(np.rad2deg(bound), 180.0) for bound in bounds)


def draw(
    path: str | Path,
    time: NDArray[Any],
    quaternion: NDArray[Any],
    covariance: NDArray[Any] | None = None,
    *,
    truth: NDArray[Any] | None = None,
    movement: NDArray[Any] | None = None,
    heading: bool = True,
    title: str = "",
) -> None:
    """Draw an orientation and write the picture.

    Args:
        path: file to write, `.png` or another suffix that matplotlib knows; replaced if it exists.
        time: (T,) s.
        quaternion: (T, 4) wxyz, sensor to earth.
        covariance: (T, 3, 3) rad2, perturbation on the right; draws the 95 % bands.
        truth: (T, 4) wxyz at the same times, NaN where unknown; draws it, and the error below.
        movement: (T,) bool, drawn as a shade.
        heading: whether the heading means anything (a magnetometer was used).
        title: line above the picture.
    """
    pick = slice(None, None, max(1, len(time) // POINTS))
    time, quaternion = np.asarray(time)[pick] - np.asarray(time)[0], np.asarray(quaternion)[pick]
    covariance, truth, movement = (None if a is None else np.asarray(a)[pick] for a in (covariance, truth, movement))
    rows = 4 if truth is not None else 3
    figure = canvas.sheet((10, 2.0 * rows + 0.6), title)
    axes = figure.subplots(rows, 1, sharex=True)
    mine = angles(quaternion, covariance)
    true = None if truth is None else angles(truth).value
    for index, name in enumerate(("roll", "pitch", "heading")):
        free = index == 2 and not heading  # then the estimate has an own idea of north, and the truth another
        _panel(axes[index], time, mine, None if free else true, index, f"{name} (free)" if free else name)
    if truth is not None:
        _errors(axes[-1], time, quaternion, covariance, truth, heading)
    for axis in axes:
        if movement is not None:
            axis.fill_between(time, 0, 1, where=~movement, transform=axis.get_xaxis_transform(), color="0.5", alpha=0.1,
                              linewidth=0, zorder=0, label="at rest" if axis is axes[0] else None)  # fmt: skip
        axis.grid(alpha=0.25, linewidth=0.6)
        axis.spines[["top", "right"]].set_visible(False)
        axis.margins(x=0)
    axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, fontsize=8, frameon=False)
    axes[-1].set_xlabel("time [s]")
    canvas.write(path, figure, dpi=130)


def _panel(axis: Any, time: Any, mine: Angles, true: Any, index: int, name: str) -> None:
    value, half = mine.value[:, index], NORMAL_95 * mine.sd[:, index]
    limit = 180 if index != 1 else 90
    if half.any():
        axis.fill_between(time, np.maximum(value - half, -limit), np.minimum(value + half, limit), color=INK,
                          alpha=0.2, linewidth=0, label="95 % band")  # fmt: skip
    if true is not None:
        axis.plot(time, _broken(true[:, index]), color=TRUTH, linewidth=1.8, alpha=0.6, label="truth")
    axis.plot(time, _broken(value), color=INK, linewidth=0.9, label="estimate")
    axis.set_ylabel(f"{name} [deg]")
    axis.locator_params(axis="y", nbins=5, steps=[1, 1.5, 2, 3, 4.5, 5, 9, 10])  # 30, 45 and 90 degrees are ticks


def _errors(axis: Any, time: Any, quaternion: Any, covariance: Any, truth: Any, heading: bool) -> None:
    error = orientation_error(np.asarray(quaternion, np.float64), np.asarray(truth, np.float64))
    shown = [("inclination", error.inclination, INCLINATION, 1)]
    if heading:
        shown.insert(0, ("heading", error.heading, HEADING, 0))
    bounds = None if covariance is None else claimed_deg(quaternion, covariance)
    top = 0.0
    for name, value, colour, which in shown:
        degrees = np.rad2deg(value)
        axis.plot(time, degrees, color=colour, linewidth=0.9, label=f"{name} error")
        top = max(top, float(np.nanpercentile(degrees, 99.5)) if np.isfinite(degrees).any() else 0.0)
        if bounds is not None:
            axis.plot(time, bounds[which], color=colour, linewidth=1, linestyle=":", label=f"{name}, 95 % claimed")
            top = max(top, min(float(np.median(bounds[which])), 90.0))
    axis.set_ylim(0, max(1.25 * top, 1.0))
    axis.set_ylabel("error [deg]")
    axis.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, fontsize=8, frameon=False)


def _broken(value: NDArray[Any]) -> NDArray[Any]:
    """Cut the line where an angle wraps around."""
    shown = value.copy()
    shown[1:][np.abs(np.diff(value)) > 180] = np.nan
    return shown
