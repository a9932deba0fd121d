"""The Bingham distribution of a rotation: a density on unit quaternions (S^3) proportional to exp(q^T A q).

q and -q are equally probable. Densities are with respect to the area of S^3, 2 pi^2 in all. Start with `standard(lam)`
or `about(centre, lam)`; a rotation is in wxyz. Concentrations may be in any order, equal, shifted by a constant, and
1e6 apart; nothing here subtracts one eigenvalue from another.
"""

import jax.numpy as jnp

from jaxest.distributions._bingham_fit import Fit, fit, fit_moment
from jaxest.distributions._bingham_normalizer import (
    fourth_moments,
    frame_log_prob,
    log_normalizer,
    matrix_log_prob,
    matrix_second_moment,
    moment_covariance,
    second_moments,
)
from jaxest.distributions._bingham_params import (
    AnyParams,
    Params,
    about,
    as_params,
    coordinates,
    from_matrix,
    inverse,
    mode,
    multiply,
    rotate_left,
    rotate_right,
    standard,
    to_matrix,
)
from jaxest.distributions._bingham_sample import rejection, sample
from jaxest.distributions._rejection import Draws
from jaxest.distributions._symmetric import outer, product
from jaxest.manifolds.base import as_array
from jaxest.types import Array, ArrayLike

mean = mode


def log_prob(x: ArrayLike, params: AnyParams) -> Array:
    """Return the log density per unit of area of S^3.

    Args:
        x: (4,) unit quaternion wxyz.
        params: see `Params`. Of a matrix the derivatives are right for equal eigenvalues too.

    Returns:
        (). In float32 a coordinate across the mode is known to 1e-7, and the density as it follows from that.

    Raises:
        ValueError: a shape is wrong.

    Source: Sato 2023, eq. 27.
    """
    x = as_array("x", x, 4)
    if not isinstance(params, tuple) and jnp.ndim(params) == 2:
        matrix = as_array("params", params, 4, 4)
        return matrix_log_prob(x, (matrix + matrix.T) / 2)
    params = as_params(params)
    return frame_log_prob(coordinates(params, x), params.lam)


def second_moment(params: AnyParams) -> Array:
    """Return E[q q^T].

    Args:
        params: see `Params`.

    Returns:
        (4, 4), symmetric, of trace 1.

    Raises:
        ValueError: a shape is wrong.
    """
    if not isinstance(params, tuple) and jnp.ndim(params) == 2:
        matrix = as_array("params", params, 4, 4)
        return matrix_second_moment((matrix + matrix.T) / 2)
    params = as_params(params)
    return outer(params.directions, second_moments(params.lam))


def entropy(params: AnyParams) -> Array:
    """Return the differential entropy.

    Args:
        params: see `Params`.

    Returns:
        () nat, log(2 pi^2) for the uniform density.

    Raises:
        ValueError: a shape is wrong.
    """
    lam = as_params(params).lam
    shifted = lam - jnp.max(lam)
    return log_normalizer(shifted) - jnp.sum(shifted * second_moments(shifted))


def kl_divergence(p: AnyParams, q: AnyParams) -> Array:
    """Return the Kullback-Leibler divergence of q from p, the mean under p of log p - log q.

    Args:
        p: see `Params`.
        q: see `Params`.

    Returns:
        () nat, at least 0 up to rounding; 0 if the densities are equal.

    Raises:
        ValueError: a shape is wrong.
    """
    p, q = as_params(p), as_params(q)
    mine, other = (x.lam - jnp.max(x.lam) for x in (p, q))
    moments = second_moments(mine)
    across = product(q.directions.T, p.directions)
    expected = jnp.sum(other[:, None] * across * across * moments[None, :])
    return jnp.sum(mine * moments) - expected + (log_normalizer(other) - log_normalizer(mine))


__all__ = [
    "AnyParams",
    "Draws",
    "Fit",
    "Params",
    "about",
    "as_params",
    "entropy",
    "fit",
    "fit_moment",
    "fourth_moments",
    "from_matrix",
    "inverse",
    "kl_divergence",
    "log_normalizer",
    "log_prob",
    "mean",
    "mode",
    "moment_covariance",
    "multiply",
    "rejection",
    "rotate_left",
    "rotate_right",
    "sample",
    "second_moment",
    "second_moments",
    "standard",
    "to_matrix",
]
