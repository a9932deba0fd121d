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
    """() bool, whether it has more samples of both IMUs than the degree."""


def read(time: Array, value: Array, valid: Array, query: Array, *, degree: int, plain: bool) -> Window:
    """Average both IMUs over one window, with the same weights, so that no response of the filter is left between them.

    Args:
        time: (W,) s, as `savitzky_golay.averaging` wants it.
        value: (W, 12) rates of A and of P, then their specific forces; where missing, those of the sample before.
        valid: (W,) bool, whether both IMUs' samples are there.
        query: () s, the time of the fit.
        degree: of the polynomial, static.
        plain: static, evaluate the fits at the query as the paper does instead of averaging.

    Returns:
        The averages.
    """
    fit = sg.weights(time, valid, query, degree=degree)
    w = fit.value if plain else sg.averaging(time, fit.derivative)
    rates = value[:, :6]
    shifted = jnp.roll(rates.reshape(-1, 2, 3), -1, axis=2).reshape(-1, 6)
    pairs = jnp.concatenate([value, rates * rates, rates * shifted], axis=1)
    sums = product(jnp.stack([w, fit.derivative]), pairs)
    a, p = (_means(sums, 3 * side, plain) for side in (0, 1))
    return Window(a, p, jnp.sum(w * w), jnp.sum(fit.derivative**2), fit.samples > degree)


def _means(sums: Array, at: int, plain: bool) -> Means:
    """One IMU's averages from the sums (2, 24), its first column `at`."""
    rate, force, same, mixed = (sums[0, k + at : k + at + 3] for k in (0, 6, 12, 18))
    xx, yy, zz = same
    xy, yz, zx = mixed
    square = jnp.stack([xx, xy, zx, xy, yy, yz, zx, yz, zz]).reshape(3, 3)
    return Means(rate, sums[1, at : at + 3], outer(rate, rate) if plain else square, force)


def bent(window: Window, off: Array) -> Window:
    """Return what sensors would say whose axes are off by `off` (4, 3, 3): gyros A and P, accelerometers A and P."""
    sides = []
    for imu, gyro, acc in zip((window.a, window.p), off[:2], off[2:], strict=True):
        gyro, acc = (jnp.eye(3, dtype=off.dtype) + x for x in (gyro, acc))
        rate, turn = (jnp.sum(gyro * x[None, :], axis=1) for x in (imu.rate, imu.turn))
        sides.append(Means(rate, turn, sandwich(gyro, imu.square), jnp.sum(acc * imu.force[None, :], axis=1)))
    return window._replace(a=sides[0], p=sides[1])


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
