"""What a window of two IMUs on one link says: averages that belong to the rates' derivatives.

The derivative of a Savitzky-Golay fit is a weighted mean of the true derivative over the window. The specific forces
and the squares of the rates are averaged with the same weights, so that the filter's response cancels from the equation
of motion and the window's width trades noise only. Sato 2024 evaluates each fit at the centre instead.

Conventions: A is the destination frame, P the other IMU; `R` takes P to A; r is P's place in A.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters import savitzky_golay as sg
from jaxest.filters._small import eye, outer, product, sandwich, trace, transposed, turned_back
from jaxest.manifolds._algebra import skew
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
        time: (W,) s, as `savitzky_golay.averaging` wants it; axes behind, in all three arguments, are batches.
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
    gain = jnp.sum(jnp.where(time[:, None] == time[None, :], outer(mean, mean), 0), axis=(0, 1))
    return Kernel(mean, fit.derivative, gain, count / len(time), (fit.samples > degree) & fit.inside)


def kernels(time: Array, valid: Array, query: Array, *, degree: int, plain: bool) -> Kernel:
    """Return the weights of both IMUs' windows, leaves (2, ...); arguments as for `kernel`, of both.

    A batch behind that has the same stamps for all its items, as runs of one simulation have, has them weighed once.
    """

    def weigh(time: Array, valid: Array, query: Array) -> Kernel:
        one = partial(kernel, degree=degree, plain=plain)
        found: Kernel = jax.vmap(one, in_axes=(0, 0, None))(time, valid, query)
        return found

    if time.ndim == 2:
        return weigh(time, valid, query)

    def once(*given: Array) -> Kernel:
        found = weigh(*(x[..., 0] for x in given))
        return jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, time.shape[2])), found)

    same = [jnp.all(x == x[..., :1]) for x in (time, valid, query)]
    found: Kernel = jax.lax.cond(same[0] & same[1] & same[2], once, weigh, time, valid, query)
    return found


def read(kernels: Kernel, values: tuple[Array, Array], *, plain: bool) -> Window:
    """Average both IMUs over one window.

    Args:
        kernels: leading axis of 2, of A and of P; or of 1, of both.
        values: (W, 6) of A and of P, rates, then specific forces; where missing, those of the sample before. An axis
            behind, here and in kernels of both, is a batch.
        plain: as for `kernel`.

    Returns:
        The averages.
    """
    a, p = _products(kernels, values, plain) if len(kernels.gain) == 1 else _rows(kernels, values, plain)
    # Where an IMU has half the samples, each of them counts in twice as many windows.
    density = 1 / jnp.mean(1 / jnp.where(kernels.density > 0, kernels.density, 1), axis=0)
    steep = jnp.sum(kernels.derivative**2, axis=(0, 1)) / len(kernels.derivative)
    return Window(a, p, jnp.mean(kernels.gain, axis=0), steep, density, jnp.all(kernels.ready, axis=0))


def _products(kernels: Kernel, values: tuple[Array, Array], plain: bool) -> tuple[Means, Means]:
    """Both IMUs' averages by the same weights: one matrix product."""
    both = [[x] if plain else [x, x[:, :3] * x[:, :3], x[:, :3] * jnp.roll(x[:, :3], -1, axis=1)] for x in values]
    columns = jnp.concatenate([*both[0], *both[1]], axis=1)
    sums = product(jnp.concatenate(kernels[:2]), columns)
    half = columns.shape[1] // 2
    a, p = (_means(x[0, :6], x[1, :3], x[0, 6:], plain) for x in (sums[:, :half], sums[:, half:]))
    return a, p


def _rows(kernels: Kernel, values: tuple[Array, Array], plain: bool) -> tuple[Means, Means]:
    """Both IMUs' averages by sums of rows, of which XLA makes vector code for a batch behind."""

    def one(side: int) -> Means:
        mean, slope, x = kernels.mean[side], kernels.derivative[side], values[side]
        means, turn, rates = turned_back(x, mean), turned_back(x[:, :3], slope), x[:, :3]
        mixed = [turned_back((x[:, i] * x[:, (i + 1) % 3])[:, None], mean) for i in range(3)]
        squares = () if plain else jnp.concatenate([turned_back(rates * rates, mean), *mixed])
        return _means(means, turn, squares, plain)

    return one(0), one(1)


def _symmetric(xx: Array, yy: Array, zz: Array, xy: Array, yz: Array, zx: Array) -> Array:
    """Return the matrix (3, 3) of its entries."""
    found: Array = jnp.stack([xx, xy, zx, xy, yy, yz, zx, yz, zz]).reshape((3, 3, *xx.shape))
    return found


def _means(means: Array, turn: Array, squares: Any, plain: bool) -> Means:
    """One IMU's averages of rates and forces (6,), of the rates' derivatives (3,) and squares (6,)."""
    rate, force = means[:3], means[3:]
    return Means(rate, turn, outer(rate, rate) if plain else _symmetric(*squares), force)


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
    square = imu.square - mixed - transposed(mixed) + outer(bias, bias)
    return square - trace(square)[None, None] * eye(3, square[0, 0]) + skew(imu.turn)


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
    return trace(covariance)[None, None] * eye(3, covariance[0, 0]) - covariance
