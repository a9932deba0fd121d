"""The algebra of pairs a = R(q) b: H(a, b), the covariance of its noise, and A of the Bingham density.

Source: Sato 2024, eqs. 31 to 35, with H corrected; Davenport 1968 (the q-method).
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.filters._small import eye, trace, transposed
from jaxest.manifolds.base import as_array
from jaxest.types import Array, ArrayLike

Information = Callable[[Array, Array], Array]


def pair_matrix(a: ArrayLike, b: ArrayLike) -> Array:
    """Return H(a, b), (4, 4), with H(a, b) q = 0 where a = R(q) b; |H q| = |a - R(q) b|.

    Args:
        a: (3,) vector after the rotation.
        b: (3,) vector before.

    Returns:
        (4, 4).

    Raises:
        ValueError: a shape is wrong.

    Source: Sato 2024, eq. 31, corrected.
    """
    a, b = as_array("a", a, 3), as_array("b", b, 3)
    return jnp.sum(_basis(a.dtype) * jnp.concatenate([a, b])[:, None, None], axis=0)


def _basis(dtype: Any) -> Array:
    """The six matrices (6, 4, 4) that H is linear in."""
    basis = np.zeros((6, 4, 4))
    for k in range(3):
        unit = np.eye(3)[k]
        skew = np.cross(np.eye(3), unit)  # [unit x], for row i is e_i x unit = the i-th row of [unit x]
        for sign, at in ((1, k), (-1, 3 + k)):
            basis[at, 0, 1:], basis[at, 1:, 0], basis[at, 1:, 1:] = -sign * unit, sign * unit, skew
    return jnp.asarray(basis, dtype)


def isotropic(covariance_a: Array, covariance_b: Array) -> Array:
    """Return the inverse (4, 4) of Sigma_H for rotations spread evenly: a multiple of the identity, in closed form.

    Exactly what `general` gives for Sigma_q = I/4 wherever the covariances are isotropic.
    """
    return jnp.eye(4, dtype=covariance_a.dtype) * (4 / (jnp.trace(covariance_a) + jnp.trace(covariance_b)))


def general(covariance_a: Array, covariance_b: Array, second_moment: Array | None = None) -> Array:
    """Return the inverse (4, 4) of Sigma_H for any noise.

    Args:
        covariance_a: (3, 3) of a's noise.
        covariance_b: (3, 3) of b's noise.
        second_moment: (4, 4) E[q q'] of what is believed of q (not its covariance); I/4, evenly spread, if None.

    Returns:
        (4, 4).

    Source: Sato 2024, eqs. 33 and 34.
    """
    return linalg.inverse(noise_matrix(covariance_a, covariance_b, second_moment))


def noise_matrix(covariance_a: Array, covariance_b: Array, second_moment: Array | None = None) -> Array:
    """Return Sigma_H (4, 4), the covariance of H(a, b) q under noise; arguments as for `general`."""
    basis = _basis(covariance_a.dtype)
    spread = jnp.eye(4, dtype=basis.dtype) / 4 if second_moment is None else second_moment
    total = jnp.zeros((4, 4), basis.dtype)
    for block, covariance in ((basis[:3], covariance_a), (basis[3:], covariance_b)):
        moved = jnp.einsum("mij,jk,nlk->mnil", block, spread, block)
        total = total + jnp.sum(covariance[:, :, None, None] * moved, axis=(0, 1))
    return total


def parameter(second: Array, information: Array | None = None, total: ArrayLike | None = None) -> Array:
    """Return A (4, 4) of the Bingham density, less the multiple of the identity that makes it traceless.

    Args:
        second: (6, 6) sum of z z' over the pairs z = (a, b); an axis behind is a batch, in the closed form.
        information: (4, 4) inverse of Sigma_H.
        total: () in place of `information`: trace of both covariances, for the closed form -(2 / total) H'H.

    Returns:
        (4, 4) symmetric.

    Source: Sato 2024, eq. 35; for the closed form Davenport 1968 (the q-method): q'A q grows as (4 / total) a' R(q) b.
    """
    if information is None:
        b = second[:3, 3:]
        size = trace(b)
        side = jnp.stack([b[2, 1] - b[1, 2], b[0, 2] - b[2, 0], b[1, 0] - b[0, 1]])
        lower = b + transposed(b) - size[None, None] * eye(3, size)
        davenport = jnp.concatenate(
            [jnp.concatenate([size[None], side])[None], jnp.concatenate([side[:, None], lower], axis=1)]
        )
        return davenport * (4 / jnp.asarray(1.0 if total is None else total, b.dtype))[None, None]
    basis = _basis(second.dtype)
    a = -jnp.einsum("mn,mki,kl,nlj->ij", second, basis, information, basis) / 2
    a = (a + a.T) / 2
    return a - jnp.trace(a) / 4 * jnp.eye(4, dtype=a.dtype)


__all__ = ["Information", "general", "isotropic", "noise_matrix", "pair_matrix", "parameter"]
