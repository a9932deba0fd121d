"""Figs. 8 and 9: the end effector by naive forward kinematics, by direct fusion, and by the filter."""

from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from jaxest.io.report import Row
from jaxest.metrics import circular_error
from jaxest.reproduce import Choice, Say, Section
from jaxest.reproduce.sato2023 import arm
from jaxest.systems import deflection, direct_fusion
from jaxest.viz import canvas

WITH_IMUS = ("encoders", *arm.IMUS)
BETTER = "paper: better with IMUs"
LOCKED = {"direct, xyz": "paper: fails", "direct, yxz": "paper: as the filter"}
HINGES = (direct_fusion.Hinge(1, 0), direct_fusion.Hinge(2, 1, 0))
PHASES = {"upright": (0.0, 5.0), "lying": (20.0, arm.DESK[0]), "on the desk": arm.DESK, "whole run": (0.0, 1e9)}


def fig8(choice: Choice, say: Say) -> Section:
    """Follow the end effector while the arm lies down and hits a desk.

    Source: Sato 2023, fig. 8, section IV-C; the guided filter is ours.
    """
    scene = arm.scene(choice.seed, collision=True, seconds=6.0 if choice.small else arm.SECONDS)
    found = {
        "naive FK": np.asarray(scene.measurements.encoders.value, float),
        "encoders alone": arm.estimate(arm.using(scene, ("encoders",)), choice.seed).mean,
        "with IMUs": arm.estimate(arm.using(scene, WITH_IMUS), choice.seed).mean,
        "with IMUs, guided, N = 256": _guided(scene, choice).mean,
    }
    truth = arm.ends(scene.angles)
    gaps = {name: arm.gap(arm.ends(q), truth) for name, q in found.items()}
    rows = [_gain(gaps, scene, phase) for phase in PHASES if _inside(scene, phase).any()]
    for name, (distance, angle) in gaps.items():
        for phase in PHASES:
            inside = _inside(scene, phase)
            if inside.any():
                n = int(inside.sum())
                rows.append(Row("EE position RMSE", f"{name}, {phase}", 1e3 * arm.rms(distance[inside]), "mm", n=n))
                rows.append(
                    Row(
                        "EE orientation RMSE", f"{name}, {phase}", float(np.rad2deg(arm.rms(angle[inside]))), "deg", n=n
                    )
                )

    def paint(figure: Any) -> None:
        axes = figure.subplots(2, 1, sharex=True)
        colours = (canvas.GREY, canvas.ORANGE, canvas.BLUE, canvas.GREEN)
        for (name, (distance, angle)), colour in zip(gaps.items(), colours, strict=True):
            axes[0].plot(scene.time, 1e3 * distance, color=colour, linewidth=1, label=name)
            axes[1].plot(scene.time, np.rad2deg(angle), color=colour, linewidth=1)
        for axis, label in zip(axes, ("position error [mm]", "orientation error [deg]"), strict=True):
            canvas.plain(axis, ylabel=label).axvspan(*arm.DESK, color=canvas.RED, alpha=0.1, linewidth=0)
        later = scene.time > 1  # the first second, when nothing is known yet, would flatten the rest
        worst = np.max([[1e3 * d[later].max(), np.rad2deg(a[later].max())] for d, a in gaps.values()], axis=0)
        for axis, top in zip(axes, worst, strict=True):
            axis.set(xlim=(0, scene.time[-1]), ylim=(0, 1.1 * top))
        canvas.legend(figure, axes[0])
        axes[1].set_xlabel("time [s]; shaded: against the desk")

    title = "Fig. 8: error of the end effector, through a collision with a desk"
    return Section("fig8", title, rows, lambda path: canvas.save(path, (9, 6), paint, title))


def _inside(scene: arm.Scene, phase: str) -> NDArray[np.bool_]:
    start, end = PHASES[phase]
    found: NDArray[np.bool_] = (scene.time >= start) & (scene.time < end)
    return found


def _gain(gaps: dict[str, Any], scene: arm.Scene, phase: str) -> Row:
    """How many times the error of encoders alone is that with IMUs: the paper's finding, without a figure."""
    alone, both = (arm.rms(gaps[name][0][_inside(scene, phase)]) for name in ("encoders alone", "with IMUs"))
    return Row("EE position, encoders alone / with IMUs", phase, alone / both, "1", reference_name=BETTER)


def fig9(choice: Choice, say: Say) -> Section:
    """Fuse IMUs by hand with both Euler orders, beside the filter.

    Source: Sato 2023, fig. 9, section IV-D.
    """
    scene = arm.scene(choice.seed, seconds=6.0 if choice.small else arm.SECONDS)
    found = {
        "naive FK": np.asarray(scene.measurements.encoders.value, float),
        "direct, xyz": direct(scene, direct_fusion.heading_of_x),
        "direct, yxz": direct(scene, direct_fusion.heading_of_y),
        "filter": arm.estimate(arm.using(scene, WITH_IMUS), choice.seed).mean,
        "filter, guided, N = 256": _guided(scene, choice).mean,
    }
    truth = arm.ends(scene.angles).position[:, 2]
    heights = {name: arm.ends(q).position[:, 2] for name, q in found.items()}
    rows = []
    for name, q in found.items():
        error = heights[name] - truth
        pitch = np.rad2deg(circular_error(q, scene.angles)[:, 1:3])
        rows.append(Row("EE height RMSE", name, 1e3 * arm.rms(error), "mm", n=len(error)))
        rows.append(Row("EE height, worst", name, 1e3 * float(np.abs(error).max()), "mm", n=len(error),
                        reference_name=LOCKED.get(name)))  # fmt: skip
        rows.append(Row("shoulder and elbow RMSE", name, arm.rms(pitch), "deg", n=pitch.size))

    def paint(figure: Any) -> None:
        axes = figure.subplots(2, 1, sharex=True)
        canvas.plain(axes[0], ylabel="EE height [m]")
        colours = (canvas.GREY, canvas.RED, canvas.ORANGE, canvas.BLUE, canvas.GREEN)
        for (name, height), colour in zip(heights.items(), colours, strict=True):
            axes[0].plot(scene.time, height, color=colour, linewidth=1, label=name)
        axes[0].plot(scene.time, truth, color="black", linewidth=0.7, linestyle="--", label="truth")
        axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), fontsize=8, frameon=False, ncols=6)
        canvas.plain(axes[1], ylabel="reference [deg]", xlabel="time [s]")
        for joint, label in enumerate(arm.JOINTS):
            axes[1].plot(scene.time, np.rad2deg(scene.reference[:, joint]), label=label)
        axes[1].legend(fontsize=8, frameon=False, ncols=4)

    title = "Fig. 9: direct fusion; 'xyz' locks where a link tilts by 90 deg"
    return Section("fig9", title, rows, lambda path: canvas.save(path, (9, 6), paint, title))


def direct(scene: arm.Scene, heading: direct_fusion.Heading) -> NDArray[np.float64]:
    """Return the angles (T, 4) rad of direct fusion."""
    imus = np.stack([getattr(scene.measurements, name).value for name in arm.IMUS], axis=1)
    fused = jax.jit(jax.vmap(lambda u, q: direct_fusion.fuse(u, q, HINGES, heading)))
    return np.asarray(fused(scene.measurements.encoders.value, imus), float)


def _guided(scene: arm.Scene, choice: Choice) -> arm.Result:
    return arm.estimate(arm.using(scene, WITH_IMUS), choice.seed, arm.system(256, deflection.guided))
