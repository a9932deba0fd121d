"""Kalman filter and Rauch-Tung-Striebel smoother of a linear-Gaussian model, in NumPy and loops, float64."""

import numpy as np


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
