"""Where one IMU is on a rigid link, seen from another: relative pose from shaking, live."""

import functools
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters import bingham_linear, rls
from jaxest.filters import savitzky_golay as sg
from jaxest.filters._small import applied, eye, held, largest, trace, transposed, turned_back
from jaxest.filters._time import elapsed
from jaxest.linalg._eigen4 import eigen4
from jaxest.manifolds import quaternion as quat
from jaxest.systems import _onsite_covariance as unknown
from jaxest.systems import _onsite_window as win
from jaxest.systems._onsite_batched import batched
from jaxest.systems._onsite_state import Info, Memory, Params, State, closed, init, opened, turning
from jaxest.systems.onsite_simulation import Pair, simulate
from jaxest.types import NON_FINITE, OK, Array, ArrayLike, Reading, System


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
    for name in _CHANNELS:
        reading = getattr(measurement, name)
        shapes = (jnp.shape(reading.value), jnp.shape(reading.valid), jnp.shape(measurement.dt))
        if shapes != ((3,), (), ()):
            raise ValueError(
                f"measurement, {name}: got shapes {shapes[0]} and {shapes[1]} for value and valid, {shapes[2]} for "
                "dt, expected (3,), () and (); vmap or run adds other axes"
            )
    found: tuple[State, Info] = _one_or_many(degree, plain)(params, state, measurement)
    return found


@functools.cache
def _one_or_many(degree: int, plain: bool) -> Any:
    return batched(partial(_step, degree=degree, plain=plain))


