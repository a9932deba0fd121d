"""Section V-A: the number of particles and the other hyperparameters."""

from typing import Any

import numpy as np

from jaxest.io.report import Row
from jaxest.metrics import circular_error
from jaxest.reproduce import Choice, Say, Section, seed_of
from jaxest.reproduce.sato2023 import arm
from jaxest.sensors import joint_angle, link_orientation, link_position
from jaxest.systems import deflection
from jaxest.viz import canvas

WITH_IMUS, ALL = ("encoders", *arm.IMUS), ("encoders", *arm.IMUS, "end_effector")
COUNTS = (64, 128, 256, 512, 1024, 2048, 4096, 8192)
PAPER_ENOUGH = 256.0
SEEN = (1, 2)  # joints that the IMUs see
SAYS = {
    "kappa_0": "paper: little effect",
    "kappa_v = 0.5": "paper: very noisy",
    "kappa_v": "paper: may degenerate",
    "lambda": "paper: larger, joints 2, 3 sharper",
    "Sigma": "paper: smaller, joint 1 sharper",
    "kappa_w = 1": "paper: noisy",
    "kappa_w": "paper: larger, wider (ours: narrower)",
}
"""What the paper finds, without figures, where one thing is changed."""
RUNS = 4
FEW = 2  # of each of the many hyperparameters


def particles(choice: Choice, say: Say) -> Section:
    """Vary the number of particles.

    Source: Sato 2023, section V-A, item 3.
    """
    runs, seconds = (1, 6.0) if choice.small else (RUNS, arm.SECONDS)
    scenes = [arm.scene(seed_of(choice, i), seconds=seconds) for i in range(runs)]
    rows, errors, seen = [], {}, {}
    cases = [(n, deflection.bootstrap, "bootstrap") for n in (COUNTS[:2] if choice.small else COUNTS)]
    cases += [(n, deflection.guided, "guided") for n in ((64,) if choice.small else (64, 256))]
    for count, propose, name in cases:
        say(f"{count} particles, {name}")
        chosen = arm.system(count, propose)
        found = [arm.estimate(arm.using(s, WITH_IMUS), seed_of(choice, i), chosen) for i, s in enumerate(scenes)]
        away = [np.rad2deg(circular_error(r.mean, s.angles)) for s, r in zip(scenes, found, strict=True)]
        error, part = [arm.rms(e) for e in away], [arm.rms(e[:, SEEN]) for e in away]
        share = [100 * float(np.mean(r.ess)) / count for r in found]
        errors[name, count], seen[name, count] = float(np.mean(error)), float(np.mean(part))
        rows.append(Row("joints RMSE", f"N = {count}, {name}", errors[name, count], "deg", float(np.std(error)), runs))
        rows.append(Row("shoulder and elbow RMSE", f"N = {count}, {name}", seen[name, count], "deg",
                        float(np.std(part)), runs))  # fmt: skip
        rows.append(Row("effective share of particles", f"N = {count}, {name}", float(np.mean(share)), "%",
                        float(np.std(share)), runs))  # fmt: skip
    naive = np.rad2deg(circular_error(scenes[0].reference, scenes[0].angles))
    for what, found_errors, bound in (
        ("all joints", errors, arm.rms(naive)),
        ("shoulder and elbow", seen, arm.rms(naive[:, SEEN])),
    ):
        enough = [n for (name, n), e in found_errors.items() if name == "bootstrap" and e < bound]
        needed, where = (
            float(min(enough)) if enough else None,
            f"bootstrap, {what}: below the encoders' {bound:.2f} deg",
        )
        rows.append(Row("particles needed", where, needed, "1", None, None, PAPER_ENOUGH, "paper: at least"))

    def paint(figure: Any) -> None:
        axis = canvas.plain(figure.subplots(), xlabel="particles", ylabel="joints RMSE [deg]", xscale="log")
        for name, colour in (("bootstrap", canvas.BLUE), ("guided", canvas.GREEN)):
            line = [(count, e) for (other, count), e in errors.items() if other == name]
            axis.plot(*zip(*line, strict=True), marker="o", color=colour, label=name)
        axis.legend(fontsize=8, frameon=False)

    title = "Section V-A: number of particles, encoders and IMUs"
    return Section("particles", title, rows, lambda path: canvas.save(path, (7, 4), paint, title))


