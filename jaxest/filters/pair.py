"""Passive complementary filter of IMU pairs: the rotation between two IMUs directly from what both measure.

For an edge list over any number of IMUs, all edges in one step. An edge (i, j) holds the rotation from the frame of IMU
j to that of IMU i (the paper's R_12 with i = 1 and j = 2). Both IMUs are taken to feel the same specific force and the
same field, which holds for slow motion and for IMUs that are close to each other.

Errors and relative rates are in the frame of the second IMU, where the correction acts (the paper's eqs. 18 to 20 mix
frames). Each IMU has a bias of its own: the paper's one integral per pair would have to turn with the posture. What no
vector sees stays where the gyroscopes lead it: without a magnetometer the rotation about the vertical.

Source: Santaera 2015, Algorithm 2; step 8 with dt in place of 1/dt.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters._state import apart
from jaxest.filters.complementary import Params
from jaxest.filters.imu import Imu, Sample, directed, usable
from jaxest.manifolds import quaternion as quat
from jaxest.types import Array, InputError, Reading, Step

Edges = tuple[tuple[int, int], ...]


class State(NamedTuple):
    """What the next step needs, for e edges over n IMUs."""

    quaternion: Array
    """(e, 4) wxyz, second IMU of the edge to first."""
    bias: Array
    """(n, 3) rad/s, gyro bias of each IMU, shared by its edges."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""
    initialized: Array
    """(e,) bool, whether two accelerometer samples have set all but the rotation about the vertical."""
    heading_initialized: Array
    """(e,) bool, whether two magnetometer samples have set that."""


class Info(NamedTuple):
    """The estimate of one step and how it came about."""

    quaternion: Array
    """(e, 4) wxyz, second IMU of the edge to first, at this sample."""
    bias: Array
    """(n, 3) rad/s, gyro bias."""
    error_acc: Array
    """(e, 3) innovation of the accelerometers, sine of an angle about the second IMU's axes; 0 where not used."""
    error_mag: Array
    """(e, 3) innovation of the magnetometers, likewise; 0 where not used."""
    valid: Array
    """(e,) bool, whether each vector sensor has set its part of the rotation yet."""
    status: Array
    """() int32, `OK` or `NON_FINITE`; see `jaxest.types.status_message`."""


def checked(edges: Sequence[tuple[int, int]], imus: int) -> Edges:
    """Return an edge list as a tuple, which is static.

    Args:
        edges: (first, second) IMU of each pair.
        imus: how many IMUs there are.

    Returns:
        The edges.

    Raises:
        InputError: there is none, an IMU does not exist, or an edge leads from an IMU to itself.
    """
    if not edges:
        raise InputError("edges: got none, expected at least one pair of IMUs")
    for edge in edges:
        if len(edge) != 2 or edge[0] == edge[1] or not all(0 <= i < imus for i in edge):
            raise InputError(f"edges: got {tuple(edge)}, expected two different IMUs, each 0 to {imus - 1}")
    return tuple((int(i), int(j)) for i, j in edges)


def init(params: Params, edges: Edges, imus: int, *, key: Array | None = None) -> State:
    """Return the state that has seen no data; the first valid accelerometer samples of both IMUs set an edge.

    Args:
        params: gains and weights, those of `complementary`; their dtype becomes that of the state.
        edges: static, from `checked`.
        imus: number of IMUs n, static.
        key: not used.

    Returns:
        The state with index 0.
    """
    dtype = jnp.result_type(*params)
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    no = jnp.zeros(len(edges), bool)
    one = jnp.tile(quat.identity(dtype)[None], (len(edges), 1))
    return apart(State(one, jnp.zeros((imus, 3), dtype), jnp.zeros((), jnp.int32), no, no))


def step(
    params: Params, state: State, measurement: Imu, *, edges: Edges, key: Array | None = None
) -> tuple[State, Info]:
    """Take in one sample of every IMU.

    What is masked or not finite adds exactly nothing; where a gyro sample of either IMU is missing the edge counts as
    not turning. The first accelerometer samples set the shortest rotation between them, the first magnetometer samples
    the rest.

    Args:
        params: gains and the weights lambda of eq. 7.
        state: as `init` or the previous step returned it; its dtype is that of the computation.
        measurement: `Imu` with a leading axis of n IMUs on values and flags, and one `dt`; any sensor of any IMU may be
            missing.
        edges: static, the pairs; bind them with `functools.partial`, or use `over`.
        key: not used.

    Returns:
        The next state and the info.

    Raises:
        ValueError: a sensor's value is not (n, 3).

    Source: Santaera 2015, Algorithm 2. The biases descend the same error as Mahony's: that of the second IMU by
    -K_i e, that of the first by +K_i R_12 e, because the relative rate is (w_2 - b_2) - R_12' (w_1 - b_1).
    """
    dtype = state.quaternion.dtype
    params = Params(*(jnp.asarray(x, dtype) for x in params))
    sample = _usable(measurement, dtype, state.bias.shape[0])
    first, second = (np.array([edge[i] for edge in edges]) for i in (0, 1))
    gyro = sample.gyroscope
    sample = sample._replace(gyroscope=gyro._replace(value=jnp.where(gyro.valid[:, None], gyro.value - state.bias, 0)))
    one, two = (
        Sample._make([*(Reading(x.value[at], x.valid[at]) for x in sample[:3]), *sample[3:]]) for at in (first, second)
    )
    each: Any = Sample._make([0, 0, 0, None, None])
    own: Any = State._make([0, None, None, 0, 0])
    edge = jax.vmap(partial(_edge, params), (own, each, each), (own, 0, 0, 0))
    moved, error, error_acc, error_mag = edge(state, one, two)
    onto = np.zeros((2, state.bias.shape[0], len(edges)), dtype)
    onto[0, first, np.arange(len(edges))] = onto[1, second, np.arange(len(edges))] = 1
    turned = jax.vmap(quat.rotate)(state.quaternion, error)
    drift = jnp.sum(onto[1][:, :, None] * error[None], axis=1) - jnp.sum(onto[0][:, :, None] * turned[None], axis=1)
    bias = state.bias - params.integral_gain * sample.dt * drift
    after = moved._replace(bias=bias, index=state.index + 1)
    valid = after.initialized
    if measurement.magnetometer is not None:
        valid = valid & after.heading_initialized
    return after, Info(after.quaternion, bias, error_acc, error_mag, valid, sample.status)


