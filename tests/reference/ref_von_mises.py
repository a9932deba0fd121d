"""I0 and I1 at 60 digits: power series up to k = 80, asymptotic series beyond."""

from decimal import Decimal, localcontext
from typing import NamedTuple


class Bessel(NamedTuple):
    """What a von Mises distribution of concentration k needs."""

    log_i0e: Decimal
    ratio: Decimal
    complement: Decimal
    slope: Decimal


def _series(k: Decimal) -> tuple[Decimal, Decimal]:
    """I0 and I1 by their power series."""
    i0, i1, term, j = Decimal(0), Decimal(0), Decimal(1), 0
    while term > i0 * Decimal(10) ** -80:
        i0, i1, j = i0 + term, i1 + term / (j + 1), j + 1
        term = term * k * k / 4 / (j * j)
    return i0, k / 2 * i1


def _asymptotic(order: int, k: Decimal) -> Decimal:
    """I_order(k) e^-k sqrt(2 pi k), summed until its terms vanish; the smallest is about e^-2k."""
    total, term, j = Decimal(0), Decimal(1), 0
    while abs(term) > Decimal(10) ** -65:
        total, j = total + term, j + 1
        term = -term * (4 * order * order - (2 * j - 1) ** 2) / (j * 8 * k)
    return total


PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899862803482534")


def bessel(k: float) -> Bessel:
    """log(I0 e^-k), I1/I0, 1 - I1/I0 and the derivative of I1/I0."""
    with localcontext() as context:
        context.prec = 90
        exact = Decimal(k)
        if k == 0:
            return Bessel(Decimal(0), Decimal(0), Decimal(1), Decimal("0.5"))
        if k <= 80:
            i0, i1 = _series(exact)
            log_i0e = i0.ln() - exact
        else:
            i0, i1 = _asymptotic(0, exact), _asymptotic(1, exact)
            log_i0e = i0.ln() - (2 * PI * exact).ln() / 2
        ratio = i1 / i0
        return Bessel(log_i0e, ratio, (i0 - i1) / i0, 1 - ratio / exact - ratio * ratio)


def entropy(k: float) -> float:
    """Differential entropy in nat."""
    with localcontext() as context:
        context.prec = 90
        b = bessel(k)
        return float((2 * PI).ln() + b.log_i0e + Decimal(k) * b.complement)