def variants() -> dict[str, dict[str, Any]]:
    """Return parameters that differ from Table I in one thing, by what differs."""
    made: dict[str, dict[str, Any]] = {"Table I": {}}
    made |= {f"kappa_0 = {k:g}": {"prior": k} for k in (0.01, 1.0, 9.0)}
    made |= {f"kappa_v = {k:g}": {"walk": k} for k in (0.5, 50.0, 500.0, 5e4)}
    for size in (80.0, 8000.0):
        imu = link_orientation.Params(link_orientation.axisymmetric(size))
        made[f"lambda = -{size:g}"] = {"imu2": imu, "imu3": imu}
    made |= {f"Sigma = {v:g} m^2": {"end_effector": link_position.Params(np.full(3, v))} for v in (0.1, 1e-3)}
    made |= {f"kappa_w = {k:g}": {"encoders": joint_angle.Params(concentration=k)} for k in (1.0, 150.0)}
    return made


def hyperparameters(choice: Choice, say: Say) -> Section:
    """Vary one parameter of Table I at a time, then Gaussian noise in place of von Mises; all sensors.

    Source: Sato 2023, section V-A, items 1, 2, 4 to 6, and its end.
    """
    runs, seconds = (1, 6.0) if choice.small else (FEW, arm.SECONDS)
    scenes = [arm.scene(seed_of(choice, i), seconds=seconds) for i in range(runs)]
    usual = arm.system()
    cases = [(name, usual, arm.params(**changes)) for name, changes in variants().items()]
    cases.append(("Gaussian noise", arm.system(2048, deflection.bootstrap, deflection.gaussian), arm.params()))
    if choice.small:
        cases = cases[:2]
    rows, widths = [], {}
    for name, chosen, given in cases:
        say(f"hyperparameters: {name}")
        found = [arm.estimate(arm.using(s, ALL), seed_of(choice, i), chosen, given) for i, s in enumerate(scenes)]
        error = [np.rad2deg(circular_error(r.mean, s.angles)) for s, r in zip(scenes, found, strict=True)]
        width = np.mean([np.rad2deg(r.upper - r.lower).mean(axis=0) / 2 for r in found], axis=0)
        jitter = [arm.rms(np.diff(e, axis=0)) / np.sqrt(2) for e in error]
        widths[name] = width
        for metric, values, unit in (
            ("joints RMSE", [arm.rms(e) for e in error], "deg"),
            ("noise of the estimate", jitter, "deg"),
            ("joints RMSE in the first s", [arm.rms(e[:10]) for e in error], "deg"),
            ("effective sample size", [float(np.mean(r.ess)) for r in found], "1"),
        ):
            said = SAYS.get(name, SAYS.get(name.split(" = ")[0]))
            rows.append(Row(metric, name, float(np.mean(values)), unit, float(np.std(values)), runs,
                            reference_name=said))  # fmt: skip
        rows += [Row(f"{joint}: half 95 % interval", name, float(width[j]), "deg", n=runs)
                 for j, joint in enumerate(arm.JOINTS)]  # fmt: skip

    def paint(figure: Any) -> None:
        axis = canvas.plain(figure.subplots(), ylabel="mean half 95 % interval [deg]")
        place = np.arange(len(widths))
        for j, joint in enumerate(arm.JOINTS):
            colour = (canvas.BLUE, canvas.RED, canvas.GREEN, canvas.ORANGE)[j]
            axis.bar(place + 0.2 * (j - 1.5), [w[j] for w in widths.values()], 0.2, label=joint, color=colour)
        axis.set_xticks(place, list(widths), rotation=40, ha="right", fontsize=8)
        axis.margins(y=0.12)  # room for the legend
        canvas.legend(figure, axis)

    title = "Section V-A: hyperparameters, all sensors, bootstrap filter"
    return Section("hyperparameters", title, rows, lambda path: canvas.save(path, (10, 5), paint, title))
