"""Fig. 4: the structure lies free on the ground; and a roll that is too fast for the paper's filter."""

import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics
from jaxest.filters import run
from jaxest.io.report import Row
from jaxest.manifolds import se3
from jaxest.reproduce import Choice, Say, Section
from jaxest.reproduce.iwao2025 import runs
from jaxest.reproduce.iwao2025.conditions import Condition
from jaxest.simulate import along, proximity, rooms
from jaxest.systems import slam, slam_inertial
from jaxest.types import Reading
from jaxest.viz import canvas

RUNS = 3
SECONDS = 30.0
FINE = 0.01  # s, between an IMU's samples
PAPER = 4.6  # cm
ROLL = (0.2, 3.0, 10.0)  # rad/s
NAMES = ("x", "y", "z")


def fig4(choice: Choice, say: Say) -> Section:
    """Let one motion on the ground be seen with other noise of ranges each time; an IMU reads the same in all runs.

    Source: Iwao 2025, fig. 4, with 100 runs.
    """
    links, count, seconds = (5, 1, 1.0) if choice.small else (20, choice.runs or RUNS, SECONDS)
    one = Condition("free", links, *((2, 4) if choice.small else (8, 8)))
    plan = runs.Plan(100 * choice.seed, seconds)
    made = crawling(one, plan, choice.work)
    root = made.scan.q[:, :7]
    rows, shown = [Row("root moved", f"free, {links} links", 100 * float(np.linalg.norm(root[-1, :3] - root[0, :3])),
                       "cm")], []  # fmt: skip
    for imu, label in ((None, "ranges and encoders"), (felt(one, plan), "with an IMU on the root")):
        found = []
        for i in range(count):
            say(f"fig. 4: {label}, run {i + 1} of {count}")
            found.append(estimate(one, made, plan.seed + i, imu=imu))
        place, turn = np.stack([f[0] for f in found]), np.stack([_signed(f[1], root[:, 3:]) for f in found])
        rows += _rows(
            f"free, {links} links" + (", with an IMU" if imu else ""), place, turn, root, [f[2] for f in found]
        )
        shown.append((label, place, turn))

    def paint(figure: Any) -> None:
        axes = figure.subplots(2, 2, sharex=True, sharey="row")
        for column, (label, place, turn) in enumerate(shown):
            for axis, values, truth, what in (
                (axes[0, column], turn[:, :, 1:], root[:, 4:], "root's quaternion"),
                (axes[1, column], place, root[:, :3], "root's position [m]"),
            ):
                canvas.plain(axis, ylabel="" if column else what)
                for k, colour in enumerate((canvas.BLUE, canvas.RED, canvas.GREEN)):
                    mean, sd = values[:, :, k].mean(0), values[:, :, k].std(0)
                    axis.plot(made.scan.time, mean, color=colour, lw=1.4, label=NAMES[k])
                    axis.fill_between(made.scan.time, mean - sd, mean + sd, color=colour, alpha=0.25, lw=0)
                    axis.plot(made.scan.time, truth[:, k], "--", color="0.2", lw=0.8)
            axes[0, column].set_title(label, fontsize=10)
            axes[1, column].set_xlabel("time [s]")
        axes[0, 0].legend(frameon=False, ncol=3, fontsize=9, title="estimate (line, band of one sd), truth (dashes)",
                          title_fontsize=8)  # fmt: skip

    title = f"Fig. 4: the free root, {count} runs of one motion"
    return Section("fig4", title, rows, lambda path: canvas.save(path, (11, 6.5), paint, title))


def _rows(condition: str, place: Any, turn: Any, root: Any, flagged: list[float]) -> list[Row]:
    """Set errors of runs (n, T, 3) and (n, T, 4) beside the true root (T, 7)."""
    count, error = len(place), 100 * np.linalg.norm(place - root[None, :, :3], axis=2)
    rows = [
        Row("root's position error", condition, float(error.mean()), "cm", float(error.mean(1).std()), count, PAPER,
            "paper, largest mean", PAPER / float(error.mean())),
        Row("root's position error, largest mean over runs", condition, float(error.mean(0).max()), "cm", n=count,
            reference=PAPER, reference_name="paper"),
        Row("steps flagged", condition, 100 * float(np.mean(flagged)), "%", n=count),
    ]  # fmt: skip
    for k, name in enumerate(NAMES):
        off = np.abs(turn[:, :, 1 + k] - root[None, :, 4 + k])
        rows.append(
            Row(f"quaternion {name}, absolute error", condition, float(off.mean()), "1", float(off.std()), count)
        )
    return rows


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
        axis = canvas.plain(figure.subplots(), xlabel="time [s]", ylabel="root's position error [cm]")
        canvas.logarithmic(axis)
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
    path = runs.scans(folder, f"free_{one.links}_{one.rows}x{one.columns}_{plan.seed}_{plan.seconds:g}s")
    if path.is_file():
        return runs.Made(room, believed, proximity.load(path))
    q = _moved(one.links, plan.seed, plan.seconds)[:: round(plan.dt / FINE)]
    model = proximity.compiled(rooms.scene(one.links, room, free=True))
    time: Any = plan.dt * np.arange(len(q))
    scan = proximity.cast(model, believed, q, time)
    proximity.save(scan, path)
    return runs.Made(room, believed, scan)


