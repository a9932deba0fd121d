"""The pair filter and the posture of an arm as one would write them in NumPy with MuJoCo: peers of the benchmark."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[Any]


def pairs(samples: Any, edges: Sequence[tuple[int, int]], gains: tuple[float, float] = (1.0, 0.01)) -> Matrix:
    """Run the filter of IMU pairs with magnetometers over one recording.

    Args:
        samples: `imu.Imu`, leaves (T, n, ...), all valid.
        edges: first and second IMU of each pair.
        gains: proportional, 1/s, and integral, 1/s^2.

    Returns:
        Rotations (e, 3, 3), second IMU to first, at the end.
    """
    gyr, acc, mag, dt = _read(samples)
    rotation = [_triad(acc[0, i], mag[0, i]).T @ _triad(acc[0, j], mag[0, j]) for i, j in edges]
    bias = np.zeros(gyr.shape[1:])
    for t in range(1, len(dt)):
        drift = np.zeros_like(bias)
        for e, (i, j) in enumerate(edges):
            r = rotation[e]
            error = np.cross(acc[t, j], r.T @ acc[t, i]) + np.cross(mag[t, j], r.T @ mag[t, i])
            rate = gyr[t, j] - bias[j] - r.T @ (gyr[t, i] - bias[i]) + gains[0] * error
            drift[j] += error
            drift[i] -= r @ error
            rotation[e] = r @ _turn(rate * dt[t])
        bias -= gains[1] * dt[t] * drift
    return np.array(rotation)


def posture(model: Any, sites: Sequence[int], samples: Any, gains: tuple[float, float] = (0.74, 0.0012)) -> Matrix:
    """Follow a robot by a complementary filter an IMU, and two Gauss-Newton steps on its joints a sample.

    Args:
        model: `mujoco.MjModel`, without coupled joints.
        sites: where the IMUs are.
        samples: `imu.Imu`, leaves (T, n, ...), all valid, with magnetometers.
        gains: proportional, 1/s, and integral, 1/s^2.

    Returns:
        (T, nq)
    """
    import mujoco

    gyr, acc, mag, dt = _read(samples)
    data, turning = mujoco.MjData(model), np.zeros((3, model.nv))
    rotation = [_triad(a, m) for a, m in zip(acc[0], mag[0], strict=True)]
    bias, found = np.zeros(gyr.shape[1:]), []
    for t in range(len(dt)):
        for k, r in enumerate(rotation):
            field = r @ mag[t, k]
            level = np.array([0, np.hypot(field[0], field[1]), field[2]])
            error = np.cross(acc[t, k], r[2]) + np.cross(mag[t, k], r.T @ level)
            rotation[k] = r @ _turn((gyr[t, k] - bias[k] + gains[0] * error) * dt[t])
            bias[k] -= gains[1] * dt[t] * error
        for _ in range(2):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            square, pull = 1e-4 * np.eye(model.nv), np.zeros(model.nv)
            for k, site in enumerate(sites):
                mujoco.mj_jacSite(model, data, None, turning, site)
                off = _vector(rotation[k] @ data.site_xmat[site].reshape(3, 3).T)
                square += turning.T @ turning
                pull += turning.T @ off
            mujoco.mj_integratePos(model, data.qpos, np.linalg.solve(square, pull), 1.0)
        found.append(data.qpos.copy())
    return np.array(found)


def _read(samples: Any) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    gyr, acc, mag = (np.asarray(reading.value, np.float64) for reading in samples[:3])
    acc, mag = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (acc, mag))
    return gyr, acc, mag, np.asarray(samples.dt, np.float64)


def _triad(up: Matrix, field: Matrix) -> Matrix:
    """Sensor to earth, rows east, north, up."""
    east = np.cross(field, up)
    east = east / np.linalg.norm(east)
    return np.stack([east, np.cross(up, east), up])


def _turn(vector: Matrix) -> Matrix:
    """Rotation of a rotation vector (3,)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    one: Matrix = np.sinc(angle / np.pi) * skew + np.sinc(angle / (2 * np.pi)) ** 2 / 2 * skew @ skew
    return np.eye(3) + one


def _vector(r: Matrix) -> Matrix:
    """Rotation vector (3,) of a rotation by less than half a turn."""
    skew = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2
    sine = float(np.linalg.norm(skew))
    return skew * (np.arctan2(sine, (np.trace(r) - 1) / 2) / sine if sine > 1e-12 else 1.0)
