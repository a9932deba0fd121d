"""Slow references for rotations and rigid motions: decimal arithmetic and matrix series in extended precision."""

from decimal import Decimal, localcontext

import numpy as np

PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899862803482534")


def _sin_cos(t: Decimal) -> tuple[Decimal, Decimal]:
    sums, term, n = [Decimal(0), Decimal(0)], Decimal(1), 0
    while n < 4 or abs(term) > Decimal(10) ** -150:
        sums[n % 2] += term * (-1) ** (n // 2)
        n += 1
        term = term * t / n
    return sums[1], sums[0]


def _cos_half(t):
    return _sin_cos(t / 2)[1]


def _sin_half(t):
    return _sin_cos(t / 2)[0] / t


def _one_minus_cos(t):
    return (1 - _sin_cos(t)[1]) / t**2


def _t_minus_sin(t):
    return (t - _sin_cos(t)[0]) / t**3


def _inverse_jacobian(t):
    sine, cosine = _sin_cos(t / 2)
    return (1 - t / 2 * cosine / sine) / t**2


CLOSED_FORMS = {
    "cos_half": _cos_half,
    "sin_half": _sin_half,
    "one_minus_cos": _one_minus_cos,
    "t_minus_sin": _t_minus_sin,
    "inverse_jacobian": _inverse_jacobian,
}


def coefficient(name: str, s: float) -> tuple[float, float, float]:
    """Value, first and second derivative in s = t^2 of a closed form, by differences at 150 digits."""
    with localcontext() as context:
        context.prec = 150
        exact = Decimal(s)
        h = exact * Decimal(10) ** -12
        low, mid, high = (CLOSED_FORMS[name]((exact + k * h).sqrt()) for k in (-1, 0, 1))
        return float(mid), float((high - low) / (2 * h)), float((high - 2 * mid + low) / h**2)


def wrap(angle: float) -> float:
    """An angle brought into [-pi, pi) at 60 digits."""
    with localcontext() as context:
        context.prec = 60
        turns = (Decimal(angle) + PI) / (2 * PI)
        return float(Decimal(angle) - 2 * PI * turns.to_integral_value(rounding="ROUND_FLOOR"))


def hat(v: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) of a rotation vector or (4, 4) of a twist [rotation, translation]."""
    x, y, z = v[:3]
    turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if len(v) == 3:
        return turn
    out = np.zeros((4, 4), v.dtype)
    out[:3, :3], out[:3, 3] = turn, v[3:]
    return out


def small_adjoint(v: np.ndarray) -> np.ndarray:
    """The matrix of [v, .]: (3, 3) of a rotation vector or (6, 6) of a twist [rotation, translation]."""
    if len(v) == 3:
        return hat(v)
    out = np.zeros((6, 6), v.dtype)
    out[:3, :3] = out[3:, 3:] = hat(v[:3])
    out[3:, :3] = hat(v[3:])
    return out


def series(a: np.ndarray, first: int) -> np.ndarray:
    """Sum of a^n / (n + first)! in extended precision: exp for first = 0, exp's left Jacobian for first = 1."""
    a = a.astype(np.longdouble)
    term = np.eye(len(a), dtype=np.longdouble)
    total = np.zeros_like(term)
    for n in range(first, 60 + first):
        total += term
        term = term @ a / (n + 1)
    return total


def expm(v: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) of a rotation vector or the motion (4, 4) of a twist."""
    return series(hat(v.astype(np.longdouble)), 0)


def left_jacobian(v: np.ndarray) -> np.ndarray:
    """The left Jacobian (3, 3) or (6, 6) of exp."""
    return series(small_adjoint(v.astype(np.longdouble)), 1)


def hamilton(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton product of quaternions wxyz (..., 4)."""
    (a, b, c, d), (e, f, g, h) = np.moveaxis(p, -1, 0), np.moveaxis(q, -1, 0)
    return np.stack(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g + c * e + d * f - b * h,
            a * h + d * e + b * g - c * f,
        ],
        axis=-1,
    )


def rotation_vector(q: np.ndarray) -> np.ndarray:
    """The shorter rotation vector of a quaternion wxyz, float64."""
    length = np.linalg.norm(q[1:])
    if length == 0:
        return np.zeros(3)
    return 2 * np.arctan2(length, abs(q[0])) * np.copysign(1, q[0]) / length * q[1:]


def rotation_mean(qs: np.ndarray, weights: np.ndarray, steps: int = 300) -> np.ndarray:
    """Weighted Frechet mean of quaternions (N, 4) by plain gradient steps from the heaviest sample."""
    mean = qs[np.argmax(weights)]
    for _ in range(steps):
        step = np.zeros(3)
        for q, weight in zip(qs, weights / weights.sum(), strict=True):
            step += weight * rotation_vector(hamilton(mean * [1, -1, -1, -1], q))
        angle = np.linalg.norm(step)
        mean = hamilton(mean, np.concatenate([[np.cos(angle / 2)], np.sinc(angle / 2 / np.pi) * step / 2]))
        mean /= np.linalg.norm(mean)
    return mean


def quaternion_exp(v: np.ndarray) -> np.ndarray:
    """The quaternion wxyz of a rotation vector, float64 from extended precision."""
    v = v.astype(np.longdouble)
    angle = np.sqrt(v @ v)
    factor = np.sin(angle / 2) / angle if angle > 0 else np.longdouble(0.5)
    return np.array([np.cos(angle / 2), *(factor * v)], np.float64)


def quaternion_matrix(q: np.ndarray) -> np.ndarray:
    """The rotation matrices (..., 3, 3) of unit quaternions wxyz, column by column."""
    conjugate = q * [1, -1, -1, -1]
    columns = [hamilton(hamilton(q, np.broadcast_to([0, *e], q.shape)), conjugate)[..., 1:] for e in np.eye(3)]
    return np.stack(columns, axis=-1)
