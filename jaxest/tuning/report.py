"""What a tuning is worth: standard errors, what each parameter changes, what the data cannot tell."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.tuning.descent import GRAIN
from jaxest.tuning.objectives import batched, per_recording
from jaxest.tuning.problem import Problem, goes_forward, loss_at
from jaxest.tuning.recordings import Recording
from jaxest.types import Array

STEP, STEP_DRAWN = 0.05, 0.2
"""How far from the point gradients are compared, in free numbers; the first nearer where the point is known better."""
AGAIN = 3
"""How often at most that distance is corrected."""
FLAT = 1e-4
"""Curvature, of free numbers each of which has curvature 1, below which a direction has none that differences could
tell from 0."""
LOOSE = 1.0
"""Standard error in free numbers (a factor e of a positive value) beyond which a parameter counts as unidentified."""


class Curvature(NamedTuple):
    """The objective about a point, in free numbers."""

    value: float
    gradient: NDArray[np.float64]
    """(n,) of the mean loss."""
    hessian: NDArray[np.float64]
    """(n, n) of the mean loss."""
    covariance: NDArray[np.float64]
    """(n, n) of the point; infinite for numbers without curvature and what they move, NaN where it is unknown."""
    spread: NDArray[np.float64]
    """(n, n) Monte-Carlo covariance of the mean gradient, 0 where nothing is drawn."""


class Estimate(NamedTuple):
    """One entry of a free parameter."""

    name: str
    start: float
    value: float
    sd: float
    """Standard error, infinite where unidentified, NaN where the recordings are too few to tell."""
    rise: float
    """What a change by 0.1 of the free number behind it adds to the mean loss, all other parameters as they are: by 10
    % of a positive value, of what is between a share and its end, by 0.1 of a number that may have either sign."""
    identified: bool


def curvature(
    problem: Problem, z: Array, batch: Recording, keys: Array | None = None, worth: float | None = None
) -> Curvature:
    """Return value, gradient, Hessian and the covariance that follows.

    The Hessian is the difference of gradients on both sides of the point: one compiled gradient serves, where second
    derivatives through a filter take minutes to compile. They are one standard error away, for numbers have units, but
    at most `STEP`; gradients that are drawn are `STEP_DRAWN` away, with the same keys. For a likelihood the covariance
    is the inverse of the summed Hessian; for other objectives that of an M-estimator, from how the gradients of single
    recordings differ: unknown, NaN, unless there are more recordings than free numbers, and rough unless there are
    many.

    Args:
        problem: what is tuned.
        z: (n,) the point.
        batch: recordings (B, T, ...).
        keys: (k,) keys over which an objective that is drawn is averaged.
        worth: how many recordings such as these a likelihood's data are, B if None: more where the batch is a sample of
            windows of long recordings.

    Returns:
        The curvature.

    Source: van der Vaart 1998 (Asymptotic statistics), theorem 5.21.
    """
    keys = jax.random.split(jax.random.key(0), 1) if keys is None else keys
    random = problem.objective.random
    step = np.maximum(STEP_DRAWN if random else STEP, _least(np.asarray(z)))
    found = _differences(problem, z, batch, keys, worth, step)
    for _ in range(0 if random else AGAIN):
        nearer = _nearer(found, np.asarray(z), step)
        if (np.abs(np.log(nearer / step)) < np.log(2)).all():
            break
        step = nearer
        found = _differences(problem, z, batch, keys, worth, step)
    reach = _reach(np.asarray(z))
    rounding = 2 * GRAIN * np.finfo(z.dtype).eps * abs(found.value) / reach**2
    return found._replace(covariance=_sandwich(found.hessian, found.covariance, rounding, reach / STEP))


def _differences(
    problem: Problem, z: Array, batch: Recording, keys: Array, worth: float | None, step: NDArray[np.float64]
) -> Curvature:
    """The curvature from gradients `step` (n,) away; in place of the point's covariance that of the gradient."""
    size, count = z.shape[0], jnp.shape(batch.counts)[0]
    shift = jnp.diag(jnp.asarray(step, z.dtype))
    points = jnp.concatenate([z[None], z[None] + shift, z[None] - shift])
    drawn = [[np.asarray(x, np.float64) for x in _gradients(problem, points, batch, key)] for key in keys]
    values, gradients = (np.asarray(np.mean([d[i] for d in drawn], axis=0)) for i in range(2))
    apart = np.diag(np.asarray(points[1 : size + 1] - points[size + 1 :], np.float64))  # as rounding leaves it
    hessian = (gradients[1 : size + 1] - gradients[size + 1 :]).mean(axis=1) / apart[:, None]
    hessian = (hessian + hessian.T) / 2
    means = np.array([d[1][0].mean(axis=0) for d in drawn])
    spread = np.zeros_like(hessian)
    if len(keys) > 1:
        spread = np.cov(means, rowvar=False).reshape(hessian.shape) / len(keys)
    middle, own = hessian / (count if worth is None else worth), gradients[0]
    if not problem.objective.likelihood:
        centred = own - own.mean(axis=0)
        # Gradients that differ in fewer directions than there are would make errors of 0.
        middle = centred.T @ centred / (count * (count - 1)) if count > size else np.full_like(hessian, np.nan)
    return Curvature(float(values[0].mean()), own.mean(axis=0), hessian, middle + spread, spread)


