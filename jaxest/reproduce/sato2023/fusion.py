"""Fig. 6: what each combination of sensors knows of the joints."""

from typing import Any

import numpy as np

from jaxest.io.report import Row
from jaxest.metrics import circular_error
from jaxest.reproduce import Choice, Say, Section, seed_of
from jaxest.reproduce.sato2023 import arm
from jaxest.viz import canvas

COMBINATIONS = {
    "encoders": ("encoders",),
    "+ IMUs": ("encoders", *arm.IMUS),
    "+ EE": ("encoders", "end_effector"),
    "all": ("encoders", *arm.IMUS, "end_effector"),
    "EE now and then": ("encoders", *arm.IMUS, "end_effector"),
}
RUNS = 4
PERIOD, SEEN = 20.0, 7.0  # s: now and then is 7 s in 20


def fig6(choice: Choice, say: Say) -> Section:
    """Estimate the bent arm with each combination of sensors, by the paper's own filter.

    Source: Sato 2023, fig. 6, Table I.
    """
    runs, seconds = (1, 6.0) if choice.small else (RUNS, arm.SECONDS)
    scenes = [arm.scene(seed_of(choice, i), seconds=seconds) for i in range(runs)]
    rows, shown = [], {}
    for name, sensors in COMBINATIONS.items():
        say(f"fig. 6: {name}")
        found = []
        for i, one in enumerate(scenes):
            seen = one.time % PERIOD < SEEN if name == "EE now and then" else None
            found.append(arm.estimate(arm.using(one, sensors, seen), seed_of(choice, i)))
        shown[name] = found[0]
        rows += rows_of(name, scenes, found)
    naive = [[arm.rms(np.rad2deg(s.reference - s.angles)[:, j]) for s in scenes] for j in range(4)]
    rows += [Row(f"{joint}: RMSE", "reference alone", float(np.mean(x)), "deg", float(np.std(x)), runs)
             for joint, x in zip(arm.JOINTS, naive, strict=True)]  # fmt: skip

    def paint(figure: Any) -> None:
        axes = figure.subplots(len(arm.JOINTS), len(COMBINATIONS), sharex=True, sharey="row", squeeze=False)
        for column, (name, result) in enumerate(shown.items()):
            for joint, label in enumerate(arm.JOINTS):
                axis = canvas.plain(axes[joint, column], title="" if joint else name)
                panel(axis, scenes[0], result, joint)
                if not column:
                    axis.set_ylabel(f"{label} [deg]")
            axes[-1, column].set_xlabel("time [s]")
        canvas.legend(figure, axes[0, 0])

    title = "Fig. 6: combinations of sensors, bootstrap filter, 2048 particles"
    return Section("fig6", title, rows, lambda path: canvas.save(path, (14, 8), paint, title))


def rows_of(name: str, scenes: list[arm.Scene], found: list[arm.Result]) -> list[Row]:
    """Return error and half width of the interval for each joint, coverage and effective sample size over the runs."""
    error = [np.rad2deg(circular_error(r.mean, s.angles)) for s, r in zip(scenes, found, strict=True)]
    width = [np.rad2deg(r.upper - r.lower) / 2 for r in found]
    inside = [100 * np.mean((circular_error(s.angles, r.mean) <= r.upper - r.mean)
                            & (circular_error(s.angles, r.mean) >= r.lower - r.mean))
              for s, r in zip(scenes, found, strict=True)]  # fmt: skip
    lines = []
    for joint, label in enumerate(arm.JOINTS):
        for metric, values in (
            (f"{label}: RMSE", [arm.rms(e[:, joint]) for e in error]),
            (f"{label}: half 95 % interval", [float(w[:, joint].mean()) for w in width]),
        ):
            lines.append(_row(metric, name, values, "deg"))
    lines.append(_row("truth inside 95 % interval", name, inside, "%"))
    lines.append(_row("effective sample size", name, [float(np.mean(r.ess)) for r in found], "1"))
    return lines


def _row(metric: str, condition: str, values: Any, unit: str) -> Row:
    return Row(metric, condition, float(np.mean(values)), unit, float(np.std(values)), len(values))


def panel(axis: Any, scene: arm.Scene, result: arm.Result, joint: int) -> None:
    """Draw one joint: estimate with its 95 % band, truth and reference."""
    degrees = [np.rad2deg(x[:, joint]) for x in (result.lower, result.upper, result.mean)]
    axis.fill_between(scene.time, degrees[0], degrees[1], color=canvas.BLUE, alpha=0.2, linewidth=0, label="95 % CI")
    axis.plot(scene.time, degrees[2], color=canvas.BLUE, linewidth=0.9, label="estimate")
    axis.plot(scene.time, np.rad2deg(scene.angles[:, joint]), color=canvas.RED, linewidth=1.3, label="effective")
    axis.plot(scene.time, np.rad2deg(scene.reference[:, joint]), color=canvas.GREY, linestyle=":", label="reference")
