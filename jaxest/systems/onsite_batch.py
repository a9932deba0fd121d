"""Where one IMU is on a rigid link, seen from another: from a whole recording at once.

All windows are solved together by Gauss-Newton: position, rotation, both gyros' biases and the difference of the
accelerometers' biases, so that an early error of one does not stay in another. The squares of the rates tell the gyros'
own biases, not only their difference. The covariance is that of white noise of the residuals' size, enlarged by what
the scores of blocks of windows, each longer than the windows' overlap, scatter more than that, and by what the sensors'
axes may be off (`Prior`). The window is the one
of several whose variance without that factor is smallest.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.manifolds import quaternion as quat
from jaxest.systems import _onsite_sums as sums
from jaxest.systems import _onsite_window as win
from jaxest.systems.onsite_simulation import Pair
from jaxest.types import Array, ArrayLike, InputError

ITERATIONS = 8


class Prior(NamedTuple):
    """What is known of sensors that have not been calibrated."""

    gyroscope_bias: ArrayLike = 0.3
    """() rad/s, standard deviation of either gyro's bias about each axis; above 0."""
    accelerometer_bias: ArrayLike = 0.3
    """() m/s2, standard deviation of either accelerometer's bias along each axis; above 0."""
    gyroscope_axes: ArrayLike = 0.0
    """() standard deviation of each entry of the matrix (3, 3) by which either gyro's axes are off in scale and
    direction, rad; it does not average out, and belongs to the covariance. 0 for exact ones."""
    accelerometer_axes: ArrayLike = 0.0
    """() likewise of either accelerometer."""
    accelerometer_turn: ArrayLike = 0.0
    """() rad, standard deviation about each axis of the turn of either accelerometer's axes against its gyroscope's,
    beyond what `accelerometer_axes` says."""


class Estimate(NamedTuple):
    """What a recording says."""

    position: Array
    """(3,) m, of P in A."""
    quaternion: Array
    """(4,) wxyz, P to A."""
    covariance: Array
    """(6, 6) of rotation vector (in P, on the right) and position: rad, m."""
    bias_a: Array
    """(3,) rad/s, of gyro A."""
    bias_p: Array
    """(3,) rad/s, of gyro P, in P."""
    accelerometer_bias: Array
    """(3,) m/s2, of accelerometer P, in A, less that of A."""
    force_residual: Array
    """() m/s2, standard deviation of the difference of specific forces, as of single samples."""
    rate_residual: Array
    """() rad/s, likewise of the rates."""
    formal: Array
    """() m^2, trace of the position's covariance if the residuals were white; what the window is chosen by."""
    windows: Array
    """() int32, how many windows were used."""


class Choice(NamedTuple):
    """The best window's estimate, and all of them."""

    estimate: Estimate
    half_width: Array
    """() int32, N of its window."""
    all: Estimate
    """leaves (K, ...), one row per window."""


TIMES = (0.05, 0.07, 0.1, 0.14)
"""s, halves of the windows to try: from a tenth of the period of the quickest shaking that a hand does, upwards."""


def half_widths(dt: ArrayLike) -> tuple[int, ...]:
    """Return the N to try for steps `dt` (T,) s, the first of which does not count."""
    steps = np.asarray(dt, np.float64)[1:]
    step = float(np.median(steps)) if len(steps) else 0.0
    if not step > 0:
        raise InputError(f"dt: its median is {step} s, expected more than 0")
    return tuple(dict.fromkeys(max(2, round(time / step)) for time in TIMES))


