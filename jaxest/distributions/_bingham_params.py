"""The parameters of a Bingham density and what can be done with them alone."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxest.distributions._symmetric import eigh, outer, product
from jaxest.manifolds import quaternion
from jaxest.manifolds.base import as_array
from jaxest.types import Array, ArrayLike


class Params(NamedTuple):
    """A Bingham density on unit quaternions, proportional to exp(sum lam_i (d_i . q)^2).

    Every function here that wants parameters also takes a symmetric matrix A (4, 4), with the density proportional to
    exp(q^T A q), or concentrations (4,) alone, along the axes w, x, y, z. Matrices are decomposed on each call: make a
    `Params` once with `from_matrix` where it matters.
    """

    directions: Array
    """(4, 4) orthonormal, the principal directions d_i as columns, in wxyz."""
    lam: Array
    """(4,) concentrations in the order of the columns; only their differences count."""


AnyParams = Params | tuple[ArrayLike, ArrayLike] | ArrayLike


def standard(lam: ArrayLike) -> Params:
    """Return the density with principal directions along w, x, y, z.

    Args:
        lam: (4,) concentrations of w, x, y, z. (0, l, l, l) with l < 0 is centred at no rotation, with a rotation
            error of about 1 / sqrt(-l / 2) rad about each axis; (0, l, l, 0) leaves the rotation about z free.

    Returns:
        The parameters.

    Raises:
        ValueError: the shape is wrong.
    """
    lam = as_array("lam", lam, 4)
    return Params(jnp.eye(4, dtype=lam.dtype), lam)


def about(centre: ArrayLike, lam: ArrayLike) -> Params:
    """Return the density of `centre * e` with e distributed as `standard(lam)`: errors are about the body's axes.

    Args:
        centre: (4,) unit quaternion wxyz.
        lam: (4,) concentrations of the error's w, x, y, z.

    Returns:
        The parameters. For errors about the world's axes, `rotate_right(standard(lam), centre)`.

    Raises:
        ValueError: a shape is wrong.
    """
    return rotate_left(standard(lam), centre)


def from_matrix(matrix: ArrayLike) -> Params:
    """Return the density proportional to exp(q^T A q).

    Args:
        matrix: (4, 4) A, symmetric (its symmetric part is taken).

    Returns:
        The parameters; concentrations are not sorted.

    Raises:
        ValueError: the shape is wrong.
    """
    matrix = as_array("matrix", matrix, 4, 4)
    lam, directions = eigh((matrix + matrix.T) / 2)
    return Params(directions, lam)


def to_matrix(params: AnyParams) -> Array:
    """Return A (4, 4), symmetric, of the density proportional to exp(q^T A q); raises ValueError for a wrong shape."""
    params = as_params(params)
    return outer(params.directions, params.lam)


def as_params(params: AnyParams) -> Params:
    """Return parameters in the form of `Params`.

    Args:
        params: `Params`, a pair (D, lam), a matrix A (4, 4), or concentrations (4,).

    Returns:
        The parameters, checked.

    Raises:
        ValueError: none of these shapes.
    """
    if isinstance(params, tuple):
        directions, lam = params
        return Params(as_array("directions", directions, 4, 4), as_array("lam", lam, 4))
    if jnp.ndim(params) == 1:
        return standard(params)
    if jnp.shape(params) != (4, 4):
        raise ValueError(f"params: has shape {jnp.shape(params)}, expected Params, a matrix (4, 4) or lam (4,)")
    return from_matrix(params)


def mode(params: AnyParams) -> Array:
    """Return the most probable rotation, the principal direction of the largest concentration.

    Args:
        params: see `Params`.

    Returns:
        (4,) unit quaternion wxyz with w >= 0; one of them where the largest concentration is not alone.

    Raises:
        ValueError: a shape is wrong.
    """
    params = as_params(params)
    q = jnp.take(params.directions, jnp.argmax(params.lam), axis=1)
    return jnp.where(q[0] < 0, -q, q)


def rotate_left(params: AnyParams, rotation: ArrayLike) -> Params:
    """Return the density of `rotation * q`, for q of the given density: another world frame.

    Args:
        params: see `Params`.
        rotation: (4,) unit quaternion wxyz.

    Returns:
        The parameters.

    Raises:
        ValueError: a shape is wrong.
    """
    params = as_params(params)
    turned = jax.vmap(quaternion.compose, (None, 1), 1)(as_array("rotation", rotation, 4), params.directions)
    return Params(turned, params.lam)


def rotate_right(params: AnyParams, rotation: ArrayLike) -> Params:
    """Return the density of `q * rotation`, for q of the given density: another body frame (a mounting).

    Args:
        params: see `Params`.
        rotation: (4,) unit quaternion wxyz.

    Returns:
        The parameters.

    Raises:
        ValueError: a shape is wrong.
    """
    params = as_params(params)
    turned = jax.vmap(quaternion.compose, (1, None), 1)(params.directions, as_array("rotation", rotation, 4))
    return Params(turned, params.lam)


def inverse(params: AnyParams) -> Params:
    """Return the density of the inverse rotation; raises ValueError for a wrong shape."""
    params = as_params(params)
    return Params(jax.vmap(quaternion.inverse, 1, 1)(params.directions), params.lam)


def multiply(a: AnyParams, b: AnyParams) -> Params:
    """Return the normalized product of two densities, which is a Bingham density again: their matrices add.

    Args:
        a: see `Params`.
        b: see `Params`.

    Returns:
        The parameters. They are decomposed in the directions of the one that spreads its concentrations wider, which
        keeps the digits of a small matrix beside a large one.

    Raises:
        ValueError: a shape is wrong.
    """
    a, b = as_params(a), as_params(b)
    wide = jnp.ptp(a.lam) >= jnp.ptp(b.lam)
    first, second = (
        Params(jnp.where(wide, x.directions, y.directions), jnp.where(wide, x.lam, y.lam)) for x, y in ((a, b), (b, a))
    )
    across = product(first.directions.T, second.directions)
    lam, turn = eigh(jnp.diag(first.lam - jnp.max(first.lam)) + outer(across, second.lam - jnp.max(second.lam)))
    return Params(product(first.directions, turn), lam)


def coordinates(params: Params, x: Array) -> Array:
    """Return the coordinates (4,) of a quaternion (4,) along the principal directions."""
    return jnp.sum(params.directions * x[:, None], axis=0)


__all__ = [
    "AnyParams",
    "Params",
    "about",
    "as_params",
    "coordinates",
    "from_matrix",
    "inverse",
    "mode",
    "multiply",
    "rotate_left",
    "rotate_right",
    "standard",
    "to_matrix",
]