def felt(one: Condition, plan: runs.Plan) -> along.Samples:
    """Return what an IMU at the root's origin reads on that motion at 100 Hz, faults included."""
    q = _moved(one.links, plan.seed, plan.seconds)
    return along.spoiled(along.readings(q[:, :3], q[:, 3:7], FINE), along.Faults(), FINE, plan.seed)


@functools.lru_cache(maxsize=2)
def _moved(links: int, seed: int, seconds: float) -> np.ndarray:
    """Let the structure move on the floor of its room: configurations every `FINE` s."""
    room = rooms.room(seed, reach=(links + 1) * rooms.LENGTHS.get(links, 0.17), free=True)
    model = proximity.compiled(rooms.scene(links, room, free=True))
    return proximity.crawl(model, seed, duration=seconds, dt=FINE)[1]


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


def estimate(
    one: Condition, made: runs.Made, seed: int, chain: bool = False, imu: along.Samples | None = None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the root's positions (T, 3) m and quaternions (T, 4), and the share of steps with a flag."""
    fixed = runs.measurements(one, runs.Plan(seed, 0.0), made)
    home = made.scan.q[0, :7].astype(np.float32)
    if imu is not None:
        return _driven(one, fixed, home, imu)
    _, built = runs.system(one.links, one.rows, one.columns, chain, True)
    steps = len(made.scan.time)
    none = Reading(np.zeros((steps, 3), np.float32), np.zeros(steps, bool))  # type: ignore[arg-type]
    given = slam.Free(fixed.ranges, fixed.joints, none, none, fixed.dt)
    params = runs.told(one, built.default_params, chain)
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


def _driven(
    one: Condition, fixed: slam.Fixed, home: np.ndarray, imu: along.Samples
) -> tuple[np.ndarray, np.ndarray, float]:
    """Run the filter whose root an IMU drives; a scan takes the samples since the one before."""
    built, steps = _inertial(one.links, one.rows, one.columns), len(fixed.dt)
    each = round(float(fixed.dt[0]) / FINE)
    read: list[Any] = []
    for value in imu:
        rows = value[: (steps - 1) * each].reshape(steps - 1, each, 3)
        rows = np.concatenate([np.zeros((1, each, 3)), rows]).astype(np.float32)
        read.append(Reading(rows, np.ones((steps, each), bool)))  # type: ignore[arg-type]
    spacing: Any = np.full((steps, each), FINE, np.float32)
    spacing[0] = 0
    given = slam_inertial.Driven(fixed.ranges, fixed.joints, read[0], read[1], spacing, fixed.dt)
    params = built.default_params
    params = jax.tree.map(jnp.float32, params._replace(inner=runs.told(one, params.inner)))
    state = built.init(params)
    place, turn = jnp.asarray(home[:3]), jnp.asarray(home[3:])
    inner = state.inner._replace(mean=state.inner.mean._replace(position=place, quaternion=turn))
    track = state.track._replace(mean=state.track.mean._replace(pose=se3.Pose(turn, place)))
    _, info = jax.block_until_ready(run(built.step, params, state._replace(inner=inner, track=track), given))
    flagged = float(np.mean(np.asarray(info.status) == slam.LOST))
    return np.asarray(info.inner.position)[:, 0], np.asarray(info.inner.quaternion)[:, 0], flagged


@functools.cache
def _inertial(links: int, rows: int, columns: int) -> Any:
    robot = kinematics.load(rooms.structure(links, free=True))
    return slam_inertial.build(robot, rooms.sensors(links, rows=rows, columns=columns), "root")


def _signed(q: np.ndarray, like: np.ndarray) -> np.ndarray:
    return np.where(np.sum(q * like, axis=1, keepdims=True) < 0, -q, q)


__all__ = ["crawling", "estimate", "fig4", "roll", "rolling"]
