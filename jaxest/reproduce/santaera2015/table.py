"""Table I and fig. 10: radii of grasped disks from the posture and the points where links touch them."""

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest import kinematics
from jaxest.calibration import circle as circles
from jaxest.filters import last
from jaxest.io.report import Row
from jaxest.reproduce import Choice, Say, Section
from jaxest.reproduce.santaera2015 import hand, kept
from jaxest.simulate import grasp
from jaxest.viz import canvas

RUNS = 100
BATCH = 20
PAPER = {0.0245: (24.45, 0.2, 4), 0.0325: (31.84, 2.0, 4), 0.0415: (40.88, 1.4, 5)}
"""Radius: what Table I says of the radius (mm), its error (%), and the contact points."""


class Grasp(NamedTuple):
    """One grasp, in the palm's frame."""

    points: NDArray[np.float64]
    """(k, 2) m, contact points across the fingers and above the palm, by the estimated posture"""
    links: NDArray[Any]
    """(k,) names of the links that touch"""
    force: NDArray[np.float64]
    """(k,) N"""
    radius: float
    """m, of the best circle"""
    angles: NDArray[np.float64]
    """(6,) rad"""
    truth: NDArray[np.float64]
    """(6,) rad"""
    disk: NDArray[np.float64]
    """(3,) m, where its centre is"""


def table1(choice: Choice, say: Say) -> Section:
    """Grasp each disk many times and fit a circle to the contact points.

    Disks are held up to about 2 mm off, with friction 0.4 to 0.8 and tendons pulled with 6 to 10 N, up to 10 % unequal.

    Source: Santaera 2015, Table I and figs. 9, 10.
    """
    count = choice.runs or (2 if choice.small else RUNS)
    rows: list[Row] = []
    shown: dict[float, list[Grasp]] = {}
    for radius in grasp.DISKS:
        found: list[Grasp] = []
        for begin in range(0, count, BATCH):
            say(f"table I: disk of {1e3 * radius:g} mm, run {begin + 1} of {count}")
            runs = range(begin, min(begin + BATCH, count))
            tag = f"table1_{1e3 * radius:g}mm_{choice.seed}_{runs.start}_{runs.stop}"
            found += _unpacked(kept.piece(choice.work, tag, partial(_packed, radius, choice.seed, runs)))
        shown[radius] = found
        rows += _rows(radius, found)

    def draw(path: Path) -> None:
        canvas.save(path, (11, 4.2), lambda figure: _paint(figure, shown), "Table I and fig. 10: disks in the gripper")

    return Section("table1", "Table I: radii of the grasped disks", rows, draw)


def scene(radius: float, seed: int, k: int) -> grasp.Scene:
    """Draw how a disk is held and grasped."""
    random = np.random.default_rng([seed, k, round(1e4 * radius)])
    across, above = random.normal(0, 1e-3, 2)
    height = grasp.DISKS[radius]
    near = height - radius < 2e-3  # this disk lies against the palm, and cannot be held lower
    return grasp.Scene(
        radius, (across, height + (abs(above) / 2 if near else above)), friction=random.uniform(0.4, 0.8),
        tension=random.uniform(6, 10), ratio=random.uniform(0.9, 1.1),
    )  # fmt: skip


def _seed(radius: float, seed: int, k: int) -> int:
    return int(np.random.default_rng([seed, k, round(1e4 * radius), 1]).integers(2**31))


def _packed(radius: float, seed: int, runs: range) -> kept.Arrays:
    """Grasp a disk some times; the fields of `Grasp` by the number of the grasp."""
    found = grasps([hand.trial(scene(radius, seed, k), _seed(radius, seed, k)) for k in runs])
    return {f"{k}_{name}": np.asarray(value) for k, one in enumerate(found) for name, value in one._asdict().items()}


def _unpacked(arrays: kept.Arrays) -> list[Grasp]:
    count = len(arrays) // len(Grasp._fields)
    found = [Grasp._make([arrays[f"{k}_{name}"] for name in Grasp._fields]) for k in range(count)]
    return [one._replace(radius=float(one.radius)) for one in found]


def grasps(trials: list[hand.Trial]) -> list[Grasp]:
    """Estimate the postures at the end of some grasps and fit circles."""
    rotations = hand.pairs(trials, last).quaternion
    fits = hand.joints(rotations, np.stack([t.mounting for t in trials]))
    found = []
    for trial, q in zip(trials, np.asarray(fits.q, np.float64), strict=True):
        points = touched(q, trial.found.contacts)
        circle = circles.fit(points) if len(points) > 2 else None
        radius = np.nan if circle is None else float(circle.radius)
        contacts, disk = trial.found.contacts, trial.found.disk
        links, force = np.array([c.link for c in contacts], str), np.array([c.force for c in contacts], float)
        truth = hand.finger_angles(trial.found.q[-1])
        centre = np.full(3, np.nan) if disk is None else disk
        found.append(Grasp(points, links, force, radius, hand.finger_angles(q), truth, centre))
    return found


