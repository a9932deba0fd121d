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
    """() variance of an average over that of a sample's white noise, the mean of both IMUs'."""
    steep: Array
    """() 1/s^2, likewise for the derivative."""
    density: Array
    """() how many samples of each IMU the window has for each of its steps, at most 1."""
    ready: Array
    """() bool, whether it has more samples than the degree of either IMU, on both sides of the query."""


class Kernel(NamedTuple):
    """What the samples of a window count for."""

    mean: Array
    """(W,) in an average."""
    derivative: Array
    """(W,) 1/s, in the rate's derivative."""
    gain: Array
    """() variance of an average over that of a sample's white noise."""
    density: Array
    """() samples for each step of the window."""
    ready: Array
    """() bool, as in `Window`, of one IMU."""


def kernel(time: Array, valid: Array, query: Array, *, degree: int, plain: bool) -> Kernel:
    """Return the weights of one IMU's window.

    Whatever the stamps, those of a degree M differentiate polynomials of degree M exactly, and average those of degree
    M - 1: two IMUs whose samples come at different times, or of which one lost some, are averaged alike but for the
    motion's M-th derivative.

    Args:
        time: (W,) s, as `savitzky_golay.averaging` wants it.
        valid: (W,) bool, whether the IMU's sample is there.
        query: () s, the time of the fit, the same for both IMUs.
        degree: of the polynomial, static.
        plain: static, evaluate the fits at the query as the paper does instead of averaging.

    Returns:
        The weights.
    """
    fit = sg.weights(time, valid, query, degree=degree)
    mean = fit.value if plain else sg.averaging(time, fit.derivative)
    count = fit.samples.astype(time.dtype)
    # A missing sample repeats the one before it, and its noise: their weights count together.
    gain = jnp.sum(jnp.where(time[:, None] == time[None, :], mean[:, None] * mean[None, :], 0))
    return Kernel(mean, fit.derivative, gain, count / len(time), (fit.samples > degree) & fit.inside)


def read(kernels: Kernel, value: Array, *, plain: bool) -> Window:
    """Average both IMUs over one window.

    Args:
        kernels: leading axis of 2, of A and of P; or of 1, of both.
        value: (W, 2, 6) of A and of P, rates, then specific forces; where missing, those of the sample before.
        plain: as for `kernel`.

    Returns:
        The averages.
    """
    rates = value[:, :, :3]
    parts = [value] if plain else [value, rates * rates, rates * jnp.roll(rates, -1, axis=2)]
    columns = jnp.concatenate(parts, axis=2).reshape(len(value), -1)
    # One product of both IMUs' weights and samples, for a batch takes longer over two of half the size.
    sums = product(jnp.concatenate(kernels[:2]), columns).reshape(2, -1, 2, columns.shape[1] // 2)
    a, p = (_means(sums[:, side % sums.shape[1], side], plain) for side in (0, 1))
    # Where an IMU has half the samples, each of them counts in twice as many windows.
    density = 1 / jnp.mean(1 / jnp.where(kernels.density > 0, kernels.density, 1))
    steep = jnp.sum(kernels.derivative**2) / len(kernels.derivative)
    return Window(a, p, jnp.mean(kernels.gain), steep, density, jnp.all(kernels.ready))


def _means(sums: Array, plain: bool) -> Means:
    """One IMU's averages from the sums (2, 12), or (2, 6) where plain."""
    rate, turn, force = sums[0, :3], sums[1, :3], sums[0, 3:6]
    if plain:
        return Means(rate, turn, outer(rate, rate), force)
    xx, yy, zz, xy, yz, zx = sums[0, 6:]
    square = jnp.stack([xx, xy, zx, xy, yy, yz, zx, yz, zz]).reshape(3, 3)
    return Means(rate, turn, square, force)


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
