"""Where one IMU is on a rigid link, seen from another: relative pose from shaking, live."""

import functools
import math
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.filters import bingham_linear, rls
from jaxest.filters import savitzky_golay as sg
from jaxest.filters._small import inverse3, product, sandwich
from jaxest.manifolds import quaternion as quat
from jaxest.systems import _onsite_window as win
from jaxest.systems.onsite_simulation import Pair, simulate
from jaxest.types import NON_FINITE, OK, Array, ArrayLike, Reading, System


class Params(NamedTuple):
    """What may be tuned or differentiated."""

    gyroscope_noise: ArrayLike = 0.01
    """() rad/s, standard deviation of a sample of either gyro; only its order matters, the data tell the rest."""
    gyroscope_bias: ArrayLike = 0.3
    """() rad/s, standard deviation of either gyro's bias about each axis; 0 for calibrated ones."""
    bias_a: ArrayLike = np.zeros(3)
    """(3,) rad/s, what is known of gyro A's bias, taken off its readings."""
    bias_p: ArrayLike = np.zeros(3)
    """(3,) rad/s, likewise P's."""
    forgetting_rotation: ArrayLike = 1.0
    """() gamma_rot, above 0 to 1, at each step."""
    forgetting_position: ArrayLike = 1.0
    """() gamma_pos, above 0 to 1, at each step."""
    gate: ArrayLike = 0.005
    """() rad, the position waits until the rotation's standard deviation about every axis is below this."""
    gyroscope_axes: ArrayLike = 0.0
    """() standard deviation of each entry of the matrix (3, 3) by which either gyro's axes are off in scale and
    direction, rad; it does not average out, and belongs to the covariance. 0 for exact ones."""
    accelerometer_axes: ArrayLike = 0.0
    """() likewise of either accelerometer."""


class State(NamedTuple):
    """What the next step needs."""

    window: sg.State
    """12 channels: rates of A and of P, then their specific forces."""
    rotation: bingham_linear.State
    position: rls.State
    lever: Array
    """(3, 9) sum of O_ki (R f_P)_l in row i and column 3 k + l: what errors of the rotation and of the forces do to the
    position."""
    gain: Array
    """() mean gain of the averages so far."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate after a step."""

    position: Array
    """(3,) m, of P in A."""
    quaternion: Array
    """(4,) wxyz, P to A."""
    covariance: Array
    """(6, 6) of rotation vector (in P, on the right) and position: rad, m."""
    bias: Array
    """(3,) rad/s, of gyro A less that of P, in A."""
    innovation: Array
    """(3,) m/s2, difference of the specific forces that the estimate before does not explain; 0 where not used."""
    residual: Array
    """() m/s2, standard deviation of the innovations over the last N_lag."""
    rate_residual: Array
    """() rad/s, standard deviation of the difference of the rates, as of single samples."""
    delay: Array
    """() s, age of the newest window's centre."""
    valid: Array
    """() bool, whether rotation and position are both determined."""
    done: Array
    """() bool, whether two standard deviations (root of the trace) are below 5 mm and 0.1 deg."""
    status: Array
    """() int32, `OK` or `NON_FINITE`."""


def build(
    robot: None = None, sensors: None = None, *, half_width: int = 7, degree: int = 3, lag: int = 20,
    plain: bool = False,
) -> System:  # fmt: skip
    """Build the live estimator of the pose of one IMU relative to another on the same link.

    Args:
        robot: not used, the link is what is sought; here because every system takes one.
        sensors: not used, a pair of IMUs is what there is.
        half_width: N, a window is 2 N + 1 steps; about 0.07 s to either side is good for shaking by hand.
        degree: M of the fitted polynomials.
        lag: N_lag, residuals that their covariance is taken over.
        plain: evaluate the fits at the window's centre as the paper does (with N = 3, M = 5) instead of averaging
            over the window.

    Returns:
        The system, the same object for the same choices. Its measurement is `Pair`; a sample counts where both sensors
        of both IMUs are there.

    Raises:
        ValueError: the window is no longer than the degree, or the degree is below 1.

    Source: Sato 2024.
    """
    if not 1 <= degree <= 2 * half_width:
        raise ValueError(f"degree: got {degree}, expected 1 to {2 * half_width} for a half width of {half_width}")
    return _build(half_width, degree, lag, plain)