def touched(q: NDArray[np.float64], contacts: tuple[grasp.Contact, ...]) -> NDArray[np.float64]:
    """Return where links touch (k, 2), m in the palm's frame, for a posture."""
    level = np.array(q)
    level[:4] = (1, 0, 0, 0)
    if not contacts:
        return np.zeros((0, 2))
    frames = kinematics.forward(hand.robot(), level.astype(np.float32), [c.link for c in contacts])
    found = []
    for position, (w, *v), contact in zip(*(np.asarray(x, float) for x in frames), contacts, strict=True):
        turned = 2 * np.cross(v, contact.point)
        found.append(position + contact.point + w * turned + np.cross(v, turned))
    return np.array(found)[:, 1:]


def _rows(radius: float, found: list[Grasp]) -> list[Row]:
    disk, n = f"disk of {1e3 * radius:g} mm", len(found)
    mean, error, points = PAPER[radius]
    sizes = 1e3 * np.array([g.radius for g in found])
    off = 100 * np.abs(sizes / (1e3 * radius) - 1)
    counts = np.array([len(g.points) for g in found], float)
    angles = np.rad2deg(np.stack([g.angles - g.truth for g in found]))
    force = np.array([g.force.sum() for g in found])
    links = sorted({str(link) for g in found for link in g.links})
    share = [sum(link in g.links for g in found) / n for link in links]
    return [
        Row("estimated radius", disk, float(np.nanmean(sizes)), "mm", float(np.nanstd(sizes)), n, mean, "paper, 1 run"),
        Row("mean absolute error", disk, float(np.nanmean(off)), "%", float(np.nanstd(off)), n, error, "paper, 1 run"),
        Row("largest error", disk, float(np.nanmax(off)), "%", n=n),
        Row("contact points", disk, float(counts.mean()), "1", float(counts.std()), n, points, "paper"),
        Row("finger angles, RMSE", disk, float(np.sqrt(np.mean(angles**2))), "deg", n=n),
        Row("sum of contact forces", disk, float(force.mean()), "N", float(force.std()), n),
        *(Row("touches", f"{disk}, {link}", 100 * s, "%", n=n) for link, s in zip(links, share, strict=True)),
    ]


def _paint(figure: Any, shown: dict[float, list[Grasp]]) -> None:
    axes = figure.subplots(1, len(shown), sharex=True, sharey=True)
    for axis, (radius, found) in zip(axes, shown.items(), strict=True):
        one = found[0]
        draw_gripper(axis, _q(one))
        angle = np.linspace(0, 2 * np.pi, 200)
        circle = circles.fit(one.points)
        x, y = np.asarray(circle.centre)
        axis.plot(1e3 * (x + circle.radius * np.cos(angle)), 1e3 * (y + circle.radius * np.sin(angle)),
                  color=canvas.BLUE, linewidth=1.2, label=f"fit, {1e3 * one.radius:.2f} mm")  # fmt: skip
        centre = one.disk
        axis.plot(1e3 * (centre[1] + radius * np.cos(angle)), 1e3 * (centre[2] + radius * np.sin(angle)),
                  color=canvas.RED, linewidth=1, linestyle="--", label="disk")  # fmt: skip
        for point, force in zip(one.points, one.force, strict=True):
            inward = centre[1:] - point
            inward = inward / np.linalg.norm(inward) * 6e-3 * force
            axis.annotate("", 1e3 * (point + inward), 1e3 * point, arrowprops={"arrowstyle": "->", "color": "k"})
        axis.plot(*(1e3 * one.points.T), "o", color=canvas.BLUE, markersize=4)
        canvas.plain(axis, title=f"{1e3 * radius:g} mm, {len(one.points)} contacts", xlabel="across [mm]")
        axis.set_aspect("equal")
        axis.legend(fontsize=7, frameon=False, loc="upper right")
    axes[0].set_ylabel("above the palm [mm]")


def _q(one: Grasp) -> NDArray[np.float64]:
    """The estimated posture as joint coordinates."""
    names, q = hand.robot().joint_names, np.array(hand.robot().home, float)
    for name, angle in zip(grasp.LEADERS, one.angles, strict=True):
        for joint in (name, f"{name}_roll"):
            q[hand.robot().topology.joint_q[names.index(joint)]] = angle / 2
    return q


def draw_gripper(axis: Any, q: NDArray[np.float64], color: str = "0.6") -> None:
    """Draw both fingers and the palm as lines."""
    for side in ("left", "right"):
        bodies = [f"{side}_{part}" for part in ("root", "proximal", "knuckle", "middle", "end", "distal")]
        frames = [*bodies, f"site:{side}_tip"]
        position = np.asarray(kinematics.forward(hand.robot(), q.astype(np.float32), frames).position)
        axis.plot(*(1e3 * position[:, 1:].T), color=color, linewidth=7, solid_capstyle="round", alpha=0.6)
    base = np.asarray(kinematics.forward(hand.robot(), q.astype(np.float32), ["left_root", "right_root"]).position)
    axis.plot(*(1e3 * base[:, 1:].T), color="0.4", linewidth=5, alpha=0.6)


__all__ = ["Grasp", "draw_gripper", "grasps", "scene", "table1", "touched"]
