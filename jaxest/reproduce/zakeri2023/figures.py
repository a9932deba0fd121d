"""Table 1, and Figs. 1 and 2: posteriors of the torques by particle Gibbs, particle MH, and the collapsed sampler."""

from typing import Any

import numpy as np

from jaxest.io.report import Row
from jaxest.reproduce import Choice, Say, Section
from jaxest.reproduce.zakeri2023 import runs
from jaxest.systems import torque_model, torque_posterior
from jaxest.systems.torque_settings import TORQUE, VARIANCE
from jaxest.viz import canvas


def table1(choice: Choice, say: Say) -> Section:
    """Estimate every parameter by particle Gibbs with guided particles, beside the paper's estimates.

    Source: Zakeri 2023, table 1.
    """
    found = runs.chosen("gibbs", choice, say)
    rows = tau_rows(found, runs.PAPER_TAU["gibbs"], "the paper's particle Gibbs")
    names = torque_posterior.names(torque_model.constant(7))[1]
    loose = torque_posterior.unidentified(found.scene.prior, found.posterior)
    flat = found.posterior.variances.reshape(-1, len(names))
    for i, name in enumerate(names):
        condition = "not identified: the posterior is the prior" if loose[i] else ""
        rows.append(Row(f"{name} over truth", condition, float(flat[:, i].mean() / VARIANCE), "1",
                        float(flat[:, i].std() / VARIANCE), len(flat), runs.PAPER_VARIANCES[i] / VARIANCE,
                        "the paper's particle Gibbs"))  # fmt: skip
    title = f"Table 1: particle Gibbs, {_sizes(found)}"
    errors = [row._replace(spread=None) for row in rows if row.metric.endswith(": error")]
    whole = [*rows, *health(found, "guided, N = 16")]
    return Section("table1", title, whole, lambda path: canvas.bars(path, errors, title))


def fig1(choice: Choice, say: Say) -> Section:
    """Draw the torques' posteriors by particle Gibbs.

    Source: Zakeri 2023, fig. 1.
    """
    return _histograms("fig1", "Fig. 1: particle Gibbs", "gibbs", runs.PAPER_TAU["gibbs"], choice, say)


def fig2(choice: Choice, say: Say) -> Section:
    """Draw the torques' posteriors by particle Metropolis-Hastings.

    Source: Zakeri 2023, fig. 2.
    """
    return _histograms("fig2", "Fig. 2: particle Metropolis-Hastings", "mh", runs.PAPER_TAU["mh"], choice, say)


def collapsed(choice: Choice, say: Say) -> Section:
    """Draw the torques' posteriors by the collapsed sampler, which the paper has not."""
    return _histograms("collapsed", "The collapsed sampler", "collapsed", (), choice, say)


def _histograms(name: str, title: str, sampler: str, paper: Any, choice: Choice, say: Say) -> Section:
    found = runs.chosen(sampler, choice, say)
    rows = [*tau_rows(found, paper, "the paper's mean"), *health(found, sampler)]
    flat = found.posterior.theta.reshape(-1, 7)

    def paint(figure: Any) -> None:
        axes = figure.subplots(2, 4)
        for j, axis in enumerate(axes.flat[:7]):
            canvas.plain(axis, xlabel=f"tau{j + 1} [N m]", title=f"mean {flat[:, j].mean():.5g}")
            axis.hist(flat[:, j], bins=40, color=canvas.BLUE, alpha=0.75, label="posterior")
            axis.axvline(TORQUE[j], color=canvas.RED, linewidth=1.4, label="truth")
            low, high = flat[:, j].min(), flat[:, j].max()
            away = 2 * (high - low)
            if j < len(paper) and low - away < paper[j] < high + away:
                axis.axvline(paper[j], color=canvas.ORANGE, linestyle="--", linewidth=1.4, label="the paper's mean")
            elif j < len(paper):
                axis.text(0.98, 0.95, f"the paper: {paper[j]:.4g}\n(off the picture)", transform=axis.transAxes,
                          ha="right", va="top", fontsize=8, color=canvas.ORANGE)  # fmt: skip
            axis.tick_params(labelsize=7)
            axis.locator_params(axis="x", nbins=4)
        axes.flat[0].legend(fontsize=7, frameon=False, loc="upper left")
        last = canvas.plain(axes.flat[7], xlabel="time step", title="path updated, share of iterations")
        last.plot(found.posterior.updates.mean(axis=0), color=canvas.GREEN)
        last.set_ylim(0, 1.05)

    whole = f"{title}, {_sizes(found)}"
    return Section(name, whole, rows, lambda path: canvas.save(path, (14, 6.5), paint, whole))


def _sizes(found: runs.Result) -> str:
    return f"{found.chains} chains of {found.iterations} iterations"


def tau_rows(found: runs.Result, paper: Any, reference: str) -> list[Row]:
    """Return each torque's mean and its error in percent, beside the paper's."""
    flat = found.posterior.theta.reshape(-1, 7)
    rows = []
    for j, true in enumerate(TORQUE):
        theirs = float(paper[j]) if j < len(paper) else None
        mean, sd = float(flat[:, j].mean()), float(flat[:, j].std())
        called = reference if theirs is not None else None
        rows.append(Row(f"tau{j + 1}", f"truth {true:g}", mean, "N m", sd, len(flat), theirs, called))
        off = None if theirs is None else 100 * abs(theirs / true - 1)
        rows.append(Row(f"tau{j + 1}: error", "in posterior sd: " + f"{(mean - true) / sd:+.2f}",
                        100 * abs(mean / true - 1), "%", 100 * sd / true, None, off, called))  # fmt: skip
    six = 100 * np.abs(flat.mean(axis=0) / TORQUE - 1)
    count = len(paper) or 7
    off = float(np.mean(100 * np.abs(np.asarray(paper) / TORQUE[:count] - 1))) if len(paper) else None
    rows.append(Row("mean torque error", f"first {count} joints", float(six[:count].mean()), "%", None, count, off,
                    reference if len(paper) else None))  # fmt: skip
    return rows


def health(found: runs.Result, condition: str) -> list[Row]:
    """Return what says whether the draws may be used."""
    one = found.posterior
    every = one.summaries.values()
    verdict = "may be used" if one.verdict.good else "do not use: " + "; ".join(one.verdict.reasons)
    return [
        Row("R-hat, largest", condition, max(s.r_hat for s in every), "1"),
        Row("bulk effective draws, least", condition, min(s.bulk for s in every), "1"),
        Row("tail effective draws, least", condition, min(s.tail for s in every), "1"),
        Row("path update rate, least over time", condition, float(one.updates.mean(axis=0).min()), "1"),
        Row("path effective draws, least over time", condition, float(one.path_ess.min()), "1"),
        Row("particles' effective size, least over time", condition, float(one.particles.min()), "1"),
        Row("acceptance", condition, one.accepted, "1"),
        Row("run time", condition, found.seconds, "s"),
        Row("verdict", verdict, float(one.verdict.good), "1"),
    ]