def choose(
    measurements: Pair, prior: Prior | None = None, *, windows: Sequence[int] | None = None, degree: int = 3
) -> Choice:
    """Solve with several windows and take the one that the data say is best.

    Args:
        measurements: leading axis T, both IMUs at the same times; `savitzky_golay.smooth` brings one to the other's.
        prior: of the biases.
        windows: N to try, static, by default of the durations `TIMES`; those longer than the recording allows are left
            out.
        degree: M, static.

    Returns:
        The estimate with the smallest formal variance of the position, which one it is, and all of them. The choice
        knows the readings only.

    Raises:
        InputError: there are fewer samples than the shortest window has.
    """
    count = np.shape(measurements.dt)[0]
    trying = half_widths(measurements.dt) if windows is None else windows
    fitting = [n for n in trying if 4 * (2 * n + 1) <= count and 2 * n >= degree]
    if not fitting:
        least = 4 * (2 * min(trying) + 1)
        raise InputError(f"measurements: got {count} samples, expected at least {least}, four windows")
    reach = max(fitting)
    found = [_solve(measurements, prior, jnp.asarray(n, jnp.int32), reach=reach, degree=degree) for n in fitting]
    every = jax.tree.map(lambda *x: jnp.stack(x), *found)
    best = jnp.argmin(jnp.where(jnp.isfinite(every.formal), every.formal, jnp.inf))
    half_width = jnp.asarray(fitting, jnp.int32)[best]
    return Choice(jax.tree.map(lambda x: x[best], every), half_width, every)


def solve(measurements: Pair, prior: Prior | None = None, *, half_width: int = 7, degree: int = 3) -> Estimate:
    """Solve with one window; arguments as for `choose`, `half_width` N static.

    A step counts where both sensors of both IMUs are there and finite.
    """
    return _solve(measurements, prior, jnp.asarray(half_width, jnp.int32), reach=half_width, degree=degree)


@partial(jax.jit, static_argnames=("reach", "degree"))
def _solve(measurements: Pair, prior: Prior | None, half_width: Array, *, reach: int, degree: int) -> Estimate:
    """Solve with a window of N traced, at most `reach`: one program for all of them."""
    windows = averages(measurements, half_width, reach, degree)
    dtype = windows.gain.dtype
    settings = Prior() if prior is None else prior
    gyro, acc, *axes = (jnp.asarray(x, dtype) for x in settings)
    ready = windows.ready.astype(dtype)
    state, spread = sums.start(windows, ready)
    weights = (1 / (jnp.trace(spread) / 3), jnp.asarray(1.0, dtype))

    def body(turn: Array, carry: Any) -> Any:
        state, spread, weights = carry[:3]
        h, g, scores = sums.normal(windows, ready, state, spread, weights, gyro, acc)
        moved = sums.moved(state, jnp.where(turn < ITERATIONS, linalg.solve(h, -g), 0))
        spread, force = sums.noise(windows, ready, moved, spread)
        return moved, spread, (3 / jnp.trace(spread), 1 / force), h, scores

    zero = jnp.zeros((sums.SIZE, sums.SIZE), dtype)
    carry = (state, spread, weights, zero, jnp.zeros((len(ready), sums.SIZE), dtype))
    # The last pass moves nothing: it reads what belongs to the solution.
    state, spread, weights, h, scores = jax.lax.fori_loop(0, ITERATIONS + 1, body, carry)
    bent = sums.bent(windows, ready, state, spread, weights)
    turned = sums.turned(bent[:, 18:]) * axes[2]
    bent = jnp.concatenate([bent * jnp.repeat(jnp.stack(axes[:2]), 18)[None, :], turned], axis=1)
    known, block = sums.precision(gyro, acc, dtype), 4 * (2 * half_width + 1)
    return _read(state, h, scores, known, bent, weights, ready, block, degree)


