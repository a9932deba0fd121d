"""Whether chains may be used: R-hat, effective sample sizes, Monte Carlo errors, and a verdict in plain words.

On the host, in NumPy; draws are (C, S), chains by iterations. Source: Vehtari, Gelman, Simpson, Carpenter and Buerkner
2021 (Rank-normalization, folding, and localization).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jax.scipy.special import ndtri
from numpy.typing import ArrayLike, NDArray

R_HAT, ESS, UPDATE = 1.01, 400.0, 0.05
"""The verdict's limits: R-hat at most, bulk and tail effective sample size at least, path update rate at least."""


class Summary(NamedTuple):
    """One scalar's draws."""

    mean: float
    sd: float
    r_hat: float
    """Rank-normalised, split; the larger of the plain and the folded one."""
    bulk: float
    """Effective sample size of the bulk."""
    tail: float
    """The smaller effective sample size of the 5 % and the 95 % quantile."""
    mcse: float
    """Standard error of the mean."""


class Verdict(NamedTuple):
    """Whether the draws may be used."""

    good: bool
    reasons: tuple[str, ...]
    """Why not, one sentence each; empty if they may."""


def summary(draws: ArrayLike) -> Summary:
    """Summarise the draws of one scalar.

    Args:
        draws: (C, S), at least 4 iterations.

    Returns:
        `Summary`; R-hat is infinite where no chain moves.

    Raises:
        ValueError: another shape.
    """
    x = np.asarray(draws, float)
    if x.ndim != 2 or x.shape[1] < 4:
        raise ValueError(f"draws: has shape {x.shape}, expected (chains, iterations) with at least 4 iterations")
    halves = _split(x)
    ranked = _ranked(halves)
    folded = _ranked(np.abs(halves - np.median(halves)))
    low, high = np.quantile(x, [0.05, 0.95])
    tail = min(_ess(_split((x <= q).astype(float))) for q in (low, high))
    mean, sd = float(x.mean()), float(x.std(ddof=1))
    mcse = sd / np.sqrt(max(_ess(halves), 1e-300))
    return Summary(mean, sd, max(_r_hat(ranked), _r_hat(folded)), _ess(ranked), tail, float(mcse))


def effective(draws: ArrayLike) -> float:
    """Return the bulk effective sample size of draws (C, S)."""
    return _ess(_ranked(_split(np.asarray(draws, float))))


def verdict(
    summaries: Mapping[str, Summary],
    updates: ArrayLike | None = None,
    times: Sequence[float] | None = None,
    *,
    r_hat: float = R_HAT,
    ess: float = ESS,
    update: float = UPDATE,
) -> Verdict:
    """Say whether draws may be used.

    Args:
        summaries: by the scalar's name.
        updates: (T,) share of the iterations that changed the path at each time, or (C, T) for each chain; None where
            the sampler has no path.
        times: (T,) s, of the path; numbers from 0 if None.
        r_hat: largest that is fine.
        ess: smallest that is fine.
        update: smallest update rate that is fine.

    Returns:
        The verdict. Draws that are no numbers are said first, then a frozen path: one chain alone cannot see it in its
        draws.
    """
    lost = [name for name, one in summaries.items() if not np.isfinite([one.mean, one.sd]).all()]
    reasons = [f"draws that are not finite: of {', '.join(lost)}"] if lost else []
    if updates is not None:
        reasons += _frozen(np.atleast_2d(np.asarray(updates, float)), times, update)
    worst = max(summaries, key=lambda name: _bad(summaries[name].r_hat), default=None)
    if worst is not None and not summaries[worst].r_hat <= r_hat:
        count = sum(not one.r_hat <= r_hat for one in summaries.values())
        reasons.append(f"chains disagree: R-hat {summaries[worst].r_hat:.3g} of {worst}, over {r_hat:g} for {count} of "
                       f"{len(summaries)} parameters")  # fmt: skip
    for name, values in (
        ("bulk", [s.bulk for s in summaries.values()]),
        ("tail", [s.tail for s in summaries.values()]),
    ):
        if values and not min(values) >= ess:
            at = list(summaries)[int(np.argmin(values))]
            reasons.append(f"too few effective draws: {name} {min(values):.0f} of {at}, under {ess:g}")
    return Verdict(not reasons, tuple(reasons))


def _bad(value: float) -> float:
    return value if np.isfinite(value) else np.inf


def _frozen(updates: NDArray[np.float64], times: Sequence[float] | None, least: float) -> list[str]:
    worst = updates.min(axis=0)
    if worst.min() >= least:
        return []
    at = int(np.flatnonzero(worst < least)[-1])
    time = f"t = {times[at]:g} s" if times is not None else f"step {at}"
    where = "the path is frozen everywhere" if (worst < least).all() else f"path frozen before {time}"
    return [f"{where}: updated in {100 * worst.min():.2g} % of the iterations at worst"]


def _split(x: NDArray[np.float64]) -> NDArray[np.float64]:
    half = x.shape[1] // 2
    return np.concatenate([x[:, :half], x[:, -half:]])


def _ranked(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Replace values by normal scores of their ranks; equal values share a rank."""
    _, inverse, counts = np.unique(x, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    ranks = (ends - (counts - 1) / 2)[inverse].reshape(x.shape)
    return np.asarray(ndtri((ranks - 0.375) / (x.size + 0.25)), float)


def _r_hat(x: NDArray[np.float64]) -> float:
    size = x.shape[1]
    within = float(x.var(axis=1, ddof=1).mean())
    between = float(x.mean(axis=1).var(ddof=1))
    return float(np.sqrt((size - 1) / size + between / within)) if within > 0 else float("inf")


def _ess(x: NDArray[np.float64]) -> float:
    """Effective sample size by Geyer's initial monotone sequence over all chains."""
    count, size = x.shape
    away = x - x.mean(axis=1, keepdims=True)
    wide = np.fft.rfft(away, 2 * size, axis=1)
    covariance = np.fft.irfft(wide * wide.conj(), axis=1)[:, :size] / size
    within = float(covariance[:, 0].mean()) * size / (size - 1)
    if not within > 0:
        return 1.0 if x.std() > 0 or size == 0 else float(x.size)
    plus = within * (size - 1) / size + (float(x.mean(axis=1).var(ddof=1)) if count > 1 else 0.0)
    rho = 1 - (within - covariance.mean(axis=0)) / plus
    rho[0] = 1
    pairs = rho[: (size - 1) // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs < 0)
    last = int(negative[0]) if len(negative) else len(pairs) - 1
    # The first term of the first pair that is left out still counts once where it is positive.
    tau = -1 + 2 * float(np.minimum.accumulate(pairs[:last]).sum()) + max(float(rho[2 * last]), 0.0)
    total = count * size
    return total / max(tau, 1 / np.log10(total))


__all__ = ["ESS", "R_HAT", "UPDATE", "Summary", "Verdict", "effective", "summary", "verdict"]
