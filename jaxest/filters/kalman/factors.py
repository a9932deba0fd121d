"""What a measurement says about a state: residual, noise, mask, robust loss, gate; and its whitened linear form."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters.kalman.gaussian import product, sandwich
from jaxest.manifolds.base import Manifold, as_array
from jaxest.types import Array, ArrayLike, PyTree


class Factor(NamedTuple):
    """One sensor's say: at the true state its residual has mean zero and the given noise.

    The noise is cut in blocks of correlated rows; a loss and a gate judge block by block. A residual of masked rows
    may be any finite number: a NaN there would reach gradients (`0 * NaN`), so mask what goes into it.
    """

    residual: Callable[[PyTree], Array]
    """`x -> (m,)`, measured minus predicted in the tangent space of the measurement."""
    noise: ArrayLike
    """(m,) variances of independent rows, (m, m) covariance of one block, or (k, d, d) of k blocks with k d = m."""
    valid: ArrayLike | None = None
    """(m,) bool, rows that exist; all if None. The others take part in nothing."""
    loss: Callable[[Array], Array] | None = None
    """Robust weight of a block, of its squared length in standard deviations: `huber`, `cauchy`; 1 if None."""
    gate: ArrayLike | None = None
    """Blocks whose squared Mahalanobis distance from the prediction exceeds it are left out (99 % of a chi-square:
    6.63, 9.21, 11.34 for 1, 2, 3 rows); none if None."""
    jacobian: Callable[[PyTree], ArrayLike] | None = None
    """`x -> (m, n)`, derivative of the residual by the tangent at x; by forward differentiation if None."""


class Rows(NamedTuple):
    """Factors as linear equations with unit noise: `residual - design v` for a step v of the tangent."""

    residual: Array
    """(m,); 0 in masked rows."""
    design: Array
    """(m, n); 0 in masked rows."""
    constant: Array
    """() what the noise adds to the log-density: -(log det R + m log 2 pi) / 2 of the rows that exist."""


def huber(squared: Array, threshold: ArrayLike = 1.345) -> Array:
    """Weight of Huber's loss: quadratic up to the threshold, linear beyond.

    Args:
        squared: (k,) squared lengths of whitened residuals.
        threshold: () in standard deviations; `partial(huber, threshold=...)` sets it.

    Returns:
        (k,) weights in (0, 1].

    Source: Huber 1981 (Robust statistics), section 3.5.
    """
    outside = squared > threshold * threshold
    return jnp.where(outside, threshold / jnp.sqrt(jnp.where(outside, squared, 1)), 1)


def cauchy(squared: Array, scale: ArrayLike = 2.385) -> Array:
    """Weight of Cauchy's loss, which lets far outliers go.

    Args:
        squared: (k,) squared lengths of whitened residuals.
        scale: () in standard deviations.

    Returns:
        (k,) weights in (0, 1].

    Source: Zhang 1997 (Parameter estimation techniques), table 1.
    """
    return 1 / (1 + squared / (scale * scale))


def evaluate(manifold: Manifold, factors: Sequence[Factor], anchor: PyTree, v: Array) -> tuple[list[Any], list[Any]]:
    """Return residuals (m,) and their derivatives (m, n) by `v` at `retract(anchor, v)`, one a factor."""
    ours = [i for i, factor in enumerate(factors) if factor.jacobian is None]

    def residuals(v: Array) -> tuple[list[Array], list[Array]]:
        x = manifold.retract(anchor, v)
        values = [as_array("residual", factor.residual(x), None) for factor in factors]
        return [values[i] for i in ours], values

    slopes, values = jax.jacfwd(residuals, has_aux=True)(v)
    found = dict(zip(ours, slopes, strict=True))
    if len(ours) < len(factors):
        x = manifold.retract(anchor, v)
        turn = reanchor(manifold, anchor, v, x)
        for i, factor in enumerate(factors):
            if factor.jacobian is not None:
                given = as_array("jacobian", factor.jacobian(x), values[i].shape[0], manifold.dim)
                found[i] = product(given, turn)
    return values, [found[i] for i in range(len(factors))]


def reanchor(manifold: Manifold, anchor: PyTree, v: Array, x: PyTree) -> Array:
    """Return how the tangent at `x = retract(anchor, v)` moves with v, (n, n): the inverse of Iwao 2025's J."""
    return jax.jacfwd(lambda v: manifold.local(x, manifold.retract(anchor, v)))(v)