@functools.cache
def _build(half_width: int, degree: int, lag: int, plain: bool) -> System:
    return System(
        Params(),
        partial(init, half_width=half_width, lag=lag),
        partial(step, degree=degree, plain=plain),
        partial(simulate),
    )


def init(params: Params, *, key: Array | None = None, half_width: int = 7, lag: int = 20) -> State:
    """Return the state that has seen no data, in the dtype of the parameters; arguments as for `build`."""
    dtype = jnp.result_type(*(jnp.asarray(x) for x in params))
    zero = jnp.zeros((), dtype)
    window = sg.init(sg.Params(zero), half_width=half_width, channels=12)
    turn = bingham_linear.init(_turning(params, zero))
    place = rls.init(rls.Params(zero, zero, zero), lag=lag)
    return State(window, turn, place, jnp.zeros((3, 9), dtype), zero, jnp.zeros((), jnp.int32))


def _turning(params: Params, zero: Array) -> bingham_linear.Params:
    """Parameters of the rotation's filter; the noise of a raw sample, for windows overlap."""
    noise, bias, forgetting = (
        jnp.asarray(x, zero.dtype) for x in (params.gyroscope_noise, params.gyroscope_bias, params.forgetting_rotation)
    )
    covariance = noise * noise * jnp.eye(3, dtype=zero.dtype)
    return bingham_linear.Params(covariance, covariance, math.sqrt(2) * bias, forgetting)


