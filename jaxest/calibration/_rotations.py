"""Rotations of many samples in NumPy: matrices of rotation vectors and of quaternions, and back."""

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


def skew(v: Matrix) -> Matrix:
    """Return matrices (n, 3, 3) with M u = v x u."""
    zero = np.zeros(len(v))
    x, y, z = v.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def rotations(v: Matrix) -> Matrix:
    """Return the rotation matrices (n, 3, 3) of rotation vectors (n, 3)."""
    angle = np.linalg.norm(v, axis=1)[:, None, None]
    k = skew(v)
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * k + half * half / 2 * (k @ k)


def rotation_vector(rotation: Matrix) -> Matrix:
    """Return the rotation vectors (..., 3) of rotations (..., 3, 3) by less than half a turn."""
    half = np.stack([rotation[..., 2, 1] - rotation[..., 1, 2], rotation[..., 0, 2] - rotation[..., 2, 0],
                     rotation[..., 1, 0] - rotation[..., 0, 1]], -1) / 2  # fmt: skip
    sine = np.linalg.norm(half, axis=-1, keepdims=True)
    cosine = (np.trace(rotation, axis1=-2, axis2=-1)[..., None] - 1) / 2
    return half * np.where(sine > 1e-9, np.arctan2(sine, cosine) / np.maximum(sine, 1e-300), 1.0)


def of_quaternions(q: Matrix) -> Matrix:
    """Return the rotation matrices (..., 3, 3) of quaternions (..., 4) wxyz of any length but 0."""
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]  # fmt: skip
    return np.stack(rows, -1).reshape(*q.shape[:-1], 3, 3)


def to_quaternion(m: Matrix) -> Matrix:
    """Return the quaternion (4,) wxyz, w >= 0, of a rotation matrix: the largest eigenvector of Davenport's matrix."""
    k = np.array([[m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
                  [0, m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
                  [0, 0, m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
                  [0, 0, 0, m[2, 2] - m[0, 0] - m[1, 1]]])  # fmt: skip
    q = np.linalg.eigh(k + k.T - np.diag(np.diag(k)))[1][:, -1]
    return -q if q[0] < 0 else q


__all__ = ["of_quaternions", "rotation_vector", "rotations", "skew", "to_quaternion"]
