"""The pose of one IMU in another as a Kalman filter of a pose that drifts: what `onsite`'s forgetting is tuned by.

The live estimator moves its window by a sample at a time: its innovations share most of their samples, and a filter
that forgets quickly foretells their noise. Here windows lie side by side, their noise is their own, and all is linear
about the pose that the whole recording tells. Least squares that forget are then a Kalman filter whose unknowns move,
between two windows, by what forgetting takes from the information; its likelihood tells how much that should be.
Forgetting is by the sample, as the live estimator has it.

The unknowns are a turn (in P, rad), the difference of the gyros' biases (rad/s) and the place of P (m): 9 numbers.

Source: Sato 2024, eqs. 9 to 20 and 36; Anderson and Moore 1979 (Optimal filtering), section 6.2, for forgetting.
"""

import math
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.manifolds import quaternion as quat
from jaxest.manifolds._algebra import skew
from jaxest.systems import _onsite_window as win
from jaxest.systems import onsite_batch
from jaxest.systems.onsite_simulation import Pair
from jaxest.types import NON_FINITE, OK, Array, ArrayLike, Reading, System

SIZE = 9
TURN, REACH = 1.0, 1.0  # rad and m, standard deviations of the turn and the place along each axis before any data
PLACE = slice(6, 9)


class Params(NamedTuple):
    """What may be tuned; names as in `onsite.Params` where it has them."""

    gyroscope_noise: ArrayLike = 0.01
    """() rad/s, standard deviation of a sample of either gyro about each axis."""
    force_noise: ArrayLike = 0.1
    """() m/s2, standard deviation along each axis of what the motion does not explain of the difference of the specific
    forces, as of single samples: both accelerometers' noise, and that of the rates' derivatives times the distance."""
    forgetting_rotation: ArrayLike = 0.999
    """() at each sample, above 0 to 1; of the biases too."""
    forgetting_position: ArrayLike = 0.999
    """() at each sample, above 0 to 1."""
    gyroscope_bias: ArrayLike = 0.3
    """() rad/s, standard deviation of either gyro's bias about each axis."""


class Row(NamedTuple):
    """One window: value = slope unknowns + noise."""

    seen: Reading
    """value (6,): what is left of the rates, rad/s, and of the specific forces, m/s2, about the whole recording's pose;
    valid ()."""
    slope: Array
    """(6, 9)"""
    gain: Array
    """() variance of an average over that of a sample."""
    dt: Array
    """() s, since the window before."""


class State(NamedTuple):
    """What the next step needs."""

    mean: Array
    """(9,)"""
    covariance: Array
    """(9, 9)"""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate after a step."""

    mean: Array
    """(9,) turn from the whole recording's rotation, biases, place."""
    covariance: Array
    """(9, 9)"""
    innovation: Array
    """(6,) value less what the windows before foretell; 0 where not used."""
    log_likelihood: Array
    """() of the window, given those before."""
    nis: Array
    """() normalised innovation squared."""
    dof: Array
    """() int32, 6 where there is a window."""
    status: Array
    """() int32, `OK` or `NON_FINITE`."""


@partial(jax.jit, static_argnames=("half_width", "degree"))
def rows(measurements: Pair, about: onsite_batch.Estimate, *, half_width: int = 7, degree: int = 3) -> Row:
    """Cut a recording into windows side by side, linear about a pose.

    Args:
        measurements: leading axis T, both IMUs at the same times.
        about: what the whole recording says (`onsite_batch.solve`): its rotation and biases are taken off.
        half_width: N, a window is 2 N + 1 samples; static.
        degree: M of the fitted polynomials, static.

    Returns:
        Leaves (T // (2 N + 1), ...).
    """
    width = 2 * half_width + 1
    every = onsite_batch.averages(measurements, jnp.asarray(half_width, jnp.int32), half_width, degree)
    count = len(every.ready) // width
    window = jax.tree.map(lambda x: x[half_width::width][:count], every)
    r = quat.to_matrix(about.quaternion)
    noise = about.rate_residual**2 * jnp.eye(3, dtype=r.dtype)

    def one(window: win.Window) -> tuple[Array, Array]:
        o = win.regressor(window, r, about.bias_a, about.bias_p, noise)
        rate, force = window.p.rate - about.bias_p, window.p.force
        none = jnp.zeros_like(r)
        slope = jnp.block([[-_of(r, skew(rate)), jnp.eye(3, dtype=r.dtype), none], [_of(r, skew(force)), none, o]])
        left = window.a.rate - about.bias_a - _of(r, rate[:, None])[:, 0]
        return slope, jnp.concatenate([left, _of(r, force[:, None])[:, 0] - window.a.force - about.accelerometer_bias])

    slope, value = jax.vmap(one)(window)
    elapsed = jnp.asarray(measurements.dt)[: count * width].reshape(count, width).sum(axis=1)
    there: Any = window.ready
    return Row(Reading(value, there), slope, jnp.where(window.ready, window.gain, 1), elapsed)


