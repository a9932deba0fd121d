"""Fig. 2: the structure in its room, what the filter makes of it, and what encoders alone would."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxest.io.clouds import Cloud, write_cloud
from jaxest.io.report import Row
from jaxest.reproduce import Choice, Say, Section
from jaxest.reproduce.iwao2025 import runs
from jaxest.reproduce.iwao2025.conditions import Condition
from jaxest.simulate import proximity, rooms
from jaxest.types import Reading
from jaxest.viz import canvas

LINKS = (5, 20)
CAMERA = {"azimuth": 130.0, "elevation": -35.0}


def fig2(choice: Choice, say: Say) -> Section:
    """Show one room of each size; `OUT/fig2_map_*.ply` hold the maps for a viewer.

    Source: Iwao 2025, fig. 2.
    """
    seconds = 0.5 if choice.small else 20.0
    shown, rows = [], []
    for links in LINKS[:1] if choice.small else LINKS:
        say(f"fig. 2: {links} links")
        one = Condition(f"{links} links", links, *((2, 4) if choice.small else (8, 8)))
        plan = runs.Plan(100 * choice.seed, seconds)
        made = runs.simulated(one, plan, choice.work)
        found = runs.estimated(one, plan, made)
        blind = _blind_map(one, plan, made)
        shown.append((one, made, found, blind))
        for what, place in (("estimate", found.position), ("kinematics alone", found.blind)):
            error = 100 * float(np.linalg.norm(place[-1, links] - found.truth[-1, links]))
            rows.append(Row("position error at the end", f"{links} links, {what}", error, "cm"))

    def draw(path: Path) -> None:
        for one, _, found, _ in shown:
            chart, used = found.state.chart, int(found.state.chart.used)
            cloud = Cloud(np.asarray(chart.point)[:used], np.asarray(chart.total)[:used, 3])
            write_cloud(cloud, path.with_name(f"{path.stem}_map_{one.links}_links.ply"))
        canvas.save(path, (13, 4.2 * len(shown)), paint, "Fig. 2: scene, estimate with map, kinematics alone with map")

    def paint(figure: Any) -> None:
        figures = figure.subfigures(len(shown), 1, squeeze=False)[:, 0]
        for part, (one, made, found, blind) in zip(figures, shown, strict=True):
            _row(part, one, made, found, blind)

    return Section("fig2", "Fig. 2: structure, map and estimate", rows, draw)


def _blind_map(one: Condition, plan: runs.Plan, made: runs.Made) -> np.ndarray:
    """Return points (n, 3) m of some twelve scans over the whole run, placed by encoders alone."""
    import jax

    from jaxest.systems import _slam_body as bodies
    from jaxest.systems import slam

    robot, _ = runs.system(one.links, one.rows, one.columns)
    body = bodies.body(robot, made.sensors)
    given = runs.measurements(one, plan, made)
    cloud = []
    for step in range(0, len(made.scan.time), max(1, len(made.scan.time) // 12)):
        ranges = Reading(given.ranges.value[step], given.ranges.valid[step])
        points = slam.points_of(body, jax.tree.map(jax.numpy.asarray, ranges))
        links = bodies.links(body, bodies.home(body, np.float32), given.joints.value[step], body.scanned)
        where = np.einsum("lij,lnj->lni", links.rotation, points.local) + np.asarray(links.position)[:, None]
        cloud.append(where[np.asarray(points.valid)][::7])
    return np.concatenate(cloud)


def _row(figure: Any, one: Condition, made: runs.Made, found: runs.Found, blind: np.ndarray) -> None:
    picture = rendered(one.links, made)
    axes = [figure.add_subplot(1, 3, 1, **({"projection": "3d"} if picture is None else {}))]
    axes += [figure.add_subplot(1, 3, k, projection="3d", computed_zorder=False) for k in (2, 3)]
    if picture is None:
        outlines(axes[0], made.room)
        structure(axes[0], found.truth[-1], one.links, canvas.BLUE, "structure", 2.5)
    else:
        axes[0].imshow(picture)
        axes[0].set_axis_off()
    axes[0].set_title(f"{one.links} links, scene", fontsize=10)
    chart, used = found.state.chart, int(found.state.chart.used)
    clouds = ((np.asarray(chart.point)[:used], found.position[-1], "estimate"), (blind, found.blind[-1], "kinematics"))
    for axis, (points, body, title) in zip(axes[1:], clouds, strict=True):
        cloud(axis, made.room, points)
        structure(axis, found.truth[-1], one.links, "0.2", "true", 2.5)
        structure(axis, body, one.links, canvas.RED, title, 1.5)
        axis.set_title(title, fontsize=10)
        axis.legend(fontsize=8, frameon=False, loc="upper right")


def cloud(axis: Any, room: rooms.Room, points: np.ndarray) -> None:
    """Draw map points without the ceiling and the walls before the camera, coloured by height."""
    low, high = room.lower, room.upper
    size = high - low
    hidden = (points[:, 2] > high[2] - 0.12) | (points[:, 0] > high[0] - 0.12) | (points[:, 1] < low[1] + 0.12)
    seen = points[~hidden]
    axis.scatter(
        *seen.T, c=seen[:, 2], s=max(1.5, min(20.0, 6000 / len(seen))), cmap="viridis", alpha=0.55, linewidths=0
    )
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axis.set_box_aspect(size)
    axis.view_init(elev=32, azim=-50)
    axis.tick_params(labelsize=7)
    axis.set(xlabel="x [m]", ylabel="y [m]")  # a third is cut off at the edge


def structure(axis: Any, place: np.ndarray, links: int, colour: str, label: str, width: float) -> None:
    """Draw a structure through its links' origins (B, 3) m and a tip along the last link."""
    tip = place[-1] + (place[-1] - place[-2]) / max(np.linalg.norm(place[-1] - place[-2]), 1e-9) * (
        rooms.LENGTHS.get(links, 0.17)
    )
    line = np.vstack([place, tip])
    axis.plot(*line.T, "-", color=colour, lw=width, label=label)
    axis.plot(*line.T, "o", color=colour, ms=width)


