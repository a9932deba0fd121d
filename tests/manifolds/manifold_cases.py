"""Rotations of every size about axes of every kind, for the tests of this folder."""

import numpy as np
from quick_compile import QUICK

# Compiles in half the time, differs by roundings from the default. What the bounds in eps are about, exp and log with
# their derivatives, is compiled as users compile it.
LIGHT = QUICK

AXES = np.array(
    [
        *np.eye(3),
        *-np.eye(3),
        [1, 1, 0],
        [1, 0, -1],
        [1, 1, 1],
        [1, 1e-4, 0],
        [1e-8, 1, -1e-3],
        *np.random.default_rng(0).normal(size=(4, 3)),
    ]
)
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
ANGLES = np.concatenate([[0], np.geomspace(1e-9, np.pi, 31), [np.pi - 1e-6, np.pi - 1e-3]])


def rotation_vectors() -> np.ndarray:
    """All angles about all axes, (n, 3)."""
    return (ANGLES[:, None, None] * AXES).reshape(-1, 3)


def twists() -> np.ndarray:
    """The same with translations of about one and of about a millionth, (n, 6)."""
    phi = rotation_vectors()
    rho = np.random.default_rng(1).normal(size=phi.shape)
    rho[::3] *= 1e-6
    return np.concatenate([phi, rho], axis=1)


def angles() -> np.ndarray:
    """All angles of both signs as tangent vectors of the circle, (n, 1)."""
    return np.concatenate([ANGLES, -ANGLES])[:, None]


def apart(got, expected) -> float:
    """The largest difference of two arrays; NaN where there is one, which fails every comparison."""
    got, expected = np.asarray(got, np.float64), np.asarray(expected, np.float64)
    assert got.shape == expected.shape or expected.ndim == 0
    return float(np.abs(got - expected).max())
