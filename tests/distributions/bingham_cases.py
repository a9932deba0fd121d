"""Concentrations of every kind, and the accuracy that each precision owes."""

from typing import NamedTuple

import numpy as np
from quick_compile import QUICK

# Compiles in half the time, differs by roundings from the default.
LIGHT = QUICK


class Bounds(NamedTuple):
    """Largest errors: log C absolute, moments relative, Hessian absolute."""

    log_c: float
    moments: float
    hessian: float


BOUNDS = {"float32": Bounds(1e-5, 1e-5, 2e-5), "float64": Bounds(1e-12, 1e-11, 1e-11)}

# All are float32 numbers, so that both precisions are asked the same.
LAM = np.array(
    [
        [0, 0, 0, 0],
        [-0.5, -0.25, -0.25, 0],
        [0, -3, -3, -3],
        [-1, 0, -20, -7.5],
        [-30, -30, -(2.0**-20), 0],
        [-800, -800, 0, 0],
        [-800, 0, -800, -800],
        [-1500, -750, 0, -375],
        [-2048, 0, 0, -0.125],
    ]
)
SIZES = [2.0**-20, 0.25, 100, 2.0**14, 1e6]

# Settings whose samples are checked in the default run: uniform, unimodal, axisymmetric, girdle, graded, extreme.
SAMPLED = [LAM[0], LAM[6], LAM[5], LAM[8], np.array([-1e6, -1e4, -100, 0]), np.array([-1e6, -1e6, -1e6, 0])]


def rotations(count: int, seed: int = 0) -> np.ndarray:
    """Random orthonormal matrices (count, 4, 4)."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(count, 4, 4)))[0]
