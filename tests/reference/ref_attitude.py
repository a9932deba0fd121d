"""Loops in float64 NumPy for the attitude filters: Madgwick's as printed, and a low-pass by matrix exponentials."""

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

TURN = np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])  # from x north, y west to x east, y north


def times(a, b):
    w, x, y, z = a
    p, q, r, s = b
    return np.array([w * p - x * q - y * r - z * s, w * q + x * p + y * s - z * r,
                     w * r - x * s + y * p + z * q, w * s + x * r - y * q + z * p])  # fmt: skip


def conjugate(q):
    return q * [1, -1, -1, -1]


def rotate(q, v):
    return times(times(q, np.concatenate([[0], v])), conjugate(q))[1:]


def unit(v):
    return v / np.linalg.norm(v)


def first(acc, mag):
    """Orientation (x north) that the first samples set: upright by the shortest way, then turned to the north."""
    axis = np.cross(unit(acc), [0, 0, 1])
    angle = np.arctan2(np.linalg.norm(axis), unit(acc)[2])
    level = np.roll(Rotation.from_rotvec(angle * unit(axis)).as_quat(), 1)
    if mag is None:
        return times(conjugate(TURN), level)
    h = rotate(level, mag)
    turn = -np.arctan2(h[1], h[0])
    return times(np.array([np.cos(turn / 2), 0, 0, np.sin(turn / 2)]), level)


def madgwick(gyr, acc, mag, dt, beta, masks):
    """Madgwick 2010, appendix, with the paper's matrices (x north); mag may be None. Returns (T, 4) wxyz in ENU."""
    q, out = None, []
    for n in range(len(gyr)):
        has_gyr, has_acc, has_mag = masks[n]
        if q is None:
            q = first(acc[n], None if mag is None else mag[n])  # the first sample has everything
            out.append(times(TURN, q))
            continue
        q1, q2, q3, q4 = q
        gradient = np.zeros(4)
        if has_acc:
            a = unit(acc[n])
            f = [2 * (q2 * q4 - q1 * q3) - a[0], 2 * (q1 * q2 + q3 * q4) - a[1], 2 * (0.5 - q2**2 - q3**2) - a[2]]
            j = [[-2 * q3, 2 * q4, -2 * q1, 2 * q2], [2 * q2, 2 * q1, 2 * q4, 2 * q3], [0, -4 * q2, -4 * q3, 0]]
            gradient = gradient + np.transpose(j) @ f
        if has_mag and mag is not None:
            m = unit(mag[n])
            h = rotate(q, m)
            bx, bz = np.hypot(h[0], h[1]), h[2]
            f = [
                2 * bx * (0.5 - q3**2 - q4**2) + 2 * bz * (q2 * q4 - q1 * q3) - m[0],
                2 * bx * (q2 * q3 - q1 * q4) + 2 * bz * (q1 * q2 + q3 * q4) - m[1],
                2 * bx * (q1 * q3 + q2 * q4) + 2 * bz * (0.5 - q2**2 - q3**2) - m[2],
            ]
            j = [
                [-2 * bz * q3, 2 * bz * q4, -4 * bx * q3 - 2 * bz * q1, -4 * bx * q4 + 2 * bz * q2],
                [-2 * bx * q4 + 2 * bz * q2, 2 * bx * q3 + 2 * bz * q1, 2 * bx * q2 + 2 * bz * q4,
                 -2 * bx * q1 + 2 * bz * q3],
                [2 * bx * q3, 2 * bx * q4 - 4 * bz * q2, 2 * bx * q1 - 4 * bz * q3, 2 * bx * q2],
            ]  # fmt: skip
            gradient = gradient + np.transpose(j) @ f
        rate = 0.5 * times(q, np.concatenate([[0], gyr[n] if has_gyr else np.zeros(3)]))
        if np.linalg.norm(gradient) > 0:
            rate = rate - beta * unit(gradient)
        q = unit(q + rate * dt[n])
        out.append(times(TURN, q))
    return np.array(out)


def lowpass(samples, dt, tau):
    """Second-order Butterworth at a cutoff of sqrt(2) / tau, inputs held over each step; a plain mean before tau."""
    w = np.sqrt(2) / tau
    a = np.array([[0, 1], [-w * w, -np.sqrt(2) * w]])
    time, value, state, out = 0.0, samples[0], None, []
    for n, sample in enumerate(samples):
        if n and time < tau:
            value = (value * time + sample * dt[n]) / (time + dt[n])
            state = np.array([value, 0 * value])
        elif n:
            target = np.array([sample, 0 * sample])
            state = target + expm(a * dt[n]) @ (state - target)
            value = state[0]
        time += dt[n]
        out.append(value)
    return np.array(out)