def over(edges: Sequence[tuple[int, int]], imus: int) -> tuple[Any, Step]:
    """Return `init` and `step` with the edges bound, as `jaxest.filters.run` takes them.

    Args:
        edges: (first, second) IMU of each pair.
        imus: number of IMUs.

    Returns:
        `init(params, *, key=None)` and `step(params, state, measurement, *, key=None)`.

    Raises:
        InputError: as `checked`.
    """
    bound = checked(edges, imus)
    return partial(init, edges=bound, imus=imus), partial(step, edges=bound)


def tree(imus: int, parents: Sequence[int]) -> Edges:
    """Return the edges of a tree: each IMU but the roots behind its parent.

    Args:
        imus: number of IMUs.
        parents: parent of each IMU, -1 for a root.

    Returns:
        Edges (parent, child).

    Raises:
        InputError: a parent does not exist, or there are not as many as IMUs.
    """
    if len(parents) != imus:
        raise InputError(f"parents: got {len(parents)}, expected one for each of {imus} IMUs")
    return checked([(p, i) for i, p in enumerate(parents) if p >= 0], imus)


def _usable(measurement: Imu, dtype: Any, imus: int) -> Sample:
    for name in Imu._fields[:3]:
        reading = getattr(measurement, name)
        if reading is not None and jnp.shape(reading.value) != (imus, 3):
            raise ValueError(f"measurement.{name}: got shape {jnp.shape(reading.value)}, expected ({imus}, 3)")
    axes: Any = Imu._make([0, 0, None if measurement.magnetometer is None else 0, None])
    sample = jax.vmap(lambda m: directed(usable(m, dtype)), (axes,))(measurement)
    return sample._replace(dt=sample.dt[0], status=jnp.max(sample.status))


def _edge(params: Any, state: State, one: Sample, two: Sample) -> tuple[State, Array, Array, Array]:
    """Move one edge; return also the weighted error and its parts, in the frame of the second IMU."""
    back = quat.inverse(state.quaternion)
    gyro, acc, mag = (a.valid & b.valid for a, b in zip(one[:3], two[:3], strict=True))
    error_acc = jnp.cross(two.accelerometer.value, quat.rotate(back, one.accelerometer.value))
    error_mag = jnp.cross(two.magnetometer.value, quat.rotate(back, one.magnetometer.value))
    error_acc = jnp.where(state.initialized & acc, error_acc, 0)
    ready = state.initialized & state.heading_initialized
    error_mag = jnp.where(ready & mag, error_mag, 0)
    error = params.lambda_acc * error_acc + params.lambda_mag * error_mag
    rate = two.gyroscope.value - quat.rotate(back, one.gyroscope.value)
    rate = jnp.where(gyro, rate, 0) + params.proportional_gain * error
    moved = quat.retract(state.quaternion, rate * two.dt)
    quaternion, initialized, headed = _begun(state, moved, one, two)
    after = state._replace(quaternion=quaternion, initialized=initialized, heading_initialized=headed)
    return after, error, error_acc, error_mag


def _begun(state: State, moved: Array, one: Sample, two: Sample) -> tuple[Array, Array, Array]:
    """The next rotation, set by the first samples of the vector sensors instead of moved."""
    acc, mag = (a.valid & b.valid for a, b in zip(one[1:3], two[1:3], strict=True))
    forces, fields = ((b.value, a.value) for a, b in zip(one[1:3], two[1:3], strict=True))
    initialized = state.initialized | acc
    shortest = quat.from_two_vectors(*forces)
    quaternion = jnp.where(state.initialized, moved, jnp.where(acc, shortest, state.quaternion))
    up = quat.rotate(quaternion, forces[0])
    flat = [v - jnp.sum(v * up) * up for v in (quat.rotate(quaternion, fields[0]), fields[1])]
    square = [jnp.sum(v * v) for v in flat]
    there = (square[0] > 0) & (square[1] > 0)
    level = [
        jnp.where(there, v, jnp.eye(3, dtype=v.dtype)[0]) / jnp.sqrt(jnp.where(there, s, 1))
        for v, s in zip(flat, square, strict=True)
    ]
    first = ~state.heading_initialized & initialized & mag & acc & there
    turned = quat.normalize(quat.compose(quat.from_two_vectors(*level), quaternion))
    return jnp.where(first, turned, quaternion), initialized, state.heading_initialized | first


__all__ = ["Edges", "Info", "Params", "State", "checked", "init", "over", "step", "tree"]