def _of(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


def build(robot: None = None, sensors: None = None, *, half_width: int = 7) -> System:
    """Build the filter.

    Args:
        robot: not used; here because every system takes one.
        sensors: not used.
        half_width: N of the windows.

    Returns:
        The system, the same object for the same choice. Its measurement is a `Row`; `simulate` takes rows and draws
        what they would say of unknowns that drift as the parameters have it.
    """
    del robot, sensors
    return _build(2 * half_width + 1)


@cache
def _build(width: int) -> System:
    return System(Params(), init, partial(step, width=width), partial(simulate, width=width))


def init(params: Params, *, key: Array | None = None) -> State:
    """Return the state that has seen no data, in the dtype of the parameters; `key` is not used."""
    dtype = jnp.result_type(*(jnp.asarray(x) for x in params))
    bias = 2 * jnp.asarray(params.gyroscope_bias, dtype) ** 2
    variance = jnp.concatenate([jnp.full(3, TURN**2, dtype), jnp.full(3, bias), jnp.full(3, REACH**2, dtype)])
    return State(jnp.zeros(SIZE, dtype), jnp.diag(variance), jnp.zeros((), jnp.int32))


def step(params: Params, state: State, measurement: Row, *, key: Array | None = None, width: int) -> tuple[State, Info]:
    """Take in one window.

    Args:
        params: noise and forgetting.
        state: as `init` or the previous step returned it.
        measurement: one window; one that is not valid changes nothing, and nothing is forgotten.
        key: not used.
        width: samples of a window, static.

    Returns:
        The next state and the info.
    """
    del key
    dtype = state.covariance.dtype
    value, slope = jnp.asarray(measurement.seen.value, dtype), jnp.asarray(measurement.slope, dtype)
    finite = jnp.all(jnp.isfinite(value)) & jnp.all(jnp.isfinite(slope))
    valid = jnp.asarray(measurement.seen.valid) & finite
    value, slope = jnp.where(valid, value, 0), jnp.where(valid, slope, 0)
    covariance = state.covariance + jnp.where(valid, drift(params, state.covariance, width), 0)
    first = value - jnp.sum(slope * state.mean[None], axis=1)

    def one(carry: tuple[Array, Array], row: tuple[Array, Array, Array]) -> tuple[Any, tuple[Array, Array]]:
        mean, covariance = carry
        y, h, noise = row
        gain = jnp.sum(covariance * h[None], axis=1)
        spread, away = jnp.sum(h * gain) + noise, y - jnp.sum(h * mean)
        covariance = covariance - gain[:, None] * gain[None] / spread
        return (mean + gain * away / spread, (covariance + covariance.T) / 2), (away * away / spread, jnp.log(spread))

    # Each of the six numbers has noise of its own: taken in one by one, no matrix is inverted.
    noise = jnp.where(valid, measurement.gain, 1) * variances(params, dtype)
    (mean, covariance), (squares, logs) = jax.lax.scan(one, (state.mean, covariance), (value, slope, noise))
    nis = jnp.where(valid, jnp.sum(squares), 0)
    log = jnp.where(valid, -(nis + jnp.sum(logs) + len(squares) * math.log(2 * math.pi)) / 2, 0)
    covariance = jnp.where(valid, covariance, state.covariance)
    status = jnp.where(finite | ~jnp.asarray(measurement.seen.valid), OK, NON_FINITE).astype(jnp.int32)
    dof = len(squares) * valid.astype(jnp.int32)
    info = Info(mean, covariance, jnp.where(valid, first, 0), log, nis, dof, status)
    return State(mean, covariance, state.index + 1), info


def drift(params: Params, covariance: Array, width: int) -> Array:
    """Return the covariance (9, 9) by which the unknowns move before the next window, as least squares that forget."""
    dtype = covariance.dtype
    turn, place = (
        jnp.asarray(x, dtype) ** -width - 1 for x in (params.forgetting_rotation, params.forgetting_position)
    )  # fmt: skip
    moves = np.arange(SIZE) >= PLACE.start
    grown = jnp.where(moves[:, None] & moves[None], place, jnp.where(moves[:, None] | moves[None], 0, turn))
    return grown * covariance


def variances(params: Params, dtype: Any) -> Array:
    """Return the variances (6,) of a window's numbers, as of single samples."""
    rate, force = (jnp.asarray(x, dtype) ** 2 for x in (params.gyroscope_noise, params.force_noise))
    return jnp.concatenate([jnp.full(3, 2 * rate), jnp.full(3, force)])


def simulate(params: Params, *, key: Array, rows: Row, width: int = 15) -> tuple[Row, Array]:
    """Draw what windows say of unknowns that drift.

    Args:
        params: noise and forgetting.
        key: random key.
        rows: leaves (K, ...), whose values are drawn anew.
        width: samples of a window, static.

    Returns:
        The rows, and the unknowns (K, 9) at each, which start at 0.
    """
    state = init(params)

    def advance(carry: tuple[Array, State], now: tuple[Row, Array]) -> tuple[Any, tuple[Array, Array]]:
        x, state = carry
        row, key = now
        grown = jnp.where(row.seen.valid, drift(params, state.covariance, width), 0)
        root = linalg.cholesky(grown + 1e-12 * jnp.eye(SIZE))
        normal = jax.random.normal(key, (SIZE + 6,), x.dtype)
        x = x + jnp.where(row.seen.valid & (state.index > 0), _of(root, normal[:SIZE, None])[:, 0], 0)
        noise = jnp.sqrt(row.gain * variances(params, x.dtype))
        value = jnp.sum(row.slope * x[None], axis=1) + noise * normal[SIZE:]
        row = row._replace(seen=row.seen._replace(value=value))
        return (x, step(params, state, row, width=width)[0]), (value, x)

    keys = jax.random.split(key, rows.gain.shape[0])
    values, x = jax.lax.scan(advance, (state.mean, state), (rows, keys))[1]
    return rows._replace(seen=rows.seen._replace(value=values)), x


__all__ = ["Info", "Params", "Row", "State", "build", "drift", "init", "rows", "simulate", "step", "variances"]
