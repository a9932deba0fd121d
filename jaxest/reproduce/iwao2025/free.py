"""Fig. 4: the structure lies free on the ground; and a roll that is too fast for the paper's filter."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters import run
from jaxest.io.report import Row
from jaxest.reproduce import Choice, Say, Section
from jaxest.reproduce.iwao2025 import runs
from jaxest.reproduce.iwao2025.conditions import Condition
from jaxest.simulate import proximity, rooms
from jaxest.systems import slam
from jaxest.types import Reading
from jaxest.viz import canvas

RUNS = 3
SECONDS = 30.0
PAPER = 4.6  # cm
ROLL = (0.2, 3.0, 10.0)  # rad/s
NAMES = ("x", "y", "z")


def fig4(choice: Choice, say: Say) -> Section:
    """Let one motion on the ground be seen with other noise each time.

    Source: Iwao 2025, fig. 4, with 100 runs.
    """
    links, count, seconds = (5, 1, 1.0) if choice.small else (20, choice.runs or RUNS, SECONDS)
    one = Condition("free", links, *((2, 4) if choice.small else (8, 8)))
    made = crawling(one, runs.Plan(100 * choice.seed, seconds), choice.work)
    found = []
    for i in range(count):
        say(f"fig. 4: run {i + 1} of {count}")
        found.append(estimate(one, made, 100 * choice.seed + i))
    place = np.stack([f[0] for f in found])
    turn = np.stack([_signed(f[1], made.scan.q[:, 3:7]) for f in found])
    moved = np.linalg.norm(made.scan.q[-1, :3] - made.scan.q[0, :3])
    error = 100 * np.linalg.norm(place - made.scan.q[None, :, :3], axis=2)
    rows = [
        Row("root's position error", f"free, {links} links", float(error.mean()), "cm", float(error.mean(1).std()),
            count, PAPER, "paper, largest mean", PAPER / float(error.mean())),
        Row("root's position error, largest mean over runs", f"free, {links} links", float(error.mean(0).max()), "cm",
            n=count, reference=PAPER, reference_name="paper"),
        Row("root moved", f"free, {links} links", 100 * float(moved), "cm"),
        Row("steps flagged", f"free, {links} links", 100 * float(np.mean([f[2] for f in found])), "%", n=count),
    ]  # fmt: skip
    for k, name in enumerate(NAMES):
        off = np.abs(turn[:, :, 1 + k] - made.scan.q[None, :, 4 + k])
        rows.append(Row(f"quaternion {name}, absolute error", "free", float(off.mean()), "1", float(off.std()), count))

    def paint(figure: Any) -> None:
        axes = figure.subplots(2, 1, sharex=True)
        for axis, values, truth, label in (
            (axes[0], turn[:, :, 1:], made.scan.q[:, 4:7], "root's quaternion"),
            (axes[1], place, made.scan.q[:, :3], "root's position [m]"),
        ):
            canvas.plain(axis, ylabel=label)
            for k, colour in enumerate((canvas.BLUE, canvas.RED, canvas.GREEN)):
                mean, sd = values[:, :, k].mean(0), values[:, :, k].std(0)
                axis.plot(made.scan.time, mean, color=colour, lw=1.4, label=NAMES[k])
                axis.fill_between(made.scan.time, mean - sd, mean + sd, color=colour, alpha=0.25, lw=0)
                axis.plot(made.scan.time, truth[:, k], "--", color=colour, lw=1)
        axes[0].legend(frameon=False, ncol=3, fontsize=9, title="estimate (line, band of one sd), truth (dashes)")
        axes[1].set_xlabel("time [s]")

    title = f"Fig. 4: the free root, {count} runs of one motion"
    return Section("fig4", title, rows, lambda path: canvas.save(path, (9, 7), paint, title))


def roll(choice: Choice, say: Say) -> Section:
    """Roll the structure faster and faster: what each filter loses, and whether ours says so.

    Source: Iwao 2025, section III-B, which names the failure and gives no figure.
    """
    links, seconds = (5, 1.0) if choice.small else (20, 12.0)
    one = Condition("roll", links, *((2, 4) if choice.small else (8, 8)))
    rows, shown = [], []
    for rate in ROLL:
        made = rolling(one, runs.Plan(100 * choice.seed, seconds), rate)
        for chain in (False, True):
            name = "paper's filter" if chain else "joint belief"
            say(f"roll: {rate:g} rad/s, {name}")
            place, _, flagged = estimate(one, made, 100 * choice.seed, chain)
            error = 100 * np.linalg.norm(place - made.scan.q[:, :3], axis=1)
            rows.append(Row("root's position error, largest", f"{rate:g} rad/s, {name}", float(error.max()), "cm"))
            if not chain:
                rows.append(Row("steps flagged", f"{rate:g} rad/s", 100 * flagged, "%"))
            shown.append((f"{rate:g} rad/s, {name}", made.scan.time, error))

    def paint(figure: Any) -> None:
        axis = canvas.plain(figure.subplots(), xlabel="time [s]", ylabel="root's position error [cm]", yscale="log")
        for (label, time, error), colour in zip(
            shown, (canvas.BLUE, canvas.GREY, canvas.RED, canvas.ORANGE, canvas.GREEN, "0.3"), strict=True
        ):
            axis.plot(time, np.maximum(error, 1e-2), color=colour, label=label)
        axis.legend(frameon=False, fontsize=9)

    title = "A roll that is too fast for random walks of the root"
    return Section("roll", title, rows, lambda path: canvas.save(path, (8, 4.5), paint, title))


def crawling(one: Condition, plan: runs.Plan, folder: Path | None) -> runs.Made:
    """Simulate the structure's motion on the ground with contact and cast its rays, or read them."""
    room = rooms.room(plan.seed, reach=(one.links + 1) * rooms.LENGTHS.get(one.links, 0.17), free=True)
    believed = rooms.sensors(one.links, rows=one.rows, columns=one.columns)
    path = runs.keep(folder) / "scans" / f"free_{one.links}_{one.rows}x{one.columns}_{plan.seed}_{plan.seconds:g}s.npz"
    if path.is_file():
        return runs.Made(room, believed, proximity.load(path))
    model = proximity.compiled(rooms.scene(one.links, room, free=True))
    time, q = proximity.crawl(model, plan.seed, duration=plan.seconds, dt=plan.dt)
    scan = proximity.cast(model, believed, q, time)
    proximity.save(scan, path)
    return runs.Made(room, believed, scan)


