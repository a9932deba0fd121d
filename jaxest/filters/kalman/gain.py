"""The linear update of a covariance, inverted in the dimension of the measurement or of the state.

Both return the Joseph form: a sum of two positive terms, which stays symmetric and positive where the short form
`(I - K H) P` loses its sign in float32, and in which an error of the gain counts only squared. A square root would
resolve twice the digits, but a QR of every step costs four to eight times a Cholesky factor, a root of a singular
covariance (a known start, a static parameter) has no derivative, and a covariance is what callers read and write; the
smoother, where weakly and strongly informed parts meet over a whole series, does carry square roots.
"""

from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters.kalman.gaussian import product, sandwich, symmetric
from jaxest.types import Array


class Gained(NamedTuple):
    """What a linear measurement does to a state."""

    correction: Array
    """(n,) the state's mean, which was zero."""
    dual: Array
    """(n,) with correction = covariance before @ dual."""
    covariance: Array
    """(n, n) afterwards."""
    nis: Array
    """() innovation squared, in its own covariance."""
    log_det: Array
    """() log det of the innovation's covariance, the noise being one."""


class Gain(Protocol):
    """`(covariance (n, n), design (m, n), innovation (m,)) -> Gained`, for unit noise."""

    def __call__(self, covariance: Array, design: Array, innovation: Array) -> Gained:
        """Return the update."""
        ...


def measurement_gain(covariance: Array, design: Array, innovation: Array) -> Gained:
    """Update with one Cholesky factor of the size of the measurement, for few rows.

    Args:
        covariance: (n, n) before; may be singular.
        design: (m, n).
        innovation: (m,), noise one.

    Returns:
        The update.
    """
    m, n = design.shape
    across = product(design, covariance)
    root = linalg.cholesky(jnp.eye(m, dtype=design.dtype) + symmetric(product(across, design.T)))
    half = linalg.solve_triangular(root, jnp.concatenate([innovation[:, None], across], axis=1))
    whole = linalg.solve_triangular(root, half, transposed=True)
    gain = whole[:, 1:].T
    after = sandwich(jnp.eye(n, dtype=gain.dtype) - product(gain, design), covariance) + product(gain, gain.T)
    return Gained(
        product(half[:, 1:].T, half[:, 0]),
        product(design.T, whole[:, 0]),
        symmetric(after),
        jnp.sum(half[:, 0] ** 2),
        2 * jnp.sum(jnp.log(jnp.diagonal(root))),
    )


def state_gain(covariance: Array, design: Array, innovation: Array) -> Gained:
    """Update with one solution of the size of the state, for many rows.

    Iwao 2025's eq. 24 (with its two transposes) needs the inverse of the covariance; `(I + P H'H)^-1` is the same
    and lets it be singular.

    Args:
        covariance: (n, n) before; may be singular.
        design: (m, n).
        innovation: (m,), noise one.

    Returns:
        The update.

    Source: Xu, Zhang 2021 (FAST-LIO), eq. 20, after the matrix inversion lemma.
    """
    information, pull = product(design.T, design), product(design.T, innovation)
    found = information_gain(covariance, information, pull)
    left = innovation - product(design, found.correction)
    dual = found.dual
    return found._replace(nis=jnp.sum(left * left) + jnp.sum(dual * product(covariance, dual)))


def information_gain(covariance: Array, information: Array, pull: Array) -> Gained:
    """Update with normal equations, for rows that were summed up as they came.

    Args:
        covariance: (n, n) before; may be singular.
        information: (n, n) H' R^-1 H.
        pull: (n,) H' R^-1 y of the innovation y.

    Returns:
        The update; its `nis` lacks the part y' R^-1 y, which the sums no longer hold: it is minus what the update
        explains of it.

    Source: as `state_gain`.
    """
    n = pull.shape[0]
    # Pivots are compared between states of different units: scale every state to its own standard deviation.
    scale = jax.lax.stop_gradient(jnp.sqrt(jnp.where(jnp.diagonal(covariance) > 0, jnp.diagonal(covariance), 1)))
    square = scale[:, None] * scale[None, :]
    scaled = covariance / square
    whole = jnp.eye(n, dtype=pull.dtype) + product(scaled, information * square)
    solved, log_det = linalg.solve_and_log_det(whole, jnp.diag(1 / scale))
    shrink = scale[:, None] * solved  # I - K H
    moved = product(shrink, covariance)
    correction = product(moved, pull)
    dual = pull - product(information, correction)
    return Gained(
        correction,
        dual,
        symmetric(sandwich(shrink, covariance) + sandwich(moved, information)),
        -jnp.sum(pull * correction),
        log_det,
    )


def by_size(covariance: Array, design: Array, innovation: Array) -> Gained:
    """Update in the smaller of the two dimensions, which is known while tracing; see `measurement_gain`."""
    chosen = measurement_gain if design.shape[0] <= design.shape[1] else state_gain
    return chosen(covariance, design, innovation)


__all__ = ["Gain", "Gained", "by_size", "information_gain", "measurement_gain", "state_gain"]
