"""Rotations as a URDF writes them, on the host."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def matrix(quaternion: Any) -> NDArray[np.float64]:
    """Return the rotation matrix (3, 3) of a quaternion (4,) wxyz, of any length but 0."""
    w, x, y, z = np.asarray(quaternion, np.float64) / np.linalg.norm(np.asarray(quaternion, np.float64))
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def turned(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Return the rotation matrix (3, 3) about a unit axis (3,) by an angle in rad."""
    return matrix(np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis]))


def roll_pitch_yaw(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (3,) rad with rotation = Rz(yaw) Ry(pitch) Rx(roll); roll is 0 where only its sum with yaw is known."""
    flat = np.hypot(rotation[0, 0], rotation[1, 0])
    pitch = np.arctan2(-rotation[2, 0], flat)
    if flat < 1e-9:
        return np.array([0.0, pitch, np.arctan2(-rotation[0, 1], rotation[1, 1])])
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    return np.array([roll, pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])


__all__ = ["matrix", "roll_pitch_yaw", "turned"]
