"""The integral of a Bingham density over the unit sphere S^3 and its moments, by inverting a Laplace transform.

With a_i = max lam - lam_i >= 0 the integral of exp(-sum a_i x_i^2) over S^3 is 2 pi^2 times the inverse transform, at
time 1, of prod (s + a_i)^(-1/2); a moment E[x_i^2] inserts 1 / (2 (s + a_i)) and divides. No eigenvalues are subtracted
from one another, so equal ones are no special case. Each factor is scaled to z_i = (s + a_i) / (1 + a_i) =
1 + (s - 1) / (1 + a_i), which neither overflows nor underflows up to a_i = inf; the scales leave as logarithms.

Complex numbers are pairs of real ones, for XLA on CPU does not vectorise the others. The nodes are scanned with scalar
carries: unrolled they take ten times as long to compile and twice as long to run, as an axis of the arrays twice as
long (measured: 2048 evaluations of integral and moments, one core).
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.types import Array

Complex = tuple[Array, Array]
PAIRS = tuple((i, j) for i in range(4) for j in range(i, 4))

_COUNT = {"float32": 16, "float64": 28}  # more nodes gain no truncation error that roundings do not take back


def nodes(dtype: np.dtype) -> tuple[np.ndarray, ...]:
    """Return the nodes and weights of the modified Talbot contour, (N/2,) each: Re s, Im s, Re c, Im c.

    Args:
        dtype: float32 (16 nodes) or any other precision (28).

    Returns:
        Nodes s and weights c with f(1) = Re sum c F(s), for a transform F that is real on the real axis.

    Source: Dingfelder and Weideman 2015 (Improved contour integral methods for parabolic PDEs), with their constants;
    s = N (0.5017 t cot(0.6407 t) - 0.6122 + 0.2645 i t) at t = pi (2 k + 1) / N.
    """
    n = _COUNT.get(np.dtype(dtype).name, 28)
    t = np.pi * (2 * np.arange(n // 2, dtype=np.longdouble) + 1) / n
    cot = 1 / np.tan(0.6407 * t)
    s = n * (0.5017 * t * cot - 0.6122 + 0.2645j * t)
    slope = n * (0.5017 * (cot - 0.6407 * t * (1 + cot**2)) + 0.2645j)
    c = -2j / n * np.exp(s) * slope  # the terms cancel by a factor of a hundred: hence the extended precision
    return tuple(np.asarray(x, dtype) for x in (s.real, s.imag, c.real, c.imag))


def _times(a: Complex, b: Complex) -> Complex:
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _inverse_root(z: Complex) -> Complex:
    """Return z^(-1/2), the principal branch, for Im z > 0 and without cancellation.

    The root is taken of each factor, never of their product, whose argument would leave the principal branch.
    """
    x, y = z
    length = jnp.sqrt(x * x + y * y)
    larger = jnp.sqrt((length + jnp.abs(x)) * 0.5)
    smaller = y / (2 * larger)
    right = x >= 0
    return jnp.where(right, larger, smaller) / length, jnp.where(right, -smaller, -larger) / length


def _inverse(z: Complex) -> Complex:
    square = z[0] * z[0] + z[1] * z[1]
    return z[0] / square, -z[1] / square


@functools.partial(jax.jit, static_argnums=1)
def integrals(lam: Array, order: int) -> tuple[Array, Array | None, Array | None]:
    """Return the normalizer and the moments of the density exp(sum lam_i x_i^2) on S^3.

    Args:
        lam: (..., 4) concentrations, of any order; equal ones and a common shift are no exception.
        order: 0 for the normalizer, 1 for second moments too, 2 for fourth moments too; static.

    Returns:
        log C (...), E[x_i^2] (..., 4) summing to 1, E[x_i^2 x_j^2] (..., 4, 4); None beyond `order`.

    Source: modified Talbot inversion of prod (s - lam_i)^(-1/2).
    """
    dtype = lam.dtype
    largest = jnp.max(lam, axis=-1)
    ratio = 1 / (1 + (largest[..., None] - lam))
    r = [jnp.squeeze(x, -1) for x in jax.lax.split(ratio, (1, 1, 1, 1), axis=lam.ndim - 1)]

    def body(sums: tuple[Array, ...], node: tuple[Array, ...]) -> tuple[tuple[Array, ...], None]:
        x, y, *weight = node
        z = [(1 + (x - 1) * scale, y * scale) for scale in r]
        w: Complex = (weight[0], weight[1])
        for factor in z:
            w = _times(w, _inverse_root(factor))
        terms = [w[0]]
        if order >= 1:
            inverses = [_inverse(factor) for factor in z]
            first = [_times(w, inverse) for inverse in inverses]
            terms += [value[0] for value in first]
        if order >= 2:
            terms += [_times(first[i], inverses[j])[0] for i, j in PAIRS]
        return tuple(total + term for total, term in zip(sums, terms, strict=True)), None

    zero = jnp.zeros(lam.shape[:-1], dtype)
    start = (zero,) * (1, 5, 5 + len(PAIRS))[order]
    sums, _ = jax.lax.scan(body, start, tuple(jnp.asarray(x) for x in nodes(dtype)))
    area = float(np.log(2 * np.pi**2))
    log_c = largest + (area + jnp.log(sums[0]) + 0.5 * jnp.sum(jnp.log(ratio), axis=-1))
    if order == 0:
        return log_c, None, None
    second = jnp.stack(sums[1:5], axis=-1) * ratio
    trace = jnp.sum(second, axis=-1, keepdims=True)  # twice the integral; its roundings partly cancel the moments'
    second = second / trace
    if order == 1:
        return log_c, second, None
    half = 0.5 / trace[..., 0]
    pairs = {
        (i, j): (3 if i == j else 1) * r[i] * r[j] * half * value for (i, j), value in zip(PAIRS, sums[5:], strict=True)
    }
    rows = [jnp.stack([pairs[min(i, j), max(i, j)] for j in range(4)], axis=-1) for i in range(4)]
    return log_c, second, jnp.stack(rows, axis=-2)
