"""Where one IMU is on a rigid link, seen from another: relative pose from shaking, live."""

import functools
from functools import partial

import jax
import jax.numpy as jnp

from jaxest.filters import bingham_linear, rls
from jaxest.filters import savitzky_golay as sg
from jaxest.filters._small import trace
from jaxest.manifolds import quaternion as quat
from jaxest.systems import _onsite_covariance as unknown
from jaxest.systems import _onsite_window as win
from jaxest.systems._onsite_state import Info, Memory, Params, State, closed, init, opened, turning
from jaxest.systems.onsite_simulation import Pair, simulate
from jaxest.types import NON_FINITE, OK, Array, Reading, System


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
        The system, the same object for the same choices. Its measurement is `Pair`. A step is a moment at which any of
        the IMUs is read; an IMU's sample counts where its gyro and its accelerometer are both there. IMUs with clocks
        of their own need not share a moment: each has its window, and both are fitted at the same time.

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
    memory = opened(state)
    dtype = memory.gain.dtype
    windows, dt, status = _push(params, memory, measurement)
    width = len(windows.elapsed)
    delay = windows.elapsed[width // 2]
    weigh = jax.vmap(partial(win.kernel, degree=degree, plain=plain), in_axes=(0, 0, None))
    window = win.read(weigh(-windows.age, windows.valid, -delay), windows.value, plain=plain)
    ready = window.ready & (state.index + 1 >= width)
    turn, found, spread, covariance, gains = _rotation(params, memory, window, ready)
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
    position, place = rls.step(settings, memory.position, observation, block=4 * width, start=rls.unweighted)
    memory = Memory(windows, turn, position, _lever(memory, o, turned, known, forgetting), *gains)
    off = unknown.Turned(rotation, covariance, unknown.askew(params, turn))
    near, whole = unknown.whole(params, off, place, memory, noisy)
    info = Info(
        place.estimate, found.quaternion, whole, found.bias, place.residual, root(place.variance),
        root(trace(spread) / 6), delay, place.valid & ready, near & place.valid, status,
    )  # fmt: skip
    return closed(memory, state.index + 1), info


def _push(params: Params, memory: Memory, measurement: Pair) -> tuple[sg.State, Array, Array]:
    """Both windows with the new samples, dt and the status."""
    dtype = memory.gain.dtype
    dt = jnp.asarray(measurement.dt, dtype)
    timed = jnp.isfinite(dt)
    values, flags = [], []
    for name in _CHANNELS:
        reading = getattr(measurement, name)
        value, flag = jnp.asarray(reading.value, dtype), jnp.asarray(reading.valid, bool)
        if (value.shape, flag.shape, dt.shape) != ((3,), (), ()):
            raise ValueError(
                f"measurement, {name}: got shapes {value.shape} and {flag.shape} for value and valid, {dt.shape} for "
                "dt, expected (3,), () and (); vmap or run adds other axes"
            )
        values.append(value)
        flags.append(flag)
    value, flag = jnp.stack(values), jnp.stack(flags)
    finite = jnp.all(jnp.isfinite(value), axis=1)
    there = jnp.all((flag & finite & timed).reshape(2, 2), axis=1)
    known = jnp.stack([jnp.asarray(x, dtype) for x in (params.bias_a, params.bias_p)])
    sample = jnp.where(there[:, None], value.reshape(2, 6) - jnp.pad(known, ((0, 0), (0, 3))), 0)
    both = sg.State(0, 1, 0, None, None)  # type: ignore[arg-type]  # which axes are the IMUs'
    push = jax.vmap(sg.push, in_axes=(both, 0, 0, None), out_axes=both)
    status = jnp.where(jnp.any(flag & ~finite) | ~timed, NON_FINITE, OK).astype(jnp.int32)
    step = jnp.where(timed, dt, 0)
    return push(memory.windows, sample, there, step), step, status


_CHANNELS = ("gyroscope_a", "accelerometer_a", "gyroscope_p", "accelerometer_p")


def _rotation(
    params: Params, memory: Memory, window: win.Window, ready: Array
) -> tuple[bingham_linear.State, bingham_linear.Estimate, Array, Array, tuple[Array, Array]]:
    """Next moments, estimate, noise covariance of w_A - R w_P as of single samples, covariance, gain and density."""
    dtype = memory.gain.dtype
    settings = turning(params, dtype)
    z = jnp.where(ready, jnp.concatenate([window.a.rate, window.p.rate]), 0)
    weight = jnp.where(ready, window.density, 0)
    moved = bingham_linear.add(memory.rotation, z, weight, jnp.asarray(settings.forgetting, dtype))
    found = bingham_linear.estimate(settings, moved)
    share = weight / jnp.where(moved.weight > 0, moved.weight, 1)
    gain, density = memory.gain, memory.density
    gain, density = gain + share * (window.gain - gain), density + share * (window.density - density)
    # Averages of n overlapping windows are worth ten samples of what was assumed at the start.
    assumed = 2 * jnp.asarray(settings.covariance_a)
    scaled = found.residual / jnp.where(gain > 0, gain, 1)
    spread = (moved.weight * scaled + 10 * assumed) / (moved.weight + 10)
    ratio = trace(spread) / trace(assumed)
    return moved, found, spread, found.covariance * ratio, (gain, density)


def _lever(memory: Memory, o: Array, force: Array, known: Array, forgetting: Array) -> Array:
    """Next sums; a step that does not count adds nothing and forgets nothing."""
    both = jnp.concatenate([force, jnp.ones_like(force[:1])])
    fresh = (o.T[:, :, None] * both[None, None, :]).reshape(3, 12)
    return jnp.where(known, forgetting * memory.lever + fresh, memory.lever)


def root(x: Array) -> Array:
    """Square root with a finite derivative at 0."""
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1)), 0)


__all__ = ["Info", "Pair", "Params", "State", "build", "init", "root", "simulate", "step"]
