"""The Bingham normalizer on S^3 and its moments at 60 digits, and closed forms where three or two are equal."""

from decimal import Decimal, localcontext
from math import factorial

import numpy as np
from reference.ref_von_mises import PI, bessel

HALF = Decimal("0.5")


def _polynomial_product(factors: list[Decimal]) -> list[Decimal]:
    """Coefficients of prod (1 - f z)."""
    out = [Decimal(1)]
    for f in factors:
        out = [a - f * b for a, b in zip([*out, Decimal(0)], [Decimal(0), *out], strict=True)]
    return out


def _integral(lam: list[Decimal], powers: list[Decimal]) -> Decimal:
    """Sum of c_k / Gamma(k + sum powers), c_k the series of prod (1 - lam_i z)^-power_i, for lam_i >= 0.

    f' / f = sum power_i lam_i / (1 - lam_i z) times the product of the denominators is a recurrence of five terms.
    """
    q = _polynomial_product(lam)
    r = [Decimal(0)] * 4
    for i, p in enumerate(powers):
        rest = _polynomial_product(lam[:i] + lam[i + 1 :])
        r = [a + p * lam[i] * b for a, b in zip(r, rest, strict=True)]
    base = int(sum(powers))
    c, total, scale, k = [Decimal(1)], Decimal(0), Decimal(1) / factorial(base - 1), 0
    while True:
        term = c[-1] * scale
        total += term
        if term <= total * Decimal(10) ** -60 and k > 3:
            return total
        new = sum(r[j] * c[-1 - j] for j in range(min(4, len(c))))
        new -= sum(q[j] * (k + 1 - j) * c[-j] for j in range(1, min(5, len(c) + 1)))
        c = [*c[-4:], new / (k + 1)]
        scale /= k + base
        k += 1


def moments(lam: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """log C, E[x_i^2] and the covariance of the squares; up to differences of about 1e4."""
    with localcontext() as context:
        context.prec = 100
        exact = [Decimal(float(x)) for x in lam]
        low = min(exact)
        shifted = [x - low for x in exact]

        def inserted(*indices: int) -> Decimal:
            return _integral(shifted, [HALF + indices.count(i) for i in range(4)])

        whole = inserted()
        second = [inserted(i) / 2 / whole for i in range(4)]
        fourth = [[inserted(i, j) / 4 / whole * (3 if i == j else 1) for j in range(4)] for i in range(4)]
        covariance = [[float(fourth[i][j] - second[i] * second[j]) for j in range(4)] for i in range(4)]
        return float((2 * PI * PI * whole).ln() + low), np.array([float(m) for m in second]), np.array(covariance)


def three_equal(size: float) -> tuple[float, np.ndarray]:
    """log C and moments of lam = (-size, -size, -size, 0): 2 pi^2 e^-s 1F1(1/2; 2; s)."""
    b = bessel(size / 2)
    with localcontext() as context:
        context.prec = 90
        m = (b.complement + b.slope / b.complement) / 6
        log_c = (2 * PI * PI).ln() + b.log_i0e + b.complement.ln()
        return float(log_c), np.array([float(m)] * 3 + [float(1 - 3 * m)])


def one_low(size: float) -> tuple[float, np.ndarray]:
    """log C and moments of lam = (-size, 0, 0, 0): 2 pi^2 1F1(1/2; 2; -s)."""
    b = bessel(size / 2)
    with localcontext() as context:
        context.prec = 90
        m = (b.complement - b.slope / (1 + b.ratio)) / 2
        log_c = (2 * PI * PI).ln() + b.log_i0e + (1 + b.ratio).ln()
        return float(log_c), np.array([float(m)] + [float((1 - m) / 3)] * 3)


def two_equal(size: float) -> tuple[float, np.ndarray]:
    """log C and moments of lam = (-size, -size, 0, 0): 2 pi^2 (1 - e^-s) / s."""
    with localcontext() as context:
        context.prec = 90
        s = Decimal(size)
        m = (1 / s - 1 / (s.exp() - 1)) / 2
        log_c = (2 * PI * PI).ln() + ((1 - (-s).exp()) / s).ln()
        return float(log_c), np.array([float(m)] * 2 + [float(HALF - m)] * 2)
