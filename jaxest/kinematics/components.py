"""Rotations and vectors as tuples of scalars, one array per component.

`vmap` then lays a batch of each component out contiguously, which XLA on CPU turns into straight vector code; the
arrays of shape (4,) in `jaxest.manifolds.quaternion` would interleave the components. Works on NumPy and JAX arrays
alike, of any one shape per call.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.types import Array

Scalar = Any
Vector = tuple[Scalar, ...]
Quaternion = tuple[Scalar, ...]

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def sub(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(a: Vector, s: Scalar) -> Vector:
    """Return s a."""
    return a[0] * s, a[1] * s, a[2] * s


def dot(a: Vector, b: Vector) -> Scalar:
    """Return the inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return the Hamilton product of two quaternions wxyz."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


def rotate(q: Quaternion, v: Vector) -> Vector:
    """Return R(q) v."""
    u = (q[1], q[2], q[3])
    t = scale(cross(u, v), 2)
    return add(add(v, scale(t, q[0])), cross(u, t))


def rotate_back(q: Quaternion, v: Vector) -> Vector:
    """Return R(q)^T v."""
    return rotate(conjugate(q), v)


def local_rate(q: Quaternion, dq: Quaternion) -> Vector:
    """Return the rotation vector rate in the body that moves the unit quaternion q by dq."""
    d = multiply(conjugate(q), dq)
    return 2 * d[1], 2 * d[2], 2 * d[3]


def split(array: Any) -> tuple[Any, ...]:
    """Return the components of the last axis as a tuple."""
    return tuple(array[..., i] for i in range(array.shape[-1]))


# sin(r) / r and cos(r) as polynomials in r^2 on |r| <= pi / 2, fitted to 7e-9 and 4e-10: below half an ulp of float32.
_SIN = (-1.66666660e-01, 8.33324220e-03, -1.98227368e-04, 2.63472389e-06)
_COS = (-5.00000000e-01, 4.16666594e-02, -1.38886514e-03, 2.47745536e-05, -2.62967920e-07)
_PI = (3.140625, 9.67502593994140625e-4, 1.509957990978376432e-7)  # few bits each, so that k * part is exact


def _polynomial(coefficients: tuple[float, ...], z: Array) -> Array:
    value = jnp.full_like(z, coefficients[-1])
    for c in coefficients[-2::-1]:
        value = value * z + c
    return value


@jax.custom_jvp
def half_sincos(angle: Array) -> tuple[Array, Array]:
    """Return sin(angle / 2) and cos(angle / 2).

    In float32 by polynomials after reduction by pi: XLA on CPU calls the C library element by element otherwise, which
    costs three times as much and more than the rest of a link. Absolute error at most 2 ulp of 1 for |angle| up to
    1e4 rad; beyond, the error stays below that of the angle's own rounding. Other precisions use `jnp.sin`, `jnp.cos`.

    Args:
        angle: any shape, radians.

    Returns:
        sine and cosine of the half angle, the shape of `angle`.
    """
    if angle.dtype != jnp.float32:
        return jnp.sin(angle / 2), jnp.cos(angle / 2)
    f32 = np.float32
    k = jnp.floor(angle * f32(0.5 / np.pi) + f32(0.5))
    r = angle * f32(0.5)
    for part in _PI:
        r = r - k * f32(part)
    z = r * r
    half = k * f32(0.5)
    sign = 1 - 4 * (half - jnp.floor(half))  # (-1)^k
    return sign * (r + r * z * _polynomial(_SIN, z)), sign * (1 + z * _polynomial(_COS, z))


@half_sincos.defjvp
def _half_sincos_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    sine, cosine = half_sincos(*primals)
    half = tangents[0] / 2
    return (sine, cosine), (cosine * half, -sine * half)