def averages(measurements: Pair, half_width: Array, reach: int, degree: int) -> win.Window:
    """Averages of the window about every sample, (T, ...); those that reach beyond an end are not ready."""
    dt = jnp.asarray(measurements.dt)
    readings = [getattr(measurements, f"{kind}_{side}") for side in "ap" for kind in ("gyroscope", "accelerometer")]
    value = jnp.concatenate([jnp.asarray(x.value) for x in readings], axis=1)
    there = jnp.all(jnp.isfinite(value), axis=1)
    for reading in readings:
        there = there & jnp.asarray(reading.valid)
    value = jnp.where(there[:, None], value, 0)
    dt = dt.astype(value.dtype)
    count = len(dt)
    offsets = jnp.arange(-reach, reach + 1)
    # A missing sample holds the one before it, within the window; one outside the window holds its end.
    held = jax.lax.cummax(jnp.where(there, jnp.arange(count), -1))

    def one(centre: Array) -> win.Window:
        rows = jnp.clip(centre + offsets, 0, count - 1)
        inside = (jnp.abs(offsets) <= half_width) & (centre + offsets == rows)
        # Summed from the centre outwards, so that a float32 sum of a long recording's steps plays no part.
        after = jnp.cumsum(jnp.where(offsets > 0, dt[rows], 0))
        ahead = jnp.cumsum(jnp.where(offsets[::-1] <= 0, dt[rows[::-1]], 0))[::-1]
        back = jnp.concatenate([-ahead[1:], jnp.zeros_like(ahead[:1])])
        time = jnp.where(offsets > 0, after, jnp.where(offsets < 0, back, 0))
        kept = jnp.maximum(held[jnp.clip(rows, centre - half_width, centre + half_width)], centre - half_width)
        kept = jnp.clip(kept, 0, count - 1)
        valid = there[rows] & inside
        at = time[jnp.clip(kept - centre + reach, 0, 2 * reach)]
        weights = win.kernel(at, valid, jnp.zeros((), dt.dtype), degree=degree, plain=False)
        both = jax.tree.map(lambda x: x[None], weights)
        window = win.read(both, (value[kept, :6], value[kept, 6:]), plain=False)
        return window._replace(ready=window.ready & (centre >= half_width) & (centre + half_width < count))

    return jax.vmap(one)(jnp.arange(count))


def _read(
    state: sums.Unknowns, h: Array, scores: Array, precision: Array, bent: Array, weights: Any, ready: Array,
    block: Array, degree: int,
) -> Estimate:  # fmt: skip
    inverse = linalg.inverse(h)
    most = max(len(scores) // (4 * (degree + 1)), 1)  # a window has more samples than the degree
    # Blocks of windows in order of time; a rest that fills no block is left out.
    behind = jnp.arange(len(scores)) - (block // 4 - 1) // 2  # the first window is centred N in
    rows = jnp.where(behind >= 0, behind // block, most)
    count = jnp.maximum((len(scores) - (block // 4 - 1)) // block, 1)
    rows = jnp.where(rows < count, rows, most)
    sums = jax.ops.segment_sum(scores, rows, num_segments=most)
    total, whole = jnp.sum(ready), count * block
    free = (count / jnp.maximum(count - 3, 1)).astype(h.dtype)
    meat = sums.T @ sums * (total / whole * free) + precision
    scattered = inverse @ meat @ inverse.T
    pose = slice(0, 6)
    # Fifteen variances from some dozens of blocks are too uncertain to be used one by one; their mean ratio is not.
    ratio = jnp.trace(linalg.solve(inverse[pose, pose], scattered[pose, pose])) / 6
    bent = inverse @ bent
    covariance = inverse * jnp.maximum(ratio, 1) + bent @ bent.T
    order = jnp.asarray([3, 4, 5, 0, 1, 2])
    r = quat.to_matrix(state.quaternion)
    return Estimate(
        state.position, state.quaternion, covariance[order][:, order], state.bias,
        r.T @ (state.bias - state.difference), state.offset, jnp.sqrt(1 / weights[1]), jnp.sqrt(1 / weights[0]),
        jnp.trace(inverse[:3, :3]), jnp.sum(ready > 0).astype(jnp.int32),
    )  # fmt: skip


__all__ = ["TIMES", "Choice", "Estimate", "Prior", "averages", "choose", "half_widths", "solve"]