def rolling(one: Condition, plan: runs.Plan, rate: float) -> runs.Made:
    """Let the bent structure lie for 2 s, then turn about its length at `rate` rad/s, in mid-air."""
    room = rooms.room(plan.seed, reach=(one.links + 1) * rooms.LENGTHS.get(one.links, 0.17))
    believed = rooms.sensors(one.links, rows=one.rows, columns=one.columns)
    model = proximity.compiled(rooms.scene(one.links, room, free=True))
    time: Any = plan.dt * np.arange(round(plan.seconds / plan.dt))
    angle = rate * np.maximum(time - min(2.0, plan.seconds / 3), 0)
    q = np.zeros((len(time), model.nq))
    q[:, 3], q[:, 4] = np.cos(angle / 2), np.sin(angle / 2)
    q[:, 7:] = 0.05 * np.sin(np.arange(one.links))
    return runs.Made(room, believed, proximity.cast(model, believed, q, time))


def estimate(one: Condition, made: runs.Made, seed: int, chain: bool = False) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the root's positions (T, 3) m and quaternions (T, 4), and the share of steps with a flag."""
    _, built = runs.system(one.links, one.rows, one.columns, chain, True)
    fixed = runs.measurements(one, runs.Plan(seed, 0.0), made)
    steps = len(made.scan.time)
    none = Reading(np.zeros((steps, 3), np.float32), np.zeros(steps, bool))  # type: ignore[arg-type]
    given = slam.Free(fixed.ranges, fixed.joints, none, none, fixed.dt)
    params = runs.told(one, built.default_params, chain)
    home = made.scan.q[0, :7].astype(np.float32)
    state = built.init(params)
    if chain:
        pose = state.links.pose
        pose = pose._replace(
            rotation=pose.rotation.at[0].set(home[3:]), translation=pose.translation.at[0].set(home[:3])
        )
        state = state._replace(links=state.links._replace(pose=pose))
    else:
        mean = state.mean._replace(position=jnp.asarray(home[:3]), quaternion=jnp.asarray(home[3:]))
        state = state._replace(mean=mean)
    _, info = jax.block_until_ready(run(built.step, params, state, given))
    flagged = float(np.mean(np.asarray(info.status) == slam.LOST)) if not chain else 0.0
    return np.asarray(info.position)[:, 0], np.asarray(info.quaternion)[:, 0], flagged


def _signed(q: np.ndarray, like: np.ndarray) -> np.ndarray:
    return np.where(np.sum(q * like, axis=1, keepdims=True) < 0, -q, q)


__all__ = ["crawling", "estimate", "fig4", "roll", "rolling"]
