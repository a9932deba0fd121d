"""Kalman filter and Rauch-Tung-Striebel smoother of a linear-Gaussian model, in NumPy and loops, float64."""

from fractions import Fraction

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation


def kalman_filter(f, q, h, r, mean, cov, values, valid):
    """F, Q: (n, n); H: (m, n); R: (m, m); values, valid: (T, m). Returns a dict of arrays with a leading T."""
    out = {name: [] for name in ("mean", "cov", "ahead_mean", "ahead_cov", "density", "nis")}
    for value, there in zip(values, valid, strict=True):
        mean, cov = f @ mean, f @ cov @ f.T + q
        out["ahead_mean"].append(mean)
        out["ahead_cov"].append(cov)
        rows = np.flatnonzero(there)
        density, nis = 0.0, 0.0
        if len(rows):
            hv = h[rows]
            s = hv @ cov @ hv.T + r[np.ix_(rows, rows)]
            z = value[rows] - hv @ mean
            gain = cov @ hv.T @ np.linalg.inv(s)
            nis = z @ np.linalg.solve(s, z)
            density = -0.5 * (nis + np.linalg.slogdet(s)[1] + len(rows) * np.log(2 * np.pi))
            mean = mean + gain @ z
            cov = cov - gain @ s @ gain.T
        for name, number in (("mean", mean), ("cov", cov), ("density", density), ("nis", nis)):
            out[name].append(number)
    return {name: np.array(rows) for name, rows in out.items()}


def rts_smoother(f, q, h, r, mean, cov, values, valid):
    """Returns smoothed means (T + 1, n) and covariances (T + 1, n, n), the state before the first step first."""
    out = kalman_filter(f, q, h, r, mean, cov, values, valid)
    means, covs = [mean, *out["mean"]], [cov, *out["cov"]]
    for k in range(len(values) - 1, -1, -1):
        gain = covs[k] @ f.T @ np.linalg.inv(out["ahead_cov"][k])
        means[k] = means[k] + gain @ (means[k + 1] - out["ahead_mean"][k])
        covs[k] = covs[k] + gain @ (covs[k + 1] - out["ahead_cov"][k]) @ gain.T
    return np.array(means), np.array(covs)


def batch_solve(f, q, h, r, mean, cov, values, valid):
    """The whole series as one weighted least-squares problem, by a QR of all its equations: means, covariances."""
    n, steps = len(mean), len(values)
    rows, right = [], []

    def add(blocks, value, noise):
        root = np.linalg.inv(np.linalg.cholesky(noise))
        row = np.zeros((len(value), n * (steps + 1)))
        for k, block in blocks:
            row[:, n * k : n * (k + 1)] = block
        rows.append(root @ row)
        right.append(root @ value)

    add([(0, np.eye(n))], mean, cov)
    for k, (value, there) in enumerate(zip(values, valid, strict=True)):
        add([(k, -f), (k + 1, np.eye(n))], np.zeros(n), q)
        some = np.flatnonzero(there)
        if len(some):
            add([(k + 1, h[some])], value[some], r[np.ix_(some, some)])
    orthogonal, upper = np.linalg.qr(np.vstack(rows))
    inverse = np.linalg.inv(upper)
    means = (inverse @ (orthogonal.T @ np.concatenate(right))).reshape(steps + 1, n)
    covs = inverse @ inverse.T
    return means, np.array([covs[n * k : n * (k + 1), n * k : n * (k + 1)] for k in range(steps + 1)])


def exact_smoother(f, q, h, r, mean, cov, values):
    """RTS in rational numbers, no rounding at all: means (T + 1, n), covariances (T + 1, n, n) as float64."""
    f, q, h, r, mean, cov, values = (_fractions(a) for a in (f, q, h, r, mean, cov, values))
    means, covs, ahead = [mean], [cov], []
    for value in values:
        mean, cov = f @ means[-1], f @ covs[-1] @ f.T + q
        ahead.append((mean, cov))
        gain = cov @ h.T @ _inverse(h @ cov @ h.T + r)
        means.append(mean + gain @ (value - h @ mean))
        covs.append(cov - gain @ h @ cov)
    for k in range(len(values) - 1, -1, -1):
        gain = covs[k] @ f.T @ _inverse(ahead[k][1])
        means[k] = means[k] + gain @ (means[k + 1] - ahead[k][0])
        covs[k] = covs[k] + gain @ (covs[k + 1] - ahead[k][1]) @ gain.T
    return np.array(means).astype(float), np.array(covs).astype(float)


def _fractions(array):
    return np.vectorize(Fraction, otypes=[object])(np.asarray(array, float))


def _inverse(matrix):
    n = len(matrix)
    both = np.concatenate([matrix, _fractions(np.eye(n))], axis=1)
    for j in range(n):
        pivot = next(i for i in range(j, n) if both[i, j] != 0)
        both[[j, pivot]] = both[[pivot, j]]
        both[j] = both[j] / both[j, j]
        for i in range(n):
            if i != j:
                both[i] = both[i] - both[i, j] * both[j]
    return both[:, n:]


def differences(function, x, h=1e-5):
    """Jacobian by central differences, column by column."""
    columns = []
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = h
        columns.append((function(x + step) - function(x - step)) / (2 * h))
    return np.stack(columns, axis=1)


def gauss_newton(residuals, size, steps=30):
    """The v (size,) of least squares of the whitened `residuals(v)`, started at zero."""
    v = np.zeros(size)
    for _ in range(steps):
        move = np.linalg.lstsq(differences(residuals, v), -residuals(v), rcond=None)[0]
        v = v + move
        if np.abs(move).max() < 1e-12:
            break
    return v


def rotated(q, p):
    """Scipy's rotation of a wxyz quaternion, applied to p."""
    return rotation(q).apply(p)


def rotation(q):
    return Rotation.from_quat(np.roll(q, -1))


def se3_exp(v):
    """(rotation, translation) of a twist [rotation, translation], by the series of the matrix exponential."""
    x, y, z = v[:3]
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    twist[:3, 3] = v[3:]
    matrix = expm(twist)
    return Rotation.from_matrix(matrix[:3, :3]), matrix[:3, 3]


def se3_log(turn, shift):
    """The twist of a motion, its translation by solving with exp's left Jacobian, a series."""
    phi = turn.as_rotvec()
    x, y, z = phi
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    term, jacobian = np.eye(3), np.eye(3)
    for k in range(2, 40):
        term = term @ skew / k
        jacobian = jacobian + term
    return np.concatenate([phi, np.linalg.solve(jacobian, shift)])