def validity(factor: Factor, residual: Array) -> Array:
    """Return which rows of a factor exist, (m,) bool."""
    if factor.valid is None:
        return jnp.ones(residual.shape, bool)
    return as_array_bool("valid", factor.valid, residual.shape[0])


def as_array_bool(name: str, value: ArrayLike, length: int) -> Array:
    """Return a mask (length,); raises ValueError for another shape."""
    mask = jnp.asarray(value, bool)
    if mask.shape != (length,):
        raise ValueError(f"{name}: has shape {mask.shape}, expected ({length},), one a row of the residual")
    return mask


def block_size(factor: Factor, rows: int) -> int:
    """Return the number of rows of a block of correlated noise; raises ValueError where they do not fit."""
    shape = jnp.shape(factor.noise)
    if shape == (rows,):
        return 1
    if shape == (rows, rows):
        return rows
    if len(shape) == 3 and shape[1] == shape[2] and shape[0] * shape[1] == rows:
        return shape[1]
    raise ValueError(f"noise: has shape {shape}, expected ({rows},), ({rows}, {rows}) or (k, d, d) with k d = {rows}")


def whiten(factor: Factor, residual: Array, slope: Array, keep: Array) -> Rows:
    """Return a factor's rows with unit noise, weighted by its loss; rows not in `keep` (m,) become zero."""
    m, d = residual.shape[0], block_size(factor, residual.shape[0])
    residual = jnp.where(keep, residual, 0)
    slope = jnp.where(keep[:, None], slope, 0)
    kept = keep.reshape(-1, d)
    noise = jnp.asarray(factor.noise, residual.dtype).reshape(-1, d, d)
    apart = jnp.eye(d, dtype=noise.dtype)[None]
    noise = jnp.where(kept[:, :, None] & kept[:, None, :], noise, apart)  # what is masked is marginalised out
    rows = jnp.concatenate([residual[:, None], -slope], axis=1).reshape(-1, d, slope.shape[1] + 1)
    if d == 1:
        rows = rows / jnp.sqrt(noise)
        log_det = jnp.log(noise[:, 0, 0])
    else:
        root = jax.vmap(linalg.cholesky)(noise)
        rows = jax.vmap(linalg.solve_triangular)(root, rows)
        log_det = 2 * jnp.sum(jnp.log(jnp.diagonal(root, axis1=1, axis2=2)), axis=1)
    count = jnp.sum(kept, axis=1).astype(residual.dtype)
    if factor.loss is not None:
        weight = factor.loss(jnp.sum(rows[:, :, 0] ** 2, axis=1))
        rows = rows * jnp.sqrt(weight)[:, None, None]
        log_det = log_det - count * jnp.log(weight)
    rows = rows.reshape(m, -1)
    constant = -(jnp.sum(log_det) + jnp.sum(count) * jnp.log(2 * jnp.pi).astype(residual.dtype)) / 2
    return Rows(rows[:, 0], rows[:, 1:], constant)


def inside_gate(factor: Factor, residual: Array, slope: Array, keep: Array, covariance: Array) -> Array:
    """Return the rows of `keep` (m,) whose block lies inside the gate, judged at the prediction."""
    if factor.gate is None:
        return keep
    d = block_size(factor, residual.shape[0])
    rows = whiten(factor._replace(loss=None), residual, slope, keep)
    design, value = rows.design.reshape(-1, d, rows.design.shape[1]), rows.residual.reshape(-1, d)

    def distance(h: Array, z: Array) -> Array:
        root = linalg.cholesky(jnp.eye(d, dtype=z.dtype) + sandwich(h, covariance))
        return jnp.sum(linalg.solve_triangular(root, z) ** 2)

    inside = jax.vmap(distance)(design, value) <= jnp.asarray(factor.gate, value.dtype)
    return keep & jnp.repeat(inside, d)


def joined(rows: Sequence[Rows]) -> Rows:
    """Return the rows of several factors as one."""
    residual = jnp.concatenate([r.residual for r in rows])
    return Rows(
        residual,
        jnp.concatenate([r.design for r in rows]),
        sum((r.constant for r in rows), start=jnp.zeros_like(rows[0].constant)),
    )


__all__ = ["Factor", "Rows", "cauchy", "evaluate", "huber", "inside_gate", "joined", "reanchor", "validity", "whiten"]
