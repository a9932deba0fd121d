"""What a window of two IMUs on one link says: averages that belong to the rates' derivatives.

The derivative of a Savitzky-Golay fit is a weighted mean of the true derivative over the window. The specific forces
and the squares of the rates are averaged with the same weights, so that the filter's response cancels from the equation
of motion and the window's width trades noise only. Sato 2024 evaluates each fit at the centre instead.

Conventions: A is the destination frame, P the other IMU; `R` takes P to A; r is P's place in A.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxest.filters import savitzky_golay as sg
from jaxest.filters._small import outer, product, sandwich
from jaxest.types import Array


class Means(NamedTuple):
    """Averages of one IMU over a window."""

    rate: Array
    """(3,) rad/s"""
    turn: Array
    """(3,) rad/s^2, derivative of the rate."""
    square: Array
    """(3, 3) (rad/s)^2, of rate rate'."""
    force: Array
    """(3,) m/s2"""


class Window(NamedTuple):
    """Averages of both IMUs."""

    a: Means
    p: Means
    gain: Array
    """() variance of an average over that of a sample's white noise."""
    steep: Array
    """() 1/s^2, likewise for the derivative."""
    ready: Array
    """() bool, whether both IMUs have more samples in it than the degree."""


def means(time: Array, value: Array, valid: Array, query: Array, *, degree: int, plain: bool) -> tuple[Means, Array]:
    """Average one IMU.

    Args:
        time: (W,) s, as `savitzky_golay.averaging` wants it.
        value: (W, 6) rate and specific force; where missing, those of the sample before.
        valid: (W,) bool.
        query: () s, the time of the fit.
        degree: of the polynomial, static.
        plain: static, evaluate the fits at the query as the paper does instead of averaging.

    Returns:
        The averages, and (3,): their gain, the derivative's, and the number of samples.
    """
    fit = sg.weights(time, valid, query, degree=degree)
    w = fit.value if plain else sg.averaging(time, fit.derivative)
    rate = value[:, :3]
    pairs = jnp.concatenate([rate * rate, rate * jnp.roll(rate, -1, axis=1)], axis=1)
    sums = product(jnp.stack([w, fit.derivative]), jnp.concatenate([value, pairs], axis=1))
    averaged, turn = sums[0, :6], sums[1, :3]
    xx, yy, zz, xy, yz, zx = sums[0, 6:]
    square = jnp.stack([xx, xy, zx, xy, yy, yz, zx, yz, zz]).reshape(3, 3)
    square = outer(averaged[:3], averaged[:3]) if plain else square
    numbers = jnp.stack([jnp.sum(w * w), jnp.sum(fit.derivative**2), fit.samples.astype(value.dtype)])
    return Means(averaged[:3], turn, square, averaged[3:]), numbers


def combine(a: tuple[Means, Array], p: tuple[Means, Array], degree: int) -> Window:
    """Put the averages of both IMUs together, the gains by their mean."""
    gain, steep, _ = (a[1] + p[1]) / 2
    return Window(a[0], p[0], gain, steep, jnp.minimum(a[1][2], p[1][2]) > degree)


def spin(imu: Means, bias: Array) -> Array:
    """Return the mean (3, 3) of [w x]^2 + [dw/dt x] for rates that read `bias` (3,) too much.

    Source: Sato 2024, eq. 7.
    """
    mixed = outer(imu.rate, bias)
    square = imu.square - mixed - mixed.T + outer(bias, bias)
    x, y, z = imu.turn
    zero = jnp.zeros_like(x)
    turn = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    return square - jnp.trace(square) * jnp.eye(3, dtype=turn.dtype) + turn


def regressor(window: Window, rotation: Array, bias_a: Array, bias_p: Array, noise: Array) -> Array:
    """Return what takes r (3,) to the difference of specific forces, (3, 3), corrected for noise.

    Args:
        window: the averages.
        rotation: (3, 3) R.
        bias_a: (3,) rad/s, of IMU A's gyro.
        bias_p: (3,) rad/s, of P's, in P's frame.
        noise: (3, 3) (rad/s)^2, covariance in the squares' rates of the noise of w_A - R w_P.

    Source: Sato 2024, eqs. 11, 13 and 15.
    """
    mean = (spin(window.a, bias_a) + sandwich(rotation, spin(window.p, bias_p))) / 2
    return mean + turning_noise(noise) / 2


def turning_noise(covariance: Array) -> Array:
    """Return E[[n x]' [n x]] = -E[[n x]^2] for n of a covariance (3, 3)."""
    return jnp.trace(covariance) * jnp.eye(3, dtype=covariance.dtype) - covariance
