"""A robot's links in the map of what is about them, and how its encoders' biases became known."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.viz import canvas


class Biases(NamedTuple):
    """What encoders are off by, as it was known at each of T steps."""

    time: NDArray[np.float64]
    """(T,) s."""
    mean: NDArray[np.float64]
    """(T, n) rad, or m of a slide."""
    deviation: NDArray[np.float64]
    """(T, n), standard deviations."""
    slides: NDArray[np.bool_]
    """(n,) which are of slides."""


def draw(
    path: Path,
    points: NDArray[np.float64],
    place: NDArray[np.float64],
    parent: Sequence[int],
    biases: Biases,
    *,
    title: str = "",
) -> None:
    """Draw map points, coloured by height, the robot as lines between its bodies, and biases with their 95 % bands.

    Args:
        path: PNG to write.
        points: (n, 3) m, of the map.
        place: (B, 3) m, origins of the bodies.
        parent: (B,) of each body, -1 for the world.
        biases: of the joints.
        title: line above the picture.
    """
    figure = canvas.sheet((15, 5), title)
    low, high = np.vstack([points, place]).min(0), np.vstack([points, place]).max(0)
    inside = np.all((points > low + 0.12) & (points < high - 0.12), axis=1) | (points[:, 2] < low[2] + 0.3)
    solid = figure.add_subplot(1, 3, 1, projection="3d", computed_zorder=False)
    solid.scatter(*points[inside].T, c=points[inside, 2], s=5, cmap="viridis", depthshade=False, linewidths=0)
    above = figure.add_subplot(1, 3, 2)
    above.scatter(points[:, 0], points[:, 1], c=points[:, 2], s=2, cmap="viridis", linewidths=0)
    for k, up in enumerate(parent):
        if up >= 0:
            line = place[[up, k]]
            solid.plot(*line.T, "o-", color="#d1495b", lw=2, ms=3)
            above.plot(line[:, 0], line[:, 1], "o-", color="#d1495b", lw=2, ms=3)
    for axis in (solid, above):
        axis.locator_params(nbins=5)
        axis.tick_params(labelsize=8)
    solid.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    solid.set_box_aspect(np.maximum(high - low, 0.1), zoom=0.85)
    solid.set_title("without walls and ceiling", fontsize=10)
    solid.view_init(elev=32, azim=-55)
    above.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    above.set_title("from above", fontsize=10)
    _curves(figure.add_subplot(1, 3, 3), biases)
    canvas.write(path, figure)


def _curves(axis: Any, biases: Biases) -> None:
    """Draw a line and a band for each bias; those of slides in mm, on the same scale."""
    seconds = biases.time - biases.time[0]
    scale = np.where(biases.slides, 1e3, np.rad2deg(1.0))
    mean, half = biases.mean * scale, 1.96 * biases.deviation * scale
    for k in range(mean.shape[1]):
        colour = f"C{k % 10}"
        axis.fill_between(seconds, mean[:, k] - half[:, k], mean[:, k] + half[:, k], color=colour, alpha=0.15, lw=0)
        axis.plot(seconds, mean[:, k], color=colour, lw=1.1)
    unit = "mm" if biases.slides.all() else "deg, slides mm" if biases.slides.any() else "deg"
    canvas.plain(axis, xlabel="time [s]", ylabel=f"bias [{unit}]")
    axis.set_title("biases of the encoders, 95 %", fontsize=10)


__all__ = ["Biases", "draw"]
