"""Joint angles of the gripper in free motion, with and without magnetometers, and what cannot be observed."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxest.filters import run
from jaxest.io.report import Row
from jaxest.reproduce import Choice, Say, Section, seed_of
from jaxest.reproduce.santaera2015 import hand, kept
from jaxest.simulate import grasp
from jaxest.systems import posture
from jaxest.viz import canvas

RUNS = 5
SECONDS, RATE_HZ, SETTLING = 30.0, 200.0, 5.0


def angles(choice: Choice, say: Say) -> Section:
    """Move the fingers and estimate all joints from the links' orientations, run by run.

    The palm stands still, as in the paper, so that its yaw shows what a missing heading means.
    """
    count = choice.runs or (1 if choice.small else RUNS)
    seconds = 8.0 if choice.small else SECONDS
    rows: list[Row] = []
    shown: dict[str, kept.Arrays] = {}
    for magnetic, name in ((True, "with magnetometers"), (False, "without, headings unknown")):
        system = posture.build(hand.robot(), grasp.SITES, magnetic=magnetic)
        params = jax.tree.map(np.float32, system.default_params)
        draw = jax.jit(lambda key, s=system, p=params: s.simulate(p, key=key, steps=int(seconds * RATE_HZ),
                                                                  rate_hz=RATE_HZ))  # fmt: skip
        errors, known = [], None
        for k in range(count):
            say(f"angles: {name}, run {k + 1} of {count}")
            seed = seed_of(choice, k)
            tag = f"motion_{'9' if magnetic else '6'}_{seconds:g}s_{seed}"
            made = kept.piece(choice.work, tag, partial(_run, draw, system, params, seed))
            errors.append(made["error"])
            known = made["known"]
            shown.setdefault(name, made)
        rows += _rows(name, errors, known)

    def paint(path: Path) -> None:
        canvas.save(
            path, (12, 5.5), lambda figure: _paint(figure, shown), "Six finger joints in free motion, first run"
        )

    return Section("angles", "joint angles of the gripper in free motion", rows, paint)


def _run(draw: Any, system: Any, params: Any, seed: int) -> kept.Arrays:
    """Errors of the six angles (T, 6), deg, once settled; the whole run, rad; what is known at the end."""
    measurements, truth = draw(jax.random.key(seed))
    _, info = run(system.step, params, system.init(params), measurements)
    found, true = (hand.finger_angles(np.asarray(q)) for q in (info.q, truth.q))
    error = np.rad2deg(found - true)[int(SETTLING * RATE_HZ) :]
    deviation = hand.finger_deviations(np.asarray(info.covariance))
    return {"error": error, "known": np.asarray(info.known[-1]), "found": found, "deviation": deviation, "true": true}


def _paint(figure: Any, shown: Mapping[str, kept.Arrays]) -> None:
    axes = figure.subplots(2, 3, sharex=True)
    for joint, axis in enumerate(axes.flat):
        for (name, made), color in zip(shown.items(), (canvas.BLUE, canvas.ORANGE), strict=True):
            time = np.arange(len(made["found"])) / RATE_HZ
            found, band = (np.rad2deg(made[part][:, joint]) for part in ("found", "deviation"))
            axis.fill_between(time, found - 1.96 * band, found + 1.96 * band, color=color, alpha=0.2, linewidth=0)
            axis.plot(time, found, color=color, linewidth=0.9, label=f"{name}, 95 %")
            axis.plot(time, np.rad2deg(made["true"][:, joint]), color=canvas.RED, linewidth=0.9, linestyle="--")
        axis.lines[-1].set_label("truth")
        canvas.plain(axis)
        axis.set_title(grasp.LEADERS[joint], fontsize=10)
    for axis in axes[:, 0]:
        axis.set_ylabel("angle [deg]")
    for axis in axes[1]:
        axis.set_xlabel("time [s]")
    canvas.legend(figure, axes[0, 0])


def _rows(name: str, errors: list[Any], known: Any) -> list[Row]:
    size = np.sqrt(np.mean(np.square(errors), axis=1))  # (runs, 6)
    rows = [Row("finger angles, RMSE", name, float(np.sqrt(np.mean(size**2))), "deg", float(size.std()), len(errors))]
    rows.append(Row("finger angles, worst joint and run", name, float(size.max()), "deg", n=len(errors)))
    for k, axis in enumerate(("roll", "pitch", "yaw")):
        rows.append(Row("share of the variance taken away", f"palm's {axis}, {name}", 100 * float(known[k]), "%"))
    return rows


__all__ = ["angles"]