def outlines(axis: Any, room: rooms.Room) -> None:
    """Draw the edges of the room and of what stands in it."""
    inside = ((room.lower + room.upper) / 2, (room.upper - room.lower) / 2)
    for center, half in (inside, *zip(room.centers[6:], room.halves[6:], strict=True)):
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half + center
        for a in range(8):
            for b in (a ^ 1, a ^ 2, a ^ 4):
                if a < b:
                    axis.plot(*corners[[a, b]].T, color="0.55" if half is inside[1] else "#b08040", lw=0.8)
    axis.set_box_aspect(room.upper - room.lower)
    axis.view_init(elev=32, azim=-50)
    axis.tick_params(labelsize=7)
    axis.set(xlabel="x [m]", ylabel="y [m]")  # a third is cut off at the edge


def rendered(links: int, made: runs.Made, free: bool = False) -> np.ndarray | None:
    """Return a picture (h, w, 3) of the scene at its last sample, None where this machine renders nothing."""
    import mujoco

    model = proximity.compiled(rooms.scene(links, made.room, free=free))
    data = mujoco.MjData(model)
    data.qpos[:] = made.scan.q[-1]
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (made.room.lower + made.room.upper) / 2 - np.array([0, 0, 0.3])
    camera.distance, camera.azimuth, camera.elevation = 8.5, CAMERA["azimuth"], CAMERA["elevation"]
    try:
        with mujoco.Renderer(model, 720, 960) as renderer:
            option = mujoco.MjvOption()
            option.geomgroup[3] = 1
            renderer.update_scene(data, camera, option)
            return renderer.render()
    except (mujoco.FatalError, RuntimeError, OSError, AttributeError, ImportError):  # no graphics here
        return None


__all__ = ["cloud", "fig2", "outlines", "rendered", "structure"]
