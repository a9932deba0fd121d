"""Parameters, state and info of the live estimator `onsite`."""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest.filters import bingham_linear, rls
from jaxest.filters import savitzky_golay as sg
from jaxest.filters._small import eye
from jaxest.filters._state import apart
from jaxest.types import Array, ArrayLike


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
    accelerometer_bias: ArrayLike = 0.0
    """() m/s2, standard deviation of either accelerometer's bias along each axis; likewise."""
    accelerometer_turn: ArrayLike = 0.0
    """() rad, standard deviation about each axis of the turn of either accelerometer's axes against its gyroscope's,
    beyond what `accelerometer_axes` says: a calibration that slowly turns the sensor knows its scale far better."""


class Memory(NamedTuple):
    """What the next step needs, by name; `opened` gives it of a `State` and `closed` makes one of it."""

    windows: tuple[sg.State, sg.State]
    """Of IMU A and of P, each with stamps of its own; values (W, 6) rates, then specific forces; the steps are
    common."""
    rotation: bingham_linear.State
    position: rls.State
    lever: Array
    """(3, 12) sum of O_ki f_l in row i and column 4 k + l, f = (R f_P, 1): what errors of the rotation and of the
    forces do to the position."""
    gain: Array
    """() mean gain of the averages so far."""
    density: Array
    """() mean number of samples that a window stands for: 1, less where there are more steps than samples."""


class State(NamedTuple):
    """What the next step needs, in few arrays.

    Called sample by sample, every array of a state costs microseconds.
    """

    numbers: Array
    """(106,) all that `Memory` names and that has one size, one leaf after the other."""
    times: Array
    """(4, W) ages of A's and P's samples, then whether they are there."""
    values_a: Array
    """(W, 6) A's values. XLA on CPU runs a step in one thread, without handing pieces of it around, where no array is
    larger than 512 bytes: one array of both IMUs' values would be."""
    values_p: Array
    """(W, 6) P's."""
    recent: Array
    """(W + 3 N_lag,) ages of the steps, then the newest residuals of the position."""
    blocks: Array
    """(9, 9) of the position's sums over blocks of steps."""
    seen: Array
    """() int32, steps that the position has used."""
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
    """() int32, `OK` or `NON_FINITE`, also of readings beyond 7000 rad/s or m/s2 in float32 (7e30 in float64)."""


_SHAPES = ((), (6,), (6, 6), (3, 3), (3,), (3,), (9,), (3, 12), (), (), ())
_SIZES = tuple(math.prod(shape) for shape in _SHAPES)


def init(params: Params, *, key: Array | None = None, half_width: int = 7, lag: int = 20) -> State:
    """Return the state that has seen no data, in the dtype of the parameters.

    Args:
        params: the system's.
        key: not used.
        half_width: N, as for `build`.
        lag: N_lag, as for `build`.

    Returns:
        The state with index 0.
    """
    dtype = jnp.result_type(*(jnp.asarray(x) for x in params))
    zero = jnp.zeros((), dtype)
    window = sg.init(sg.Params(zero), half_width=half_width, channels=6)
    turn = bingham_linear.init(turning(params, dtype))
    place = rls.init(rls.Params(zero, zero, zero), lag=lag)
    return apart(closed(Memory((window, window), turn, place, jnp.zeros((3, 12), dtype), zero, zero), window.index))


def turning(params: Params, dtype: Any) -> bingham_linear.Params:
    """Return the parameters of the rotation's filter; the noise is that of a raw sample, for windows overlap."""
    noise, bias, forgetting = (
        jnp.asarray(x, dtype) for x in (params.gyroscope_noise, params.gyroscope_bias, params.forgetting_rotation)
    )
    covariance = (noise * noise)[None, None] * eye(3, noise)
    return bingham_linear.Params(covariance, covariance, math.sqrt(2) * bias, forgetting)


def opened(state: State) -> Memory:
    """Return what a state holds, by name; of a batch, its axis is behind all others."""
    width, index, batch = state.values_a.shape[0], state.index, state.numbers.shape[1:]
    ends = np.cumsum(_SIZES)[:-1].tolist()
    parts = [x.reshape(s + batch) for x, s in zip(jnp.split(state.numbers, ends), _SHAPES, strict=True)]
    weight, mean, scatter, information, projection, estimate, block, lever, gain, density, pending = parts
    elapsed, queue = state.recent[:width], state.recent[width:].reshape(-1, 3, *batch)
    windows = tuple(
        sg.State(state.times[k], value, state.times[2 + k] > 0, elapsed, index)
        for k, value in enumerate((state.values_a, state.values_p))
    )
    turn = bingham_linear.State(weight, mean, scatter, index)
    place = rls.State(
        information, projection, estimate, queue, block, state.blocks, pending > 0, state.seen, index
    )  # fmt: skip
    return Memory((windows[0], windows[1]), turn, place, lever, gain, density)


def closed(memory: Memory, index: Array) -> State:
    """Return the state of its parts; `index` () is the number of steps seen. As for `opened`, of one or a batch."""
    turn, place, batch = memory.rotation, memory.position, memory.gain.shape
    dtype = memory.gain.dtype
    leaves = (
        *turn[:3], place.information, place.projection, place.estimate, place.block, memory.lever, memory.gain,
        memory.density, place.pending.astype(dtype),
    )  # fmt: skip
    a, p = memory.windows
    times = jnp.stack([a.age, p.age, a.valid.astype(dtype), p.valid.astype(dtype)])
    recent = jnp.concatenate([a.elapsed, place.queue.reshape(-1, *batch)])
    numbers = jnp.concatenate([leaf.reshape(-1, *batch) for leaf in leaves])
    return State(numbers, times, a.value, p.value, recent, place.blocks, place.seen, index)


__all__ = ["Info", "Memory", "Params", "State", "closed", "init", "opened", "turning"]
