"""The passive complementary filter on rotation matrices, one sample after the other, in float64 NumPy.

Written from Santaera 2015, Algorithm 1 (step 8 with dt), with the first samples setting the attitude. The rotation is
a matrix throughout, the exponential is Rodrigues' formula and the projection a singular value decomposition.
"""

import numpy as np

UP = np.array([0.0, 0.0, 1.0])


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def rodrigues(v):
    angle = np.linalg.norm(v)
    if angle < 1e-12:
        return np.eye(3) + skew(v)
    k = skew(v / angle)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def project(matrix):
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt


def level(up):
    """Smallest rotation that turns `up`, as the sensor sees it, to the earth's."""
    axis = np.cross(up, UP)
    sine, cosine = np.linalg.norm(axis), up @ UP
    if sine < 1e-12:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    return rodrigues(axis / sine * np.arctan2(sine, cosine))


def north_up(field):
    """Turn about the vertical that brings a field in earth axes into the north-up plane."""
    return rodrigues(UP * np.arctan2(field[0], field[1]))


def complementary(gyr, acc, mag, dt, gains, masks=None, projection=False):
    """Run the filter.

    gyr, acc, mag (or None): (T, 3); dt: (T,); gains: (K_p, K_i, lambda_acc, lambda_mag); masks: (T, 3) bool.
    Returns the rotation matrices (T, 3, 3), the biases (T, 3) and the innovations (T, 2, 3).
    """
    k_p, k_i, lambda_acc, lambda_mag = gains
    masks = np.ones((len(gyr), 3), bool) if masks is None else masks
    rotation, integral = np.eye(3), np.zeros(3)
    levelled = headed = False
    rotations, biases, errors = [], [], []
    for n in range(len(gyr)):
        has_gyr, has_acc, has_mag = masks[n]
        has_mag = has_mag and mag is not None
        e_acc, e_mag = np.zeros(3), np.zeros(3)
        if levelled:
            if has_acc:
                e_acc = np.cross(acc[n] / np.linalg.norm(acc[n]), rotation.T @ UP)
            if has_mag and headed:
                m = mag[n] / np.linalg.norm(mag[n])
                field = rotation @ m
                e_mag = np.cross(m, rotation.T @ np.array([0.0, np.hypot(field[0], field[1]), field[2]]))
            error = lambda_acc * e_acc + lambda_mag * e_mag
            integral = integral + k_i * error * dt[n]
            omega = k_p * error
            if has_gyr:
                omega = omega + gyr[n] + integral
            if projection:
                rotation = project(rotation + rotation @ skew(omega) * dt[n])
            else:
                rotation = rotation @ rodrigues(omega * dt[n])
        elif has_acc:
            rotation, levelled = level(acc[n] / np.linalg.norm(acc[n])), True
        if levelled and has_mag and not headed:
            rotation, headed = north_up(rotation @ mag[n]) @ rotation, True
        rotations.append(rotation)
        biases.append(-integral)
        errors.append([e_acc, e_mag])
    return np.array(rotations), np.array(biases), np.array(errors)
