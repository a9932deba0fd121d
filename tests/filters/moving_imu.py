"""IMUs on things that turn and move about within reach, in NumPy: what they read, and the truth."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jaxest.filters import complementary

UP, FIELD = np.array([0, 0, 9.81]), np.array([0, 18.0, -41.0])


class Truth(NamedTuple):
    quaternion: np.ndarray
    """(runs, T, 4) wxyz, sensor to earth"""
    bias: np.ndarray
    """(runs, 3) rad/s"""
    scale: np.ndarray
    """(runs, 3)"""


def waves(random, steps, dt, low, high):
    """Sums of five sines (T, 3) of unit variance each, and their second derivatives."""
    frequency, phase = 2 * np.pi * random.uniform(low, high, (5, 3)), random.uniform(0, 2 * np.pi, (5, 3))
    angle = frequency * dt * np.arange(1, steps + 1)[:, None, None] + phase
    return np.sqrt(2 / 5) * np.sin(angle).sum(axis=1), -np.sqrt(2 / 5) * (frequency**2 * np.sin(angle)).sum(axis=1)


def moving(runs, steps, hz, *, seed=0, turn=1.0, reach=0.1, bias=0.01, scale=0.005, noise=(2e-4, 1e-3, 0.01)):
    """Readings (runs, T, ...) float32 and truth: rates and positions are sums of sines up to 1 Hz.

    turn: rad/s and reach: m, rms about and along each axis; bias: rad/s; noise: densities of rate (rad/s), specific
    force (m/s^2) and field (as a fraction), per root Hz.
    """
    random, dt = np.random.default_rng(seed), 1 / hz
    rows, truth = [], []
    for _ in range(runs):
        rate = turn * waves(random, steps, dt, 0.1, 1.0)[0]
        force = UP + reach * waves(random, steps, dt, 0.2, 1.0)[1]
        turns, now = Rotation.from_rotvec(rate * dt), Rotation.random(rng=random)
        path = []
        for each in turns:
            now = now * each
            path.append(now.as_quat())
        path = Rotation.from_quat(path)
        b, s = bias * random.normal(size=3), scale * random.normal(size=3)
        hiss = random.normal(size=(3, steps, 3)) * np.sqrt(hz)
        rows.append((rate / (1 + s) + b + noise[0] * hiss[0], path.inv().apply(force) + noise[1] * hiss[1],
                     path.inv().apply(FIELD) + noise[2] * np.linalg.norm(FIELD) * hiss[2]))  # fmt: skip
        truth.append((np.roll(path.as_quat(), 1, axis=-1), b, s))
    readings = (np.stack(x).astype("f") for x in zip(*rows, strict=True))
    return complementary.imu(*readings, dt=np.float32(dt)), Truth(*(np.stack(x) for x in zip(*truth, strict=True)))