def _nearer(found: Curvature, z: NDArray[Any], step: NDArray[np.float64]) -> NDArray[np.float64]:
    """Steps (n,) of one standard error of each number were it alone free, where it is known; a tenth into the dark."""
    curved, varied = (np.abs(np.diag(x)) for x in (found.hessian, found.covariance))
    alone = np.sqrt(varied) / np.where(curved > 0, curved, np.inf)
    alone = np.where(np.isfinite(alone) & (alone > 0), alone, STEP)
    least = _least(z)
    return np.where(np.isfinite(curved), np.clip(alone, least, np.maximum(STEP, least)), step / 10)


def _least(z: NDArray[Any]) -> NDArray[np.float64]:
    """The shortest steps (n,) from a point (n,) that its digits allow."""
    return np.sqrt(np.finfo(z.dtype).eps) * _reach(z)


def _reach(z: NDArray[Any]) -> NDArray[np.float64]:
    """How far (n,) numbers like those of a point (n,) go: a curvature that does not show there is rounding's."""
    return STEP * np.maximum(1.0, np.abs(z)).astype(np.float64)


@partial(jax.jit, static_argnums=0)
def _gradients(problem: Problem, points: Array, batch: Recording, key: Array) -> tuple[Array, Array]:
    """Losses (points, B) and gradients (points, B, n)."""

    def one(z: Array, recording: Recording, key: Array | None) -> tuple[Array, Array]:
        loss = partial(loss_at, problem)
        if not goes_forward(problem):
            return jax.value_and_grad(loss)(z, recording, key)
        push = jax.vmap(lambda v: jax.jvp(lambda z: loss(z, recording, key), (z,), (v,)), out_axes=(None, 0))
        return push(jnp.eye(z.shape[0], dtype=z.dtype))

    every = batched(problem.objective)
    return every(lambda z: per_recording(problem.objective, partial(one, z), batch, key))(points)


def _sandwich(hessian: NDArray[Any], middle: NDArray[Any], rounding: NDArray[Any], reach: NDArray[Any]) -> NDArray[Any]:
    """Inverse Hessian on both sides, of the numbers that are left when those are taken out that have no curvature.

    Free numbers have units of their own: each counts in the one in which its curvature is 1 or -1, or in which rounding
    would be, (n,), where it has none that rounding could not make. One that is taken out may be anywhere within its
    `reach` (n,): what that moves by more than their own standard error is unknown with it, and what it moves by less
    is less sure.
    """
    if not np.isfinite(hessian).all():
        return np.full_like(hessian, np.nan)
    curved = np.diag(hessian)
    seen = curved > rounding
    size = np.maximum(np.abs(curved), rounding)
    unit = np.sqrt(np.where(size > 0, size, 1.0))
    scaled = hessian / np.outer(unit, unit)
    scaled[~seen, ~seen] = np.minimum(scaled[~seen, ~seen], 0.0)
    rest = np.arange(len(unit))
    while len(rest):
        values, vectors = np.linalg.eigh(scaled[np.ix_(rest, rest)])
        if values[0] > FLAT:
            break
        rest = np.delete(rest, np.argmax(vectors[:, 0] ** 2))
    out = np.setdiff1d(np.arange(len(unit)), rest)
    found = np.zeros_like(hessian)
    found[out, out] = np.inf
    if not len(rest):
        return found
    inverse = (vectors / values) @ vectors.T / np.outer(unit[rest], unit[rest])
    known = inverse @ middle[np.ix_(rest, rest)] @ inverse
    shift = (inverse @ hessian[np.ix_(rest, out)]) * reach[out]
    moved, own = (shift**2).sum(axis=1), np.diag(known)
    found[np.ix_(rest, rest)] = known + shift @ shift.T
    unknown = rest[moved > np.where(np.isnan(own), (1e-3 * reach[rest]) ** 2, own)]
    found[unknown, :] = found[:, unknown] = 0.0
    found[unknown, unknown] = np.inf
    return found


def estimates(problem: Problem, z: Array, found: Curvature) -> list[Estimate]:
    """Return a row for every entry of every free parameter.

    Args:
        problem: what is tuned.
        z: (n,) the point.
        found: the curvature there.

    Returns:
        The rows; standard errors by the chart's derivative.
    """
    values = np.asarray(problem.space.values(z), np.float64)
    start = np.asarray(problem.space.values(problem.space.pack(problem.space.base, z.dtype)), np.float64)
    slope = np.asarray(jax.jacfwd(problem.space.values)(z), np.float64)
    variance = np.diag(found.covariance)
    inside = np.where(np.isfinite(found.covariance), found.covariance, 0.0)
    rows = []
    for i, name in enumerate(problem.space.names):
        moving = np.flatnonzero(slope[i])
        sure = bool(np.isfinite(variance[moving]).all())
        sd = float(np.sqrt(max(slope[i] @ inside @ slope[i], 0.0)))
        if not sure:
            sd = np.inf if np.isinf(variance[moving]).any() else np.nan
        tight = sure and bool((np.sqrt(np.diag(inside)[moving]) < LOOSE).all())
        norm = float(np.sqrt(slope[i] @ slope[i]))
        moved = slope[i] * (0.1 / norm) if norm > 0 else 0 * slope[i]
        rise = float(found.gradient @ moved + moved @ found.hessian @ moved / 2)
        rows.append(Estimate(name, float(start[i]), float(values[i]), sd, rise, tight))
    return rows


__all__ = ["Curvature", "Estimate", "curvature", "estimates"]
