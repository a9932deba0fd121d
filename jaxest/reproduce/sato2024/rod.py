"""The rod with two IMUs: Fig. 5 with the calibration of section III-E, sensors' noise, and section V-B."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.filters import last, run
from jaxest.io.report import Row
from jaxest.manifolds import quaternion as quat
from jaxest.metrics import orientation_error
from jaxest.reproduce import Choice, Say, Section
from jaxest.reproduce.sato2024.recorded import RATE, SHAKING, Recorded, corrected, params, record
from jaxest.systems import onsite, onsite_batch
from jaxest.systems.onsite_simulation import Pair
from jaxest.viz import canvas

PAPER = {"half_width": 3, "degree": 5, "plain": True}
NOISES = {"gyro 0.01 rad/s, accelerometer 0.05 m/s2": (0.01, 0.05), "three times the noise": (0.03, 0.1)}
LEFT = {
    "accelerometer_axes": "accelerometer_relative",
    "accelerometer_bias": "accelerometer_bias_deviation",
    "accelerometer_turn": "accelerometer_turn",
}
"""What a calibration leaves: in the parameters of `onsite`, and in the calibration."""
CHI2 = 7.815  # 95 % of three degrees of freedom


class Off(NamedTuple):
    """How far estimates are off, an entry a run."""

    distance: NDArray[np.float64]
    """(n,) mm"""
    angle: NDArray[np.float64]
    """(n,) deg"""
    placed: NDArray[np.bool_]
    """(n,) whether the 95 % ellipsoid holds the position"""
    turned: NDArray[np.bool_]
    """(n,) likewise the rotation"""


@partial(jax.jit, static_argnames=("half_width", "degree", "plain"))
def _live(given: Any, many: Pair, half_width: int = 7, degree: int = 3, plain: bool = False) -> Any:
    system = onsite.build(half_width=half_width, degree=degree, plain=plain)
    return jax.vmap(lambda one: run(system.step, given, system.init(given), one, history=last)[1])(many)


@jax.jit
def _live_each(given: Any, many: Pair) -> Any:
    """Every rod with what its own calibration left."""
    system = onsite.build()
    axes: Any = [0 if name in LEFT else None for name in onsite.Params._fields]
    axes = onsite.Params(*axes)
    final = jax.vmap(lambda p, one: run(system.step, p, system.init(p), one, history=last)[1], in_axes=(axes, 0))
    return final(given, many)


@jax.jit
def _curve(given: Any, one: Pair) -> Any:
    system = onsite.build()

    def kept(state: Any, info: onsite.Info) -> Any:
        return info.position, info.quaternion, info.covariance

    return run(system.step, given, system.init(given), one, history=kept)[1]


def off(found: Any, position: Any, quaternion: Any) -> Off:
    """Compare estimates (leading axis n) with the truth."""
    place = np.asarray(found.position, float) - np.asarray(position, float)
    estimated = jnp.asarray(found.quaternion)
    turn = np.asarray(jax.vmap(quat.local)(estimated, jnp.asarray(quaternion, estimated.dtype)), float)
    covariance = np.asarray(found.covariance, float)

    def within(error: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.einsum("ni,nij,nj->n", error, np.linalg.inv(c), error) < CHI2

    return Off(1e3 * np.linalg.norm(place, axis=1), np.rad2deg(np.linalg.norm(turn, axis=1)),
               within(place, covariance[:, 3:, 3:]), within(turn, covariance[:, :3, :3]))  # fmt: skip


def _stacked(trees: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *x: np.stack([np.asarray(y) for y in x]), *trees)


def _rows(
    condition: str, errors: Off, *, paper: tuple[float, float] | None = None, coverage: bool = False
) -> list[Row]:
    n = len(errors.distance)
    rows = []
    for what, value, unit, k in (("position", errors.distance, "mm", 0), ("rotation", errors.angle, "deg", 1)):
        spread = float(1.25 * np.std(value) / np.sqrt(n))  # of a median, roughly
        reference = paper[k] if paper else None
        rows.append(Row(f"{what} error, median", condition, float(np.median(value)), unit, spread, n))
        rows.append(Row(f"{what} error, worst", condition, float(value.max()), unit, n=n, reference=reference,
                        reference_name="paper, at most" if paper else ""))  # fmt: skip
    if coverage:
        for what, inside in (("position", errors.placed), ("rotation", errors.turned)):
            share = float(inside.mean())
            rows.append(Row(f"{what} within its 95 % ellipsoid", condition, 100 * share, "%",
                            100 * float(np.sqrt(share * (1 - share) / n)), n))  # fmt: skip
    return rows


def fig5(choice: Choice, say: Say) -> Section:
    """Calibrate two IMUs, shake the rod, and follow the estimate: the paper's figure, over several rods.

    Source: Sato 2024, section IV-A, Fig. 5.
    """
    runs = 1 if choice.small else choice.runs or 20
    rods, raw, whole = [], [], []
    recorded, leftover = [], []
    for i in range(runs):
        say(f"fig. 5: rod {i + 1} of {runs}")
        one = record(1000 * choice.seed + i, small=choice.small)
        recorded.append(one)
        calibrated, known = corrected(one, small=choice.small)
        rods.append(calibrated)
        # Two accelerometers move the difference of their forces by the sum of their variances.
        left = {name: float(np.sqrt(np.mean([getattr(c, said) ** 2 for c in known]))) for name, said in LEFT.items()}
        leftover.append(left)
        raw.append(corrected(one, small=choice.small, calibrating=False)[0])
        prior = onsite_batch.Prior(gyroscope_bias=0.003, **left)
        whole.append(jax.tree.map(np.asarray, onsite_batch.choose(rods[-1], prior).estimate))
    truth = np.stack([r.position for r in recorded]), np.stack([r.quaternion for r in recorded])
    given = params()._replace(gyroscope_bias=np.float32(0.003))
    unsure = given._replace(**{name: np.asarray([one[name] for one in leftover], np.float32) for name in LEFT})
    say("fig. 5: live")
    rows = _rows(
        "calibrated, live", off(_live_each(unsure, _stacked(rods)), *truth), paper=(3.0, 3.0), coverage=runs >= 20
    )
    rows += _rows("calibrated, live, the paper's window", off(_live(given, _stacked(rods), **PAPER), *truth))
    rows += _rows("calibrated, whole recording", off(_stacked(whole), *truth), coverage=runs >= 20)
    rows += _rows("accelerometers not calibrated, live", off(_live(given, _stacked(raw)), *truth))
    curve = tuple(np.asarray(x, float) for x in _curve(given, rods[0]))

    def paint(figure: Any) -> None:
        _paint(figure, recorded[0], curve)

    title = "Fig. 5: two IMUs on a rod of 200 mm, calibrated, shaken by hand"
    return Section("fig5", title, rows, lambda path: canvas.save(path, (8, 10), paint, title))


def _paint(figure: Any, one: Recorded, curve: tuple[NDArray[np.float64], ...]) -> None:
    position, quaternion, covariance = curve
    time = np.arange(len(position)) / RATE
    axes = figure.subplots(5, sharex=True)
    names = ("rate [rad/s]", "position [mm]", "error [mm]", "error [deg]", "sqrt of trace [mm]")
    for axis, label in zip(axes, names, strict=True):
        canvas.plain(axis, ylabel=label)
    for k, colour in enumerate((canvas.RED, canvas.GREEN, canvas.BLUE)):
        axes[0].plot(time, one.rate[-len(time) :, k], color=colour, linewidth=0.5)
        axes[1].plot(time, 1e3 * position[:, k], color=colour, linewidth=1.1, label="xyz"[k])
        axes[1].axhline(1e3 * one.position[k], color=colour, linestyle="--", linewidth=0.8)
    there = np.any(position != 0, axis=1)
    error = 1e3 * np.linalg.norm(position - one.position, axis=1)
    angle = np.rad2deg(orientation_error(quaternion, one.quaternion).total)
    spread = 1e3 * np.sqrt(np.trace(covariance[:, 3:, 3:], axis1=1, axis2=2))
    for axis, value in ((axes[2], error), (axes[3], angle), (axes[4], spread)):
        axis.plot(time[there], value[there], color=canvas.BLUE, linewidth=1.1)
        axis.set_yscale("log")
    axes[2].axhline(3, color=canvas.GREY, linestyle="--", linewidth=0.8)
    axes[1].legend(fontsize=8, frameon=False, ncols=3)
    axes[1].set_ylim(-230, 230)
    axes[4].set_xlabel("time [s]")


@partial(jax.jit, static_argnames="steps")
def _shaken(keys: Any, gyroscope: Any, accelerometer: Any, speed: Any, steps: int) -> Any:
    def one(key: Any) -> Any:
        return onsite.simulate(
            params(), key=key, steps=steps, gyroscope=gyroscope, accelerometer=accelerometer, speed=speed
        )

    return jax.vmap(one)(keys)


def noise(choice: Choice, say: Say) -> Section:
    """Shake rods mounted anyhow for 40 s at two levels of noise; beside ours the paper's window in the same run."""
    runs, steps = (2, 500) if choice.small else (choice.runs or 100, SHAKING)
    rows: list[Row] = []
    for number, (condition, (gyro, force)) in enumerate(NOISES.items()):
        say(f"rod: {condition}")
        keys = jax.random.split(jax.random.key(100 * choice.seed + 7 + number), runs)
        many, truth = _shaken(keys, gyro, force, 1.0, steps)
        ours = off(_live(params(), many), truth.position, truth.quaternion)
        rows += _rows(f"{condition}, live", ours, coverage=True)
        say(f"rod: {condition}, whole recordings")
        one = [jax.tree.map(lambda x, i=i: np.asarray(x[i]), many) for i in range(runs)]
        found = [onsite_batch.choose(m) for m in one]
        widths = np.array([int(f.half_width) for f in found])
        whole = off(_stacked([f.estimate for f in found]), truth.position, truth.quaternion)
        rows += _rows(f"{condition}, window from the data", whole, coverage=True)
        rows.append(Row("half width chosen, median", condition, float(np.median(widths)), "1", n=runs))
        theirs = off(_live(params(), many, **PAPER), truth.position, truth.quaternion)
        rows += _rows(f"{condition}, the paper's window (N = 3, M = 5)", theirs)
    title = "The rod of 200 mm, 40 s at 100 Hz"
    placed = [row for row in rows if row.metric == "position error, median"]
    return Section("noise", title, rows, lambda path: canvas.bars(path, placed, title))