def _step(
    params: Params, state: State, measurement: Pair, go: Array | None, *, degree: int, plain: bool
) -> tuple[State, Info]:
    """The step of one pair, or of a batch behind all axes with `go` as for `held`."""
    memory = opened(state)
    dtype = memory.gain.dtype
    windows, status = _push(params, memory, measurement)
    width = len(windows[0].elapsed)
    delay = windows[0].elapsed[width // 2]
    age, valid = (jnp.stack([getattr(x, name) for x in windows]) for name in ("age", "valid"))
    kernels = win.kernels(-age, valid, -delay, degree=degree, plain=plain)
    window = held(go, partial(win.read, plain=plain), kernels, (windows[0].value, windows[1].value))
    ready = window.ready & (state.index + 1 >= width)
    turn, found, spread, known, gains = _rotation(params, memory, window, ready, go)
    known = ready & known
    o, turned, noisy = held(go, partial(_regressor, plain=plain), window, found, spread)
    force = jnp.where(known[None], turned - window.a.force, 0)
    observed = (jnp.where(known[None, None], o, 0), force, jnp.where(known[None, None], noisy, 0), known)
    forgetting = jnp.asarray(params.forgetting_position, dtype)
    settings = rls.Params(forgetting, jnp.zeros_like(forgetting), jnp.full_like(forgetting, 1e-4))
    advance = partial(rls.advance, settings, block=4 * width, start=rls.unweighted, go=go)
    position, residuals = held(go, advance, memory.position, observed)
    solved = held(go, partial(rls.solved, settings), position, residuals.variance)
    place = rls.read(position, solved, residuals, status, block=4 * width)
    position = position._replace(estimate=place.estimate)
    memory = Memory(windows, turn, position, _lever(memory, o, turned, known, forgetting), *gains)
    off = unknown.Turned(found.matrix, found.covariance, unknown.askew(params, turn))
    near, whole = unknown.whole(params, off, place, memory, noisy)
    info = Info(
        place.estimate, found.quaternion, whole, found.bias, place.residual, root(place.variance),
        root(trace(spread) / 6), delay, place.valid & ready, near & place.valid, status,
    )  # fmt: skip
    return closed(memory, state.index + 1), info


def _push(params: Params, memory: Memory, measurement: Pair) -> tuple[tuple[sg.State, sg.State], Array]:
    """Both windows with the new samples, and the status."""
    dtype = memory.gain.dtype
    step, timely = elapsed(measurement.dt, dtype)
    largest = float(jnp.finfo(dtype).max) ** 0.1  # 7000 rad/s, m/s2 in float32: what larger readings make outgrows it

    def push(window: sg.State, gyro: Reading, acc: Reading, bias: ArrayLike) -> tuple[sg.State, Array]:
        rate, force = (jnp.asarray(x.value, dtype) for x in (gyro, acc))
        flags = [jnp.asarray(x.valid, bool) for x in (gyro, acc)]
        finite = [jnp.all(jnp.abs(x) < largest, axis=0) for x in (rate, force)]
        there = flags[0] & flags[1] & finite[0] & finite[1] & timely
        value = jnp.concatenate([rate - jnp.asarray(bias, dtype), force])
        broken = (flags[0] & ~finite[0]) | (flags[1] & ~finite[1])
        return sg.push(window, jnp.where(there[None], value, 0), there, step), broken

    m, (a, p) = measurement, memory.windows
    a, broken_a = push(a, m.gyroscope_a, m.accelerometer_a, params.bias_a)
    p, broken_p = push(p, m.gyroscope_p, m.accelerometer_p, params.bias_p)
    status = jnp.where(broken_a | broken_p | ~timely, NON_FINITE, OK).astype(jnp.int32)
    return (a, p), status


_CHANNELS = ("gyroscope_a", "accelerometer_a", "gyroscope_p", "accelerometer_p")


class Turn(NamedTuple):
    """What is known of the rotation."""

    quaternion: Array
    """(4,)"""
    matrix: Array
    """(3, 3)"""
    covariance: Array
    """(3, 3) rad^2"""
    bias: Array
    """(3,) rad/s"""


def _rotation(
    params: Params, memory: Memory, window: win.Window, ready: Array, go: Array | None
) -> tuple[bingham_linear.State, Turn, Array, Array, tuple[Array, Array]]:
    """Next moments, estimate, noise covariance of w_A - R w_P as of single samples, known or not, gain and density."""
    dtype = memory.gain.dtype
    settings = turning(params, dtype)
    z = jnp.where(ready, jnp.concatenate([window.a.rate, window.p.rate]), 0)
    weight = jnp.where(ready, window.density, 0)

    def moved(before: bingham_linear.State, z: Array, weight: Array) -> Any:
        turn = bingham_linear.add(before, z, weight, jnp.asarray(settings.forgetting, dtype))
        return turn, bingham_linear.density(settings, turn)

    turn, (second, a) = held(go, moved, memory.rotation, z, weight)
    values, vectors = eigen4(a)
    q, r = held(go, _mode, values, vectors)
    bias, residual = held(go, partial(bingham_linear.rest, settings), turn, second, r)
    share = weight / jnp.where(turn.weight > 0, turn.weight, 1)
    gain, density = memory.gain, memory.density
    gain, density = gain + share * (window.gain - gain), density + share * (window.density - density)
    # Averages of n overlapping windows are worth ten samples of what was assumed at the start.
    assumed = 2 * jnp.asarray(settings.covariance_a)[0, 0]
    scaled = residual * (turn.weight / jnp.where(gain > 0, gain, 1))[None, None]
    spread = (scaled + 10 * assumed[None, None] * eye(3, turn.weight)) / (turn.weight + 10)[None, None]
    covariance = held(go, partial(bingham_linear.spread, settings), turn, second, values, vectors, q)
    covariance = covariance * (trace(spread) / (3 * assumed))[None, None]
    most = jnp.maximum(jnp.maximum(covariance[0, 0], covariance[1, 1]), covariance[2, 2])
    known = most < jnp.asarray(params.gate, dtype) ** 2
    return turn, Turn(q, r, covariance, bias), spread, known, (gain, density)


def _mode(values: Array, vectors: Array) -> tuple[Array, Array]:
    """Quaternion and matrix of the largest eigenvalue."""
    q = largest(values, vectors)
    matrix = quat.to_matrix if q.ndim == 1 else jax.vmap(quat.to_matrix, in_axes=-1, out_axes=-1)
    return q, matrix(q)


def _regressor(window: win.Window, found: Turn, spread: Array, *, plain: bool) -> tuple[Array, Array, Array]:
    """Return what takes r to the forces' difference, P's force in A, and what noise adds to the regressor's square."""
    half = found.bias / 2  # two gyros of one kind: each has its share of what differs
    back = turned_back(found.matrix, half)
    o = win.regressor(window, found.matrix, half, -back, spread * (window.gain[None, None] if plain else 1))
    steep = 0 * window.steep if plain else window.steep / 4
    return o, applied(found.matrix, window.p.force), win.turning_noise(spread * steep[None, None])


def _lever(memory: Memory, o: Array, force: Array, known: Array, forgetting: Array) -> Array:
    """Next sums; a step that does not count adds nothing and forgets nothing."""
    both = jnp.concatenate([force, jnp.ones_like(force[:1])])
    fresh = (transposed(o)[:, :, None] * both[None, None, :]).reshape(memory.lever.shape)
    return jnp.where(known[None, None], forgetting[None, None] * memory.lever + fresh, memory.lever)


def root(x: Array) -> Array:
    """Square root with a finite derivative at 0."""
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1)), 0)


__all__ = ["Info", "Pair", "Params", "State", "build", "init", "root", "simulate", "step"]
