"""The error-state update: extended with one linearisation, iterated (Gauss-Newton) with more."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters.kalman.factors import (
    Factor,
    Rows,
    evaluate,
    inside_gate,
    joined,
    reanchor,
    validity,
    whiten,
)
from jaxest.filters.kalman.gain import Gain, Gained, by_size
from jaxest.filters.kalman.gaussian import Gaussian, product, sandwich, symmetric
from jaxest.manifolds.base import Manifold, as_array
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike


class UpdateInfo(NamedTuple):
    """How an update went."""

    log_likelihood: Array
    """() log-density of the rows used, given the past: the evidence increment of the (last) linearised model."""
    nis: Array
    """() normalised innovation squared; chi-square with `dof` degrees of freedom if all is as modelled."""
    dof: Array
    """() int32, rows used."""
    innovation: Array
    """(m,) residual at the prediction, in the measurement's unit; 0 where masked."""
    used: Array
    """(m,) bool, rows that existed, were finite and passed their gate."""
    information: Array
    """(n, n) H' R^-1 H of the rows used, in the tangent space at the new mean: its small eigenvalues are what the
    measurement does not see."""
    iterations: Array
    """() int32, linearisations."""
    status: Array
    """() int32, `OK`, `NON_FINITE` or `NOT_CONVERGED`."""


def update(
    manifold: Manifold,
    belief: Gaussian,
    factors: Factor | Sequence[Factor],
    *,
    iterations: int = 1,
    tolerance: ArrayLike | None = None,
    gain: Gain = by_size,
) -> tuple[Gaussian, UpdateInfo]:
    """Bring measurements into a belief.

    With more than one iteration the mean is the most probable state (Gauss-Newton, robust losses reweighted each
    time), and its derivative is that of the converged iteration, whatever way led there. The gate judges once, at the
    prediction. Covariances live in the tangent space at their own mean: the new one is carried there.

    Args:
        manifold: where the belief lives, dimension n.
        belief: mean and covariance (n, n); the covariance may be singular.
        factors: one `Factor`, or several that are independent given the state.
        iterations: linearisations at most; static, 1 is the extended Kalman filter.
        tolerance: () longest last step that counts as converged, in standard deviations of the
            posterior; the cube root of the dtype's eps (6e-6, 5e-3) if None.
        gain: `measurement_gain`, `state_gain`, or `by_size`, which takes the smaller.

    Returns:
        The new belief and how it came about. Without a valid row the belief is the old one.

    Raises:
        ValueError: `iterations` below 1, or a shape that does not fit.

    Source: Iwao 2025, eqs. 21-30, with the transposes and weights that its print lost. Here every linearisation is
    written in the coordinates of the prior's tangent space, so that J appears once, at the end.
    """
    if iterations < 1:
        raise ValueError(f"iterations: got {iterations}, expected at least 1")
    factors = [factors] if isinstance(factors, Factor) else list(factors)
    covariance = as_array("belief.covariance", belief.covariance, manifold.dim, manifold.dim)
    zero = jnp.zeros(manifold.dim, covariance.dtype)
    innovations, keeps, broken = _select(manifold, factors, belief._replace(covariance=covariance), zero)

    def linearized(v: Array) -> tuple[Gained, Rows]:
        values, slopes = evaluate(manifold, factors, belief.mean, v)
        rows = joined([whiten(*each) for each in zip(factors, values, slopes, keeps, strict=True)])
        return gain(covariance, rows.design, rows.residual + product(rows.design, v)), rows

    start, steps, settled = zero, jnp.int32(1), jnp.bool_(True)
    if iterations > 1:
        if tolerance is None:
            tolerance = float(jnp.finfo(covariance.dtype).eps) ** (1 / 3)
        start, steps, settled = _iterate(linearized, zero, iterations, jnp.asarray(tolerance, covariance.dtype))
    gained, rows = linearized(start)
    mean = manifold.retract(belief.mean, gained.correction)
    turn = reanchor(manifold, belief.mean, gained.correction, mean)
    design = linalg.solve(turn.T, rows.design.T).T
    used = jnp.concatenate(keeps)
    info = UpdateInfo(
        log_likelihood=rows.constant - (gained.nis + gained.log_det) / 2,
        nis=gained.nis,
        dof=jnp.sum(used, dtype=jnp.int32),
        innovation=jnp.concatenate(innovations),
        used=used,
        information=product(design.T, design),
        iterations=steps,
        status=jnp.where(broken, NON_FINITE, jnp.where(settled, OK, NOT_CONVERGED)).astype(jnp.int32),
    )
    return Gaussian(mean, symmetric(sandwich(turn, gained.covariance))), info


def _select(manifold: Manifold, factors: list[Factor], belief: Gaussian, zero: Array) -> tuple[list, list, Array]:
    """Which rows take part: those that exist, are finite, and lie inside their gate at the prediction."""
    values, slopes = evaluate(manifold, factors, belief.mean, zero)
    innovations, keeps, broken = [], [], jnp.zeros((), bool)
    for factor, value, slope in zip(factors, values, slopes, strict=True):
        there = validity(factor, value)
        keep = there & jnp.isfinite(value)
        broken = broken | jnp.any(there & ~keep)
        value = jnp.where(keep, value, 0)
        innovations.append(value)
        keeps.append(inside_gate(factor, value, jnp.where(keep[:, None], slope, 0), keep, belief.covariance))
    return innovations, keeps, broken


def _iterate(
    linearized: Callable[[Array], tuple[Gained, Any]], zero: Array, iterations: int, tolerance: Array
) -> tuple[Array, Array, Array]:
    """Find where the last linearisation is to be made; its derivative is that of the root, not of the way to it."""

    def move(v: Array) -> Array:
        return linearized(v)[0].correction - v

    def solve(_: Any, zero: Array) -> tuple[Array, tuple[Array, Array]]:
        def body(carry: Any) -> Any:
            v, dual, count, _ = carry
            gained, rows = linearized(v)
            step = gained.correction - v
            # The step's length in standard deviations of the posterior; P^-1 step is the step of the dual.
            squared = jnp.sum(product(rows.design, step) ** 2) + jnp.abs(jnp.sum(step * (gained.dual - dual)))
            return gained.correction, gained.dual, count + 1, squared <= tolerance * tolerance

        def going(carry: Any) -> Array:
            return (carry[2] < iterations) & ~carry[3]

        v, _, count, settled = jax.lax.while_loop(going, body, (zero, zero, jnp.int32(1), jnp.bool_(False)))
        # A whole number has no tangent that custom_root can handle.
        return v, (count.astype(zero.dtype), settled.astype(zero.dtype))

    def tangent(g: Callable[[Array], Array], y: Array) -> Array:
        return linalg.solve(jax.jacfwd(g)(y), y)

    root, (count, settled) = jax.lax.custom_root(move, zero, solve, tangent, has_aux=True)
    return root, count.astype(jnp.int32), settled > 0


__all__ = ["UpdateInfo", "update"]
