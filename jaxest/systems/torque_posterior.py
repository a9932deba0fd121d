"""Draws of one sampler on one series, by name and summarised: what commands, figures and benchmarks share."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.filters.run import full
from jaxest.mcmc import chains as many
from jaxest.mcmc.chains import Chains
from jaxest.mcmc.diagnostics import Summary, Verdict, effective, summary, verdict
from jaxest.mcmc.kernel import Kernel, Params
from jaxest.mcmc.model import Data, Model, Prior
from jaxest.parallel import several

IDENTIFIED = 0.85  # of the prior's standard deviation of a log variance: above it the data say next to nothing


class Posterior(NamedTuple):
    """Draws after burn-in, C chains by S iterations, and what became of them."""

    theta: NDArray[np.float64]
    """(C, S, p)"""
    variances: NDArray[np.float64]
    """(C, S, n + m)"""
    updates: NDArray[np.float64]
    """(C, T) share of the iterations that changed the path."""
    path_ess: NDArray[np.float64]
    """(T,) effective sample size of the path's probe at each time."""
    particles: NDArray[np.float64]
    """(T,) mean effective sample size of the particles."""
    accepted: float
    """Share of the proposals that were accepted."""
    summaries: dict[str, Summary]
    """Of theta and of the variances' logarithms, by name."""
    verdict: Verdict


def names(model: Model, labels: tuple[str, ...] = ()) -> tuple[list[str], list[str]]:
    """Name torques and variances as the paper does: tau1 ..., s1_1 ... (q), s2_1 ... (v), the sensors' last.

    Args:
        model: the model.
        labels: of the joints; 1, 2, ... if empty.

    Returns:
        p and n + m names.
    """
    m = len(model.observed)
    label = labels or tuple(str(i + 1) for i in range(m))
    pieces = model.linear // m
    theta = [f"tau{label[j]}" + (f"[{k}]" if pieces > 1 else "") for k in range(pieces) for j in range(m)]
    blocks = model.size // m + 1
    return theta, [f"s{k + 1}_{label[j]}" for k in range(blocks) for j in range(m)]


def advance(
    kernel: Kernel, params: Params, data: Data, history: Any = full, *, spread: bool = True
) -> Callable[[Chains, int], tuple[Chains, Any]]:
    """Return what `io.chains.sample` calls.

    Args:
        kernel: the sampler.
        params: parameters.
        data: the series.
        history: as in `mcmc.chains.advance`.
        spread: whether each device takes a share of the chains where there are several; all are one program otherwise.

    Returns:
        `(chains, iterations) -> (chains, history)`.
    """
    over = several() if spread else None

    def go(chains: Chains, iterations: int) -> tuple[Chains, Any]:
        found: tuple[Chains, Any] = many.advance(kernel, params, data, chains, iterations, history, over)
        return found

    return go


def collect(
    model: Model, history: Any, burn_in: float = 0.25, *, thin: int = 1, has_path: bool = True,
    labels: tuple[str, ...] = (),
) -> Posterior:  # fmt: skip
    """Bring a history into the form of `Posterior`, with its verdict.

    Args:
        model: the model.
        history: the infos of `mcmc.chains.advance`, leaves (iterations, C, ...).
        burn_in: share of the iterations that is thrown away; the paper's is a quarter.
        thin: every how many iterations a draw is kept.
        has_path: whether the sampler moves a path.
        labels: of the joints.

    Returns:
        Draws and verdict.
    """
    first = int(burn_in * len(history.accepted))
    kept = [np.swapaxes(np.asarray(x)[first::thin], 0, 1) for x in (history.unknown.theta, history.unknown.variances)]
    updates = np.asarray(history.updated)[first:].mean(axis=0)
    probe = np.swapaxes(np.asarray(history.probe)[first::thin], 0, 1)
    path_ess = np.array([effective(probe[:, :, t]) for t in range(probe.shape[2])])
    called = names(model, labels)
    columns = [(name, kept[0][:, :, i]) for i, name in enumerate(called[0])]
    columns += [(name, np.log(kept[1][:, :, i])) for i, name in enumerate(called[1])]
    summaries = {name: summary(x) for name, x in columns}
    particles = np.asarray(history.ess)[first:].mean(axis=(0, 1))
    accepted = float(np.asarray(history.accepted)[first:].mean())
    return Posterior(kept[0], kept[1], updates, path_ess, particles, accepted, summaries,
                     verdict(summaries, updates if has_path else None))  # fmt: skip


def unidentified(prior: Prior, posterior: Posterior) -> list[bool]:
    """Say of each variance whether its posterior is about its prior: the data do not identify it."""
    from scipy.special import polygamma  # on the host: JAX's own would follow its precision switch

    known = np.sqrt(polygamma(1, np.asarray(prior.alpha)))  # standard deviation of the log of an inverse-gamma
    sd = np.log(posterior.variances).reshape(-1, len(known)).std(axis=0)
    return [bool(s > IDENTIFIED * k) for s, k in zip(sd, known, strict=True)]


__all__ = ["IDENTIFIED", "Posterior", "advance", "collect", "names", "unidentified"]
