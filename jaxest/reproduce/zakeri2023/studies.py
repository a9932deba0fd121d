"""What the samplers really do: the paper's own, far starts, numbers of particles, accuracy over many data sets."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.io.report import Row
from jaxest.mcmc import particle_mh
from jaxest.mcmc.model import Unknown
from jaxest.reproduce import Choice, Say, Section, seed_of
from jaxest.reproduce.zakeri2023 import runs
from jaxest.reproduce.zakeri2023.figures import health, tau_rows
from jaxest.systems import torque_model, torque_settings
from jaxest.systems.torque_settings import TORQUE
from jaxest.viz import canvas

BASELINES = {"gibbs_bootstrap": 1000, "gibbs_adapted": 1000, "gibbs_adapted_ancestors": 1000, "mh_bootstrap": 1000}
ITERATIONS = 100  # of a baseline: enough to see that nothing moves, and each costs a hundred guided ones
PARTICLES = (4, 8, 16, 64)
STARTS = 5
DATA_SETS = 20
PLACES = 20  # draws at which the log-likelihood is estimated again and again


def baselines(choice: Choice, say: Say) -> Section:
    """Run the paper's samplers and what lies between them and the guided ones, and let the verdict judge them."""
    rows: list[Row] = []
    for name, count in BASELINES.items():
        found = runs.chosen(name, choice, say, count=16 if choice.small else count, iterations=ITERATIONS)
        rows += health(found, f"{name}, N = {count}")
        rows += [row._replace(condition=name) for row in tau_rows(found, (), "") if row.metric == "mean torque error"]
    title = f"The paper's samplers, 4 chains of {ITERATIONS} iterations"
    moved = [row for row in rows if row.metric.startswith("path update rate")]
    return Section("baselines", title, rows, lambda path: canvas.bars(path, moved, title))


def starts(choice: Choice, say: Say) -> Section:
    """Start particle Metropolis-Hastings at five far places; the paper found it insensitive.

    Source: Zakeri 2023, section 7.
    """
    found = runs.chosen("mh", choice, say, chains=STARTS, iterations=1000, spread=3.0)
    theta = found.posterior.theta
    whole = theta.reshape(-1, 7)
    rows = []
    for j in range(7):
        away = (theta[:, :, j].mean(axis=1) - whole[:, j].mean()) / whole[:, j].std()
        rows.append(
            Row(f"tau{j + 1}: farthest chain's mean", "in posterior sd", float(np.abs(away).max()), "1", n=STARTS)
        )
    title = f"Particle Metropolis-Hastings from {STARTS} far starts"
    checked = [*rows, *health(found, f"mh, {STARTS} far starts")]
    return Section("starts", title, checked, lambda path: canvas.bars(path, rows, f"{title}, in posterior sd"))


def particles(choice: Choice, say: Say) -> Section:
    """Vary the number of particles.

    Source: Zakeri 2023, section 7.
    """
    rows: list[Row] = []
    shown: dict[int, Any] = {}
    for count in PARTICLES:
        found = runs.chosen("gibbs", choice, say, count=count, iterations=500)
        shown[count] = found.posterior
        rows += [
            row for row in health(found, f"guided, N = {count}") if row.metric not in ("R-hat, largest", "verdict")
        ]
        rows += _scatter(found, count, choice)

    def paint(figure: Any) -> None:
        axis = canvas.plain(figure.subplots(), xlabel="time step", ylabel="path updated, share of iterations")
        for color, (count, one) in zip(
            (canvas.ORANGE, canvas.RED, canvas.BLUE, canvas.GREEN), shown.items(), strict=True
        ):
            axis.plot(one.updates.mean(axis=0), color=color, label=f"N = {count}")
        axis.set_ylim(0, 1.05)
        axis.legend(frameon=False)

    title = "Guided particle Gibbs by number of particles"
    return Section("particles", title, rows, lambda path: canvas.save(path, (8, 4), paint, title))


def _scatter(found: runs.Result, count: int, choice: Choice) -> list[Row]:
    """Estimate the log-likelihood again and again at some draws of a run."""
    setting = choice.setting or runs.DEFAULT
    params = runs.tuned(setting, choice.seed, choice.small)
    draws = [x.reshape(-1, x.shape[-1]) for x in (found.posterior.theta, found.posterior.variances)]
    pick = np.linspace(0, len(draws[0]) - 1, 2 if choice.small else PLACES).astype(int)
    with jax.enable_x64(True):
        places = Unknown(*(jnp.asarray(x[pick]) for x in draws))
        logs = particle_mh.log_likelihoods(
            torque_model.constant(7), params, found.scene.data, places, key=jax.random.key(choice.seed), count=count
        )
    sd = np.asarray(logs).std(axis=1, ddof=1)
    condition = f"guided, N = {count}"
    return [
        Row("sd of the log-likelihood estimate", condition, float(np.sqrt(np.mean(sd**2))), "1", float(sd.std()),
            logs.size),
        Row("sd of the log-likelihood estimate, worst draw", condition, float(sd.max()), "1", n=logs.shape[1]),
    ]  # fmt: skip


def accuracy(choice: Choice, say: Say) -> Section:
    """Estimate many data sets: errors, z-scores and coverage, by particle Gibbs and by particle Metropolis-Hastings."""
    count = choice.runs or (2 if choice.small else DATA_SETS)
    setting = choice.setting or runs.DEFAULT
    torque_settings.named(setting)
    rows: list[Row] = []
    for sampler, paper in (("gibbs", 0.14), ("mh", 12.0)):
        error, z, covered, spread = [], [], [], []
        for i in range(count):
            say(f"{sampler}: data set {i + 1} of {count}")
            found = runs.run(
                sampler, setting, seed_of(choice, 100 + i), small=choice.small, work=choice.work, iterations=600
            )
            flat = found.posterior.theta.reshape(-1, 7)
            mean, sd = flat.mean(axis=0), flat.std(axis=0)
            low, high = np.quantile(flat, [0.025, 0.975], axis=0)
            error.append(100 * np.abs(mean / TORQUE - 1))
            z.append((mean - TORQUE) / sd)
            covered.append((low <= TORQUE) & (high >= TORQUE))
            spread.append(100 * sd / TORQUE)
        rows += _accuracy_rows(sampler, paper, np.array(error), np.array(z), np.array(covered), np.array(spread))
    title = f"{count} data sets, {setting}"
    errors = [row for row in rows if row.metric == "mean torque error"]
    return Section("accuracy", title, rows, lambda path: canvas.bars(path, errors, title))


def _accuracy_rows(
    sampler: str, paper: float, error: np.ndarray, z: np.ndarray, covered: np.ndarray, spread: np.ndarray
) -> list[Row]:
    """A normal posterior that is right makes a mean absolute error of sd sqrt(2 / pi)."""
    sets = len(error)
    allowed = float(spread.mean() * np.sqrt(2 / np.pi))
    share = float(covered.mean())
    return [
        Row("mean torque error", sampler, float(error.mean()), "%", float(error.mean(axis=1).std() / np.sqrt(sets)),
            sets, paper, "the paper's single run"),
        Row("mean torque error over what the posterior allows", sampler, float(error.mean()) / allowed, "1", n=sets),
        Row("rms z-score", sampler, float(np.sqrt(np.mean(z**2))), "1", float(1 / np.sqrt(2 * z.size)), z.size),
        Row("truth inside 95 % interval", sampler, 100 * share, "%",
            float(100 * np.sqrt(share * (1 - share) / covered.size)), covered.size),
    ]  # fmt: skip
