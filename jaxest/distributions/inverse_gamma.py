"""The inverse-gamma distribution of a variance: 1/x is gamma with shape alpha and rate beta; elementwise."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.special import digamma, gammaln, polygamma

from jaxest.distributions._checks import fits, floating
from jaxest.manifolds.base import as_array, normalized
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike

_LARGE = 8.0


class Fit(NamedTuple):
    """The maximum-likelihood estimate of an inverse-gamma distribution."""

    alpha: Array
    """() shape."""
    beta: Array
    """() scale, in the unit of x."""
    status: Array
    """() int32: `OK`, `NOT_CONVERGED` (all numbers equal: the estimate would be infinite), or `NON_FINITE` (a number
    is not finite or not positive, or no weight is positive)."""


def log_prob(x: ArrayLike, alpha: ArrayLike, beta: ArrayLike) -> Array:
    """Return the log density.

    Args:
        x: (...), a variance in any unit.
        alpha: (...) shape, positive.
        beta: (...) scale, positive, in the unit of x.

    Returns:
        (...) alpha log beta - log Gamma(alpha) - (alpha + 1) log x - beta / x, arranged so that large alpha does not
        cancel; -infinity for x <= 0.

    Raises:
        ValueError: the shapes do not fit together.
    """
    x, alpha, beta = floating(x=x, alpha=alpha, beta=beta)
    inside = x > 0
    x = jnp.where(inside, x, 1.0)
    ratio = beta / (x * alpha)
    apart = (beta / x - alpha) / alpha
    bent = jnp.where(jnp.abs(apart) < 0.5, jnp.log1p(jnp.maximum(apart, -0.5)), jnp.log(ratio)) - apart
    value = 0.5 * (jnp.log(alpha) - math.log(2 * math.pi)) - _stirling(alpha) + alpha * bent - jnp.log(x)
    return jnp.where(inside, value, -jnp.inf)


def _stirling(alpha: Array) -> Array:
    """Return log Gamma(alpha) - (alpha - 1/2) log alpha + alpha - log(2 pi) / 2."""
    large = alpha > _LARGE
    high, low = jnp.where(large, alpha, _LARGE), jnp.where(large, 1.0, alpha)
    s = 1 / (high * high)
    terms = 1 / 12 - s * (1 / 360 - s * (1 / 1260 - s * (1 / 1680 - s * (1 / 1188 - s * (691 / 360360 - s / 156)))))
    direct = gammaln(low) - (low - 0.5) * jnp.log(low) + low - 0.5 * math.log(2 * math.pi)
    return jnp.where(large, terms / high, direct)


def mean(alpha: ArrayLike, beta: ArrayLike) -> Array:
    """Return the mean beta / (alpha - 1) (...), in the unit of beta; infinite for alpha <= 1."""
    alpha, beta = floating(alpha=alpha, beta=beta)
    exists = alpha > 1
    return jnp.where(exists, beta / jnp.where(exists, alpha - 1, 1.0), jnp.inf)


def entropy(alpha: ArrayLike, beta: ArrayLike) -> Array:
    """Return the differential entropy (...), nat."""
    alpha, beta = floating(alpha=alpha, beta=beta)
    # alpha + log Gamma(alpha) - (alpha + 1) digamma(alpha), with log alpha taken out of the last two
    shape = (alpha + 1) * _log_minus_digamma(alpha) - 1.5 * jnp.log(alpha) + _stirling(alpha)
    return jnp.log(beta) + shape + 0.5 * math.log(2 * math.pi)


def _log_minus_digamma(alpha: Array) -> Array:
    """Return log alpha - digamma(alpha)."""
    large = alpha > _LARGE
    high, low = jnp.where(large, alpha, _LARGE), jnp.where(large, 1.0, alpha)
    s = 1 / (high * high)
    terms = 1 / 12 - s * (1 / 120 - s * (1 / 252 - s * (1 / 240 - s * (1 / 132 - s * (691 / 32760 - s / 12)))))
    return jnp.where(large, 0.5 / high + s * terms, jnp.log(low) - digamma(low))


def sample(key: Array, alpha: ArrayLike, beta: ArrayLike, shape: tuple[int, ...] | int | None = None) -> Array:
    """Draw variances.

    Args:
        key: random key.
        alpha: shape, positive, broadcast to `shape`.
        beta: scale, positive, broadcast to `shape`.
        shape: the sample's whole shape, static; None for that of the parameters.

    Returns:
        (*shape), in the unit of beta; by way of the logarithm, so that small alpha does not underflow.

    Raises:
        ValueError: the parameters do not broadcast to `shape`.
    """
    alpha, beta = floating(alpha=alpha, beta=beta)
    whole = fits(shape, parameters=alpha.shape)
    alpha, beta = (jnp.broadcast_to(x, whole) for x in (alpha, beta))
    return jnp.exp(jnp.log(beta) - jax.random.loggamma(key, alpha, whole, alpha.dtype))


def posterior(alpha: ArrayLike, beta: ArrayLike, squares: ArrayLike, count: ArrayLike) -> tuple[Array, Array]:
    """Return the conditional of a variance given normal residuals: again inverse-gamma.

    Args:
        alpha: (...) the prior's shape.
        beta: (...) the prior's scale.
        squares: (...) sum of the squared residuals.
        count: (...) their number.

    Returns:
        (...) alpha + count / 2 and (...) beta + squares / 2.

    Raises:
        ValueError: the shapes do not fit together.
    """
    alpha, beta, squares, count = floating(alpha=alpha, beta=beta, squares=squares, count=count)
    return alpha + count / 2, beta + squares / 2


def fit(xs: ArrayLike, weights: ArrayLike | None = None) -> Fit:
    """Return the maximum-likelihood estimate from a sample.

    Args:
        xs: (N,) positive.
        weights: (N,), any scale; all equal if None.

    Returns:
        `Fit`.

    Raises:
        ValueError: a shape is wrong.

    Source: Minka 2002 (Estimating a gamma distribution), for 1/x: Newton's method on 1/alpha.
    """
    xs = as_array("xs", xs, None)
    weights = normalized(weights, xs)
    good = jnp.all(jnp.isfinite(xs) & (xs > 0)) & jnp.all(jnp.isfinite(weights)) & (jnp.sum(weights) > 0)
    logs = jnp.log(jnp.where(good, xs, 1.0 + jnp.arange(xs.shape[0], dtype=xs.dtype)))
    weights = jnp.where(good, weights, 1.0 / xs.shape[0])
    centre = jnp.sum(weights * logs)
    apart = logs - centre
    spread = jnp.log1p(jnp.sum(weights * (jnp.expm1(-apart) + apart)))  # log mean(1/x) + mean(log x)
    wide = spread > 0
    s = jnp.where(wide, spread, 1.0)
    alpha = (3 - s + jnp.sqrt((s - 3) ** 2 + 24 * s)) / (12 * s)

    def newton(_: int, alpha: Array) -> Array:
        change = (_log_minus_digamma(alpha) - s) / (alpha * alpha * _slope(alpha))
        return 1 / jnp.maximum(1 / alpha + change, 0.1 / alpha)

    alpha = jax.lax.fori_loop(0, 6, newton, alpha)
    bad = jnp.where(good, 0.0, jnp.nan).astype(xs.dtype)
    alpha = jnp.where(wide, alpha, jnp.inf) + bad
    beta = alpha * jnp.exp(centre - spread) + bad
    return Fit(alpha, beta, jnp.where(good, jnp.where(wide, OK, NOT_CONVERGED), NON_FINITE).astype(jnp.int32))


def _slope(alpha: Array) -> Array:
    """Return 1 / alpha - trigamma(alpha), which is about -1 / (2 alpha^2)."""
    large = alpha > _LARGE
    high, low = jnp.where(large, alpha, _LARGE), jnp.where(large, 1.0, alpha)
    s = 1 / (high * high)
    series = -s * (0.5 + (1 / 6 - s * (1 / 30 - s * (1 / 42 - s * (1 / 30 - s * 5 / 66)))) / high)
    return jnp.where(large, series, 1 / low - polygamma(1, low))


__all__ = ["Fit", "entropy", "fit", "log_prob", "mean", "posterior", "sample"]