def motion(choice: Choice, say: Say) -> Section:
    """Shake harder and see the covariance fall, as section V-B expects; the errors beside it."""
    runs, steps = (2, 500) if choice.small else (choice.runs or 20, SHAKING)
    rows, shown = [], []
    speeds = (0.5, 1.0, 2.0, 4.0)
    for speed in speeds:
        say(f"section V-B: {speed:g} rad/s")
        keys = jax.random.split(jax.random.key(100 * choice.seed + 50), runs)
        many, truth = _shaken(keys, *NOISES["three times the noise"], speed, steps)
        found = _live(params(), many)
        errors = off(found, truth.position, truth.quaternion)
        spread = 1e3 * np.sqrt(np.trace(np.asarray(found.covariance, float)[:, 3:, 3:], axis1=1, axis2=2))
        condition = f"{speed:g} rad/s rms"
        rows.append(
            Row("sqrt of trace of the position's covariance", condition, float(np.median(spread)), "mm", n=runs)
        )
        rows.append(Row("position error, median", condition, float(np.median(errors.distance)), "mm", n=runs))
        shown.append((float(np.median(spread)), float(np.median(errors.distance))))

    def paint(figure: Any) -> None:
        axis = canvas.plain(figure.subplots(), xlabel="rate [rad/s rms]", ylabel="of the position [mm]")
        for column, (label, colour) in enumerate((("sqrt of trace", canvas.BLUE), ("error, median", canvas.RED))):
            axis.semilogx(speeds, [s[column] for s in shown], "o-", color=colour, label=label)
        canvas.logarithmic(axis)
        axis.set_xticks(speeds, [f"{speed:g}" for speed in speeds])
        axis.set_xticks([], minor=True)
        axis.legend(frameon=False)

    title = "Section V-B: the harder it is shaken, the smaller the covariance"
    return Section("motion", title, rows, lambda path: canvas.save(path, (6, 4), paint, title))


__all__ = ["fig5", "motion", "noise"]
