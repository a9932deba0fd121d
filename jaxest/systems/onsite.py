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


class State(NamedTuple):
    """What the next step needs."""

    a: sg.State
    p: sg.State
    rotation: bingham_linear.State
    position: rls.State
    lever: Array
    """(3, 6) sums of O'O and of -O'R[f_P x], for what an error of the rotation does to the position."""
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
        The system, the same object for the same choices. Its measurement is `Pair`; an IMU's sample counts where its
        gyro and its accelerometer are both there.

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
    window = sg.init(sg.Params(zero), half_width=half_width, channels=6)
    turn = bingham_linear.init(_turning(params, zero))
    place = rls.init(rls.Params(zero, zero, zero), lag=lag)
    return State(window, window, turn, place, jnp.zeros((3, 6), dtype), zero, jnp.zeros((), jnp.int32))


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
    a, p, dt, status = _push(params, state, measurement)
    width = len(a.age)
    delay = a.elapsed[width // 2]
    first, second = (win.means(-s.age, s.value, s.valid, -delay, degree=degree, plain=plain) for s in (a, p))
    window = win.combine(first, second, degree)
    ready = window.ready & (state.index + 1 >= width)
    turn, found, spread, covariance, gain = _rotation(params, state, window, ready)
    rotation = quat.to_matrix(found.quaternion)
    half = found.bias / 2  # two gyros of one kind: each has its share of what differs
    back = jnp.sum(rotation * half[:, None], axis=0)
    o = win.regressor(window, rotation, half, -back, spread * (window.gain if plain else 1))
    force = jnp.sum(rotation * window.p.force[None, :], axis=1) - window.a.force
    known = ready & (jnp.max(jnp.diagonal(covariance)) < jnp.asarray(params.gate, dtype) ** 2)
    noisy = win.turning_noise(spread * (0 if plain else window.steep / 4))
    observation = rls.Observation(Reading(o, known), Reading(force, known), noisy, dt)
    forgetting = jnp.asarray(params.forgetting_position, dtype)
    settings = rls.Params(forgetting, jnp.zeros((), dtype), jnp.asarray(1e-4, dtype))
    position, place = rls.step(settings, state.position, observation, block=4 * width, start=rls.unweighted)
    lever = _lever(state.lever, o, rotation, window.p.force, known, forgetting)
    state = State(a, p, turn, position, lever, gain, state.index + 1)
    return state, _info(found, covariance, spread, gain, noisy, place, lever, delay, ready, status)


def _push(params: Params, state: State, measurement: Pair) -> tuple[sg.State, sg.State, Array, Array]:
    """Both windows with the new sample."""
    windows, bad = [], []
    dtype = state.gain.dtype
    dt = jnp.asarray(measurement.dt, dtype)
    for side, window, bias in (("a", state.a, params.bias_a), ("p", state.p, params.bias_p)):
        readings = [getattr(measurement, f"{kind}_{side}") for kind in ("gyroscope", "accelerometer")]
        value = [jnp.asarray(x.value, dtype) for x in readings]
        flags = [jnp.asarray(x.valid, bool) for x in readings]
        shapes = [x.shape for x in (*value, *flags, dt)]
        if shapes != [(3,), (3,), (), (), ()]:
            raise ValueError(
                f"measurement, IMU {side}: got shapes {shapes} for gyroscope, accelerometer, their valid and dt, "
                "expected (3,), (3,), (), (), (); vmap or run adds other axes"
            )
        finite = [jnp.all(jnp.isfinite(x)) for x in value]
        bad += [flag & ~fine for flag, fine in zip(flags, finite, strict=True)]
        there = flags[0] & flags[1] & finite[0] & finite[1] & jnp.isfinite(dt)
        sample = jnp.concatenate([value[0] - jnp.asarray(bias, dtype), value[1]])
        windows.append(sg.push(window, jnp.where(there, sample, 0), there, jnp.where(jnp.isfinite(dt), dt, 0)))
    broken = bad[0] | bad[1] | bad[2] | bad[3] | ~jnp.isfinite(dt)
    status = jnp.where(broken, NON_FINITE, OK).astype(jnp.int32)
    return windows[0], windows[1], jnp.where(jnp.isfinite(dt), dt, 0), status


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


def _lever(lever: Array, o: Array, rotation: Array, force: Array, known: Array, forgetting: Array) -> Array:
    x, y, z = force
    zero = jnp.zeros_like(x)
    skew = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    fresh = product(o.T, jnp.concatenate([o, -product(rotation, skew)], axis=1))
    return jnp.where(known, forgetting * lever + fresh, lever)


def _info(
    found: bingham_linear.Estimate, turning: Array, spread: Array, gain: Array, noisy: Array, place: rls.Info,
    lever: Array, delay: Array, ready: Array, status: Array,
) -> Info:  # fmt: skip
    # Each step used the rotation of its time, whose error then was larger: twice the variance of the last.
    moved = product(inverse3(lever[:, :3]), lever[:, 3:])
    # Overlapping windows repeat each other: over many, their noise is that of single samples. Blocks of windows tell
    # by how much the residuals' slow part exceeds that; their mean ratio is used, for single variances are uncertain.
    # The derivatives' noise is quick and leaves no such slow part: its share of the residuals does not count.
    quick = jnp.sum(noisy * place.estimate[:, None] * place.estimate[None, :])
    total = jnp.trace(place.noise)
    share = jnp.clip(1 - quick / jnp.where(total > 0, total, 1), 0.1, 1)
    white = place.formal * (share / jnp.where(gain > 0, gain, 1))
    ratio = jnp.sum(inverse3(white) * place.covariance) / 3
    placed = white * jnp.maximum(ratio, 1)
    cross = product(turning, moved.T)
    placing = placed + 2 * sandwich(moved, turning)
    whole = jnp.concatenate(
        [jnp.concatenate([turning, cross], axis=1), jnp.concatenate([cross.T, placing], axis=1)]
    )  # fmt: skip
    near = (4 * jnp.trace(placing) < 0.005**2) & (4 * jnp.trace(turning) < math.radians(0.1) ** 2)
    return Info(
        place.estimate, found.quaternion, whole, found.bias, place.residual, root(jnp.trace(place.noise) / 3),
        root(jnp.trace(spread) / 6), delay, place.valid & ready, near & place.valid, status,
    )  # fmt: skip


def root(x: Array) -> Array:
    """Square root with a finite derivative at 0."""
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1)), 0)


__all__ = ["Info", "Pair", "Params", "State", "build", "init", "root", "simulate", "step"]