def step(
    params: Params, state: State, measurement: Pair, *, key: Array | None = None, degree: int = 3, plain: bool = False
) -> tuple[State, Info]:
    """Take in one sample of both IMUs.

    Args:
        params: noise, bias and forgetting.
        state: as `init` or the previous step returned it.
        measurement: one sample; any sensor may be missing.
        key: not used.
        degree: M, static.
        plain: as for `build`, static.

    Returns:
        The next state and the estimate.

    Raises:
        ValueError: a shape is wrong.

    Source: Sato 2024, sections III-A to III-D.
    """
    dtype = state.gain.dtype
    pushed, dt, status = _push(params, state, measurement)
    width = len(pushed.age)
    delay = pushed.elapsed[width // 2]
    window = win.read(-pushed.age, pushed.value, pushed.valid, -delay, degree=degree, plain=plain)
    ready = window.ready & (state.index + 1 >= width)
    turn, found, spread, covariance, gain = _rotation(params, state, window, ready)
    rotation = quat.to_matrix(found.quaternion)
    half = found.bias / 2  # two gyros of one kind: each has its share of what differs
    back = jnp.sum(rotation * half[:, None], axis=0)
    o = win.regressor(window, rotation, half, -back, spread * (window.gain if plain else 1))
    turned = jnp.sum(rotation * window.p.force[None, :], axis=1)
    known = ready & (jnp.max(jnp.diagonal(covariance)) < jnp.asarray(params.gate, dtype) ** 2)
    noisy = win.turning_noise(spread * (0 if plain else window.steep / 4))
    observation = rls.Observation(Reading(o, known), Reading(turned - window.a.force, known), noisy, dt)
    forgetting = jnp.asarray(params.forgetting_position, dtype)
    settings = rls.Params(forgetting, jnp.zeros((), dtype), jnp.asarray(1e-4, dtype))
    position, place = rls.step(settings, state.position, observation, block=4 * width, start=rls.unweighted)
    lever = _lever(state, o, turned, known, forgetting)
    state = State(pushed, turn, position, lever, gain, state.index + 1)
    turning = _Turning(rotation, covariance, _askew(params, turn))
    near, whole = _covariance(params, turning, place, state, noisy)
    info = Info(
        place.estimate, found.quaternion, whole, found.bias, place.residual, root(jnp.trace(place.noise) / 3),
        root(jnp.trace(spread) / 6), delay, place.valid & ready, near & place.valid, status,
    )  # fmt: skip
    return state, info


def _push(params: Params, state: State, measurement: Pair) -> tuple[sg.State, Array, Array]:
    """The window with the new sample, dt and the status."""
    dtype = state.gain.dtype
    dt = jnp.asarray(measurement.dt, dtype)
    values, there, broken = [], jnp.isfinite(dt), ~jnp.isfinite(dt)
    for name in _CHANNELS:
        reading = getattr(measurement, name)
        value, flag = jnp.asarray(reading.value, dtype), jnp.asarray(reading.valid, bool)
        if (value.shape, flag.shape, dt.shape) != ((3,), (), ()):
            raise ValueError(
                f"measurement, {name}: got shapes {value.shape} and {flag.shape} for value and valid, {dt.shape} for "
                "dt, expected (3,), () and (); vmap or run adds other axes"
            )
        finite = jnp.all(jnp.isfinite(value))
        there, broken = there & flag & finite, broken | (flag & ~finite)
        values.append(value)
    known = jnp.concatenate([jnp.asarray(params.bias_a, dtype), jnp.asarray(params.bias_p, dtype)])
    rates, forces = jnp.concatenate(values[:2]), jnp.concatenate(values[2:])
    sample = jnp.where(there, jnp.concatenate([rates - known, forces]), 0)
    step = jnp.where(jnp.isfinite(dt), dt, 0)
    status = jnp.where(broken, NON_FINITE, OK).astype(jnp.int32)
    return sg.push(state.window, sample, there, step), step, status


_CHANNELS = ("gyroscope_a", "gyroscope_p", "accelerometer_a", "accelerometer_p")


def _rotation(
    params: Params, state: State, window: win.Window, ready: Array
) -> tuple[bingham_linear.State, bingham_linear.Estimate, Array, Array, Array]:
    """Next moments, estimate, noise covariance of w_A - R w_P as of single samples, covariance, and mean gain."""
    settings = _turning(params, state.gain)
    z = jnp.where(ready, jnp.concatenate([window.a.rate, window.p.rate]), 0)
    moved = bingham_linear.add(state.rotation, z, ready.astype(z.dtype), jnp.asarray(settings.forgetting, z.dtype))
    found = bingham_linear.estimate(settings, moved)
    share = jnp.where(ready, 1 / jnp.where(moved.weight > 0, moved.weight, 1), 0)
    gain = state.gain + share * (window.gain - state.gain)
    # Averages of n overlapping windows are worth ten samples of what was assumed at the start.
    assumed = 2 * jnp.asarray(settings.covariance_a)
    scaled = found.residual / jnp.where(gain > 0, gain, 1)
    spread = (moved.weight * scaled + 10 * assumed) / (moved.weight + 10)
    ratio = jnp.trace(spread) / jnp.trace(assumed)
    return moved, found, spread, found.covariance * ratio, gain


def _lever(state: State, o: Array, force: Array, known: Array, forgetting: Array) -> Array:
    """Next sums; a step that does not count adds nothing and forgets nothing."""
    fresh = (o.T[:, :, None] * force[None, None, :]).reshape(3, 9)
    return jnp.where(known, forgetting * state.lever + fresh, state.lever)


class _Turning(NamedTuple):
    """The rotation and what is not known of it, in P."""

    matrix: Array
    noise: Array
    askew: Array


def _askew(params: Params, turn: bingham_linear.State) -> Array:
    """Covariance (3, 3) that gyros with crooked axes leave of the rotation.

    If R'w_A = w_P + D w_P with independent entries of D, the rotation turns by (tr S I - S)^-1 sum of w x D w, S the
    rates' second moment: the covariance of that sum is tr(S^2) I - S^2 times the variance of an entry. About an axis
    that nothing turns about it is an entry's own, which both factors tend to with what is added to them.
    """
    s = turn.scatter[3:, 3:]
    s = s / jnp.where(turn.weight > 0, turn.weight, 1)
    eye = jnp.eye(3, dtype=s.dtype)
    square, moved = product(s, s), jnp.trace(s) * eye - s
    little = 3e-3 * jnp.trace(s)
    back = inverse3(moved + little * eye)
    spread = (jnp.trace(square) + little * little) * eye - square + 2 * little * moved
    entry = 2 * jnp.asarray(params.gyroscope_axes, s.dtype) ** 2  # of the difference of two
    return entry * sandwich(back, spread)


def _covariance(params: Params, turning: _Turning, place: rls.Info, state: State, noisy: Array) -> tuple[Array, Array]:
    """Whether the pose is known to 5 mm and 0.1 deg, and its covariance (6, 6)."""
    force, gain = state.lever, state.gain
    total = jnp.trace(place.noise)
    unit = jnp.where(total > 0, total, 1) / 3
    inverse = place.formal / unit  # of the sum of O'O, less what noise adds to it
    # Sum of O'[R f_P x]; a turn d of P on the right moves R f_P by -[R f_P x] R d.
    crossed = jnp.stack([force[:, 5] - force[:, 7], force[:, 6] - force[:, 2], force[:, 1] - force[:, 3]], axis=1)
    moved = -product(inverse, product(crossed, turning.matrix))
    # Overlapping windows repeat each other: over many, their noise is that of single samples. Blocks of windows tell
    # by how much the residuals' slow part exceeds that; their mean ratio is used, for single variances are uncertain.
    # The derivatives' noise is quick and leaves no such slow part: its share of the residuals does not count.
    quick = jnp.sum(noisy * place.estimate[:, None] * place.estimate[None, :])
    share = jnp.clip(1 - quick / (3 * unit), 0.1, 1) / jnp.where(gain > 0, gain, 1)
    ratio = jnp.sum(state.position.information * place.covariance) / (3 * unit * share)
    placed = place.formal * (share * jnp.maximum(ratio, 1))
    # Each step used the rotation of its time, whose error then was larger: twice the variance of the last.
    turned = turning.noise + turning.askew
    cross = product(turned, moved.T)
    placing = placed + sandwich(moved, turned + turning.noise) + _stretched(params, place.estimate, inverse, force)
    whole = jnp.concatenate(
        [jnp.concatenate([turned, cross], axis=1), jnp.concatenate([cross.T, placing], axis=1)]
    )  # fmt: skip
    near = (4 * jnp.trace(placing) < 0.005**2) & (4 * jnp.trace(turned) < math.radians(0.1) ** 2)
    return near, whole


def _stretched(params: Params, position: Array, inverse: Array, force: Array) -> Array:
    """Covariance (3, 3) that crooked axes leave of the position besides what the rotation's error does."""
    gyro, acc = (jnp.asarray(x, force.dtype) for x in (params.gyroscope_axes, params.accelerometer_axes))
    # The regressor is linear in the rates' derivatives and quadratic in the rates: entries e of the mean of both gyros'
    # matrices, of half the variance of one, show as e to 2 e; between the two. The forces, both near R f_P, differ by
    # D R f_P.
    own = gyro * gyro * jnp.sum(position * position) * jnp.eye(3, dtype=force.dtype)
    return own + 2 * acc * acc * sandwich(inverse, product(force, force.T))


def root(x: Array) -> Array:
    """Square root with a finite derivative at 0."""
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1)), 0)


__all__ = ["Info", "Pair", "Params", "State", "build", "init", "root", "simulate", "step"]
