"""A robot's links in the map of what is about them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jaxest.viz import canvas


def draw(
    path: Path, points: NDArray[np.float64], place: NDArray[np.float64], parent: Sequence[int], *, title: str = ""
) -> None:
    """Draw map points, coloured by height, and the robot as lines between its bodies.

    Args:
        path: PNG to write.
        points: (n, 3) m, of the map.
        place: (B, 3) m, origins of the bodies.
        parent: (B,) of each body, -1 for the world.
        title: line above the picture.
    """
    figure = canvas.sheet((11, 5), title)
    low, high = np.vstack([points, place]).min(0), np.vstack([points, place]).max(0)
    inside = np.all((points > low + 0.12) & (points < high - 0.12), axis=1) | (points[:, 2] < low[2] + 0.3)
    solid = figure.add_subplot(1, 2, 1, projection="3d", computed_zorder=False)
    solid.scatter(*points[inside].T, c=points[inside, 2], s=2, cmap="viridis", alpha=0.5, linewidths=0)
    above = figure.add_subplot(1, 2, 2)
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
    solid.set_box_aspect(np.maximum(high - low, 0.1))
    solid.set_title("without walls and ceiling", fontsize=10)
    solid.view_init(elev=32, azim=-55)
    above.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    above.set_title("from above", fontsize=10)
    canvas.write(path, figure)


__all__ = ["draw"]
