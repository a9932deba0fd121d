"""Charts of values on curved spaces, each smooth around the value that it was made from."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.manifolds import quaternion, so3
from jaxest.tuning._chart import UNIT, Bijection, finite
from jaxest.types import Array


def unit_vector(value: Any) -> Bijection:
    """Keep a direction (k,) of length 1, by the tangent vector that leads to it from the value along a great circle."""
    array = finite(value)
    length = np.linalg.norm(array)
    if array.ndim != 1 or array.size < 2 or abs(length - 1) > UNIT:
        raise ValueError(f"got {array.tolist()} of length {length:.6g}, expected a vector of length 1")
    # Householder's reflection takes the first axis to the value (or its opposite); the others span its tangents.
    sign = 1.0 if array[0] >= 0 else -1.0
    mirror = array / length + sign * np.eye(array.size)[0]
    frame = np.eye(array.size) - 2 * np.outer(mirror, mirror) / (mirror @ mirror)
    anchor, tangents = -sign * frame[:, 0], frame[:, 1:]

    def constrain(z: Array) -> Array:
        square = jnp.sum(z * z)
        small = square < 1e-8
        length = jnp.sqrt(jnp.where(small, 1.0, square))
        ratio = jnp.where(small, 1 - square / 6, jnp.sin(length) / length)
        cosine = jnp.where(small, 1 - square / 2, jnp.cos(length))
        found = cosine * jnp.asarray(anchor, z.dtype) + ratio * _dot(jnp.asarray(tangents, z.dtype), z)
        return found / jnp.sqrt(jnp.sum(found * found))

    def unconstrain(x: Any) -> Array:
        x = jnp.asarray(x)
        along, across = jnp.sum(x * anchor.astype(x.dtype)), _dot(jnp.asarray(tangents.T, x.dtype), x)
        square = jnp.sum(across * across)
        there = square > 0
        size = jnp.sqrt(jnp.where(there, square, 1.0))
        return across * jnp.where(there, jnp.arctan2(size, along) / size, 1.0)

    return Bijection(array.size - 1, constrain, unconstrain)


def _dot(matrix: Array, vector: Array) -> Array:
    return jnp.sum(matrix * vector[None, :], axis=1)


def rotation(value: Any) -> Bijection:
    """Keep a rotation, a quaternion (4,) wxyz or a matrix (3, 3), by the rotation vector from the value, rad."""
    array = finite(value)
    group: Any = {(4,): quaternion, (3, 3): so3}.get(array.shape)
    if group is None:
        raise ValueError(f"got shape {array.shape}, expected a quaternion (4,) or a matrix (3, 3)")
    off = np.linalg.norm(array) - 1 if group is quaternion else np.abs(array @ array.T - np.eye(3)).max()
    if abs(off) > UNIT or (group is so3 and np.linalg.det(array) < 0):
        raise ValueError(f"got {array.tolist()}, expected a unit quaternion or a rotation matrix")

    def constrain(z: Array) -> Array:
        return group.retract(jnp.asarray(array, z.dtype), z)

    def unconstrain(x: Any) -> Array:
        x = jnp.asarray(x)
        return group.local(jnp.asarray(array, x.dtype), x)

    return Bijection(3, constrain, unconstrain)


def covariance(value: Any) -> Bijection:
    """Keep a symmetric positive definite matrix (n, n), by its Cholesky factor with logarithms on the diagonal."""
    array = finite(value)
    n = len(array) if array.ndim else 0
    scale = np.abs(array).max() if array.size else 0.0
    if array.shape != (n, n) or n == 0 or np.abs(array - array.T).max() > UNIT * scale:
        raise ValueError(f"got shape {array.shape}, expected a symmetric matrix (n, n)")
    if np.linalg.eigvalsh((array + array.T) / 2)[0] <= 0:
        raise ValueError(f"got {array.tolist()}, expected a positive definite matrix")
    below = np.tril_indices(n, -1)

    def constrain(z: Array) -> Array:
        lower = jnp.zeros((n, n), z.dtype).at[np.diag_indices(n)].set(jnp.exp(z[:n])).at[below].set(z[n:])
        return jnp.matmul(lower, lower.T, precision=jax.lax.Precision.HIGHEST)

    def unconstrain(x: Any) -> Array:
        lower = linalg.cholesky(jnp.asarray(x))
        return jnp.concatenate([jnp.log(jnp.diagonal(lower)), lower[below]])

    return Bijection(n * (n + 1) // 2, constrain, unconstrain)


__all__ = ["covariance", "rotation", "unit_vector"]
