"""The von Mises distribution of an angle, density proportional to exp(k cos(x - mean)); elementwise over any shape.

The concentration k is the inverse of the variance where it is large (1/rad^2) and 0 for the uniform distribution. All
is accurate from k = 0 to 1e8 and beyond in the arguments' own precision; a negative k gives NaN.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.distributions import _rejection
from jaxest.distributions._bessel import log_i0e, ratio_and_complement
from jaxest.distributions._checks import common_dtype, fits, floating
from jaxest.distributions._rejection import Draws
from jaxest.distributions._von_mises_inverse import invert
from jaxest.distributions._von_mises_map import FastSampler, fast_sampler, from_bits, sample_fast
from jaxest.distributions._von_mises_sample import drawn_about_zero
from jaxest.manifolds import circle
from jaxest.manifolds.base import as_array, normalized
from jaxest.types import NON_FINITE, OK, Array, ArrayLike

_LOG_TURN = math.log(2 * math.pi)


class Fit(NamedTuple):
    """The maximum-likelihood estimate of a von Mises distribution."""

    mean: Array
    """() rad."""
    concentration: Array
    """() k; infinite where all angles are equal."""
    status: Array
    """() int32, `OK`, or `NON_FINITE` where an angle or weight is not finite or no weight is positive."""


def residual(x: ArrayLike, mean: ArrayLike) -> Array:
    """Return how far angles are from the mean, the short way.

    Args:
        x: (...) rad.
        mean: (...) rad.

    Returns:
        (...) rad in [-pi, pi).

    Raises:
        ValueError: the shapes do not fit together.
    """
    x, mean = floating(x=x, mean=mean)
    return circle.wrap(x - mean)


def log_prob(x: ArrayLike, mean: ArrayLike, concentration: ArrayLike) -> Array:
    """Return the log density per radian.

    Args:
        x: (...) angle, rad, of any number of turns.
        mean: (...) rad.
        concentration: (...) k, at least 0.

    Returns:
        (...), k (cos(x - mean) - 1) - log(2 pi I0(k) e^-k), computed as -2 k sin^2((x - mean) / 2) - ...

    Raises:
        ValueError: the shapes do not fit together.

    Source: Sato 2023, eq. 3 (a von Mises distribution of large k has the variance 1/k).
    """
    x, mean, k = floating(x=x, mean=mean, concentration=concentration)
    s = jnp.sin(circle.wrap(x - mean) / 2)
    return -2 * k * s * s - log_i0e(k) - _LOG_TURN


def mean(mean: ArrayLike, concentration: ArrayLike) -> Array:
    """Return the mean direction (...), rad, in [-pi, pi), whatever the concentration."""
    centre, _ = floating(mean=mean, concentration=concentration)
    return circle.wrap(centre)


def mean_resultant_length(concentration: ArrayLike) -> Array:
    """Return E[cos(x - mean)] = I1(k)/I0(k).

    Args:
        concentration: (...) k, at least 0.

    Returns:
        (...) in [0, 1], to a few eps of itself, with accurate derivatives.
    """
    return ratio_and_complement(floating(concentration=concentration)[0])[0]


def circular_variance(concentration: ArrayLike) -> Array:
    """Return E[1 - cos(x - mean)] = 1 - I1(k)/I0(k).

    Args:
        concentration: (...) k, at least 0.

    Returns:
        (...) in [0, 1], to a few eps of itself also where it is 1e-9, with accurate derivatives (-1/2 at 0).
    """
    return ratio_and_complement(floating(concentration=concentration)[0])[1]


def entropy(concentration: ArrayLike) -> Array:
    """Return the differential entropy.

    Args:
        concentration: (...) k, at least 0.

    Returns:
        (...) nat, log(2 pi) for k = 0.
    """
    (k,) = floating(concentration=concentration)
    finite = jnp.isfinite(k)
    safe = jnp.where(finite, k, 1.0)
    value = _LOG_TURN + log_i0e(safe) + safe * ratio_and_complement(safe)[1]
    return jnp.where(finite, value, jnp.where(k > 0, -jnp.inf, jnp.nan))


def concentration(mean_resultant_length: ArrayLike) -> Array:
    """Return the concentration that has a given mean resultant length.

    Args:
        mean_resultant_length: (...) r in [0, 1]. Near 1 its rounding counts: prefer
            `concentration_from_circular_variance` there.

    Returns:
        (...) k; 0 at 0 and infinite at 1, NaN outside.
    """
    (r,) = floating(mean_resultant_length=mean_resultant_length)
    return invert(r, 1 - r)


def concentration_from_circular_variance(circular_variance: ArrayLike) -> Array:
    """Return the concentration that has a given circular variance.

    Args:
        circular_variance: (...) 1 - r in [0, 1]. Near 1 its rounding counts: prefer `concentration` there.

    Returns:
        (...) k; infinite at 0 and 0 at 1, NaN outside.
    """
    (b,) = floating(circular_variance=circular_variance)
    return invert(1 - b, b)


def sample(key: Array, mean: ArrayLike, concentration: ArrayLike, shape: tuple[int, ...] | int | None = None) -> Array:
    """Draw angles by exact rejection.

    Args:
        key: random key.
        mean: rad, broadcast to `shape`.
        concentration: k, at least 0, broadcast to `shape`.
        shape: the sample's whole shape, static; None for that of the parameters.

    Returns:
        (*shape) rad in [-pi, pi). Derivatives with respect to the concentration are zero (`sample_fast` has none
        either); with respect to the mean they are one. `rejection` also tells whether the rounds sufficed.

    Raises:
        ValueError: the parameters do not broadcast to `shape`.
    """
    return rejection(key, mean, concentration, shape).value


def rejection(
    key: Array,
    mean: ArrayLike,
    concentration: ArrayLike,
    shape: tuple[int, ...] | int | None = None,
    rounds: int = _rejection.ROUNDS,
) -> Draws:
    """Draw angles by exact rejection and say which draws are done.

    The tangent of the half angle is drawn from the best Cauchy envelope, so that no cosine is inverted: small angles
    keep their digits at any concentration. At least 0.65 of the proposals are accepted.

    Args:
        key: random key.
        mean: rad, broadcast to `shape`.
        concentration: k, at least 0, broadcast to `shape`.
        shape: the sample's whole shape, static; None for that of the parameters.
        rounds: most rounds of proposals, static.

    Returns:
        `Draws`: value (*shape) rad in [-pi, pi), done (*shape) bool.

    Raises:
        ValueError: the parameters do not broadcast to `shape`.

    Source: Best and Fisher 1979, whose wrapped Cauchy is the angular central Gaussian envelope of the half angle's
    circle (Kent, Ganeiban, Mardia 2018) with 1 / b + 1 / (b + 4 k) = 1.
    """
    whole = fits(shape, mean=jnp.shape(mean), concentration=jnp.shape(concentration))
    dtype = common_dtype(mean, concentration)
    k = jax.lax.stop_gradient(jnp.asarray(concentration, dtype))
    turned, done = drawn_about_zero(key, k, whole, rounds)
    return Draws(circle.wrap(jnp.broadcast_to(jnp.asarray(mean, dtype), whole) + turned), done)


def fit(xs: ArrayLike, weights: ArrayLike | None = None) -> Fit:
    """Return the maximum-likelihood estimate from a sample.

    Args:
        xs: (N,) angles, rad.
        weights: (N,), any scale; all equal if None.

    Returns:
        `Fit`, accurate for narrow samples too: 1 - r is summed from the squared sines of half the residuals.

    Raises:
        ValueError: a shape is wrong.

    Source: Sato 2023, eq. 5, with the means that the print lost.
    """
    xs = as_array("xs", xs, None)
    weights = normalized(weights, xs)
    good = jnp.all(jnp.isfinite(xs)) & jnp.all(jnp.isfinite(weights)) & (jnp.sum(weights) > 0)
    xs, weights = jnp.where(good, xs, 0.0), jnp.where(good, weights, 1.0 / xs.shape[0])
    centre = circle.mean_direction(xs, weights)
    half = circle.wrap(xs - centre) / 2
    # The second turn takes out what rounding left of the mean's error.
    centre = centre + jnp.arctan2(jnp.sum(weights * jnp.sin(2 * half)), jnp.sum(weights * jnp.cos(2 * half)))
    centre = circle.wrap(centre)
    turned = circle.wrap(xs - centre)
    spread = 2 * jnp.sum(weights * jnp.sin(turned / 2) ** 2)
    length = jnp.sum(weights * jnp.cos(turned))
    k = invert(jnp.clip(length, 0.0, 1.0), jnp.clip(spread, 0.0, 1.0))
    bad = jnp.where(good, 0.0, jnp.nan).astype(xs.dtype)
    return Fit(centre + bad, k + bad, jnp.where(good, OK, NON_FINITE).astype(jnp.int32))


__all__ = [
    "Draws",
    "FastSampler",
    "Fit",
    "circular_variance",
    "concentration",
    "concentration_from_circular_variance",
    "entropy",
    "fast_sampler",
    "fit",
    "from_bits",
    "log_prob",
    "mean",
    "mean_resultant_length",
    "rejection",
    "residual",
    "sample",
    "sample_fast",
]
