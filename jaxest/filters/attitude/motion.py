"""The state of an IMU that moves about, and how it and its errors move between two corrections."""

import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxest.filters.imu import Sample
from jaxest.manifolds import Euclidean, product
from jaxest.manifolds import quaternion as quat
from jaxest.types import Array, ArrayLike


@dataclasses.dataclass(frozen=True)
class EarthRotation:
    """Orientations (4,) whose errors are rotation vectors in the earth frame: `retract(x, v)` is `exp(v) x`."""

    dim: int = 3

    def retract(self, x: ArrayLike, v: ArrayLike) -> Array:
        """Return x (4,) turned by v (3,), rad in the earth frame."""
        return quat.normalize(quat.compose(quat.exp(v), x))

    def local(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the rotation vector (3,), rad in the earth frame, that turns x (4,) to y (4,)."""
        return quat.log(quat.compose(y, quat.inverse(x)))

    def mean(self, xs: ArrayLike, weights: ArrayLike | None = None) -> Array:
        """Return the mean orientation of xs (N, 4); the frame of the errors does not matter."""
        return quat.mean(xs, weights)

    def interpolate(self, x: ArrayLike, y: ArrayLike, t: ArrayLike) -> Array:
        """Return the orientation at the fraction t () of the way from x to y."""
        return quat.interpolate(x, y, t)


class Track(NamedTuple):
    """What is estimated."""

    orientation: Any
    """(4,) wxyz, sensor to a frame that is upright and whose heading is the gyroscope's own."""
    velocity: Any
    """(2,) m/s, horizontal, without what is too slow to be seen."""
    position: Any
    """(2,) m, horizontal, likewise."""
    bias: Any
    """(3,) rad/s, gyro bias."""
    scale: Any
    """(3,) without unit: the rate about an axis is `(1 + scale) (reading - bias)`."""
    field: Any
    """(3,) magnetic field in the frame of `orientation`, as a multiple of the first reading's norm."""


MANIFOLD = product.of(
    Track(EarthRotation(), Euclidean((2,)), Euclidean((2,)), Euclidean((3,)), Euclidean((3,)), Euclidean((3,)))
)
"""Where a `Track` lives: 16 dimensions in the order of its fields."""
_FIELD = slice(13, 16)


class Since(NamedTuple):
    """Sums over the samples since the last correction."""

    time: Array
    """() s."""
    turn: Array
    """(3, 3) s, integral of the rotation matrix."""
    sweep: Array
    """(3, 3) rad, integral of the rotation matrix with its columns times the rates about them."""
    push: Array
    """(3,) m/s, integral of the specific force in the earth frame."""
    stir: Array
    """() rad^2/s, integral of the squared rate."""
    blind: Array
    """() s without a rate."""
    afloat: Array
    """() s that no specific force stands for."""
    rate: Array
    """(3,) rad/s, sum of the gyro's readings."""
    rates: Array
    """() number of them."""
    field: Array
    """(3,) sum of the magnetometer's readings, turned into the frame of the orientation."""
    fields: Array
    """() number of them."""
    waiting: Array
    """() s since the last specific force, corrections or not: the next one stands for this time too."""


def begin(dtype: Any) -> Since:
    """Return the sums of no sample."""
    scalar, vector, matrix = (jnp.zeros(shape, dtype) for shape in ((), 3, (3, 3)))
    return Since(scalar, matrix, matrix, vector, scalar, scalar, scalar, vector, scalar, vector, scalar, scalar)


def again(since: Since) -> Since:
    """Return the sums of no sample behind a correction."""
    return begin(since.time.dtype)._replace(waiting=since.waiting)


def integrate(track: Track, since: Since, sample: Sample, hold: ArrayLike) -> tuple[Track, Since]:
    """Move the estimate by one sample.

    Args:
        track: the estimate at the previous sample.
        since: sums since the last correction.
        sample: values and flags; a missing rate counts as no rotation, a missing force waits for the next.
        hold: () s, longest time that one rate stands for, and one specific force.

    Returns:
        The estimate at this sample, and the sums.
    """
    dt, gyro, acc, mag = sample.dt, sample.gyroscope, sample.accelerometer, sample.magnetometer
    rate = jnp.where(gyro.valid, (1 + track.scale) * (gyro.value - track.bias), 0)
    covered = jnp.where(gyro.valid, jnp.minimum(dt, hold), 0)
    orientation = quat.retract(track.orientation, rate * covered)
    matrix = quat.to_matrix(orientation)
    waiting = since.waiting + dt
    stood = jnp.where(acc.valid, jnp.minimum(waiting, hold), 0)
    push = jnp.sum(matrix * acc.value[None, :], axis=1) * stood  # its flat part is the sensor's own
    moved = track._replace(
        orientation=orientation,
        velocity=track.velocity + push[:2],
        position=track.position + track.velocity * dt,
    )
    sums = Since(
        since.time + dt,
        since.turn + matrix * covered,
        since.sweep + matrix * (rate * covered)[None, :],
        since.push + push,
        since.stir + jnp.sum(rate * rate) * covered,
        since.blind + (dt - covered),
        since.afloat + jnp.maximum(waiting - hold, 0) - jnp.maximum(since.waiting - hold, 0),
        since.rate + gyro.value,
        since.rates + gyro.valid,
        since.field + jnp.where(mag.valid, jnp.sum(matrix * mag.value[None, :], axis=1), 0),
        since.fields + mag.valid,
        jnp.where(acc.valid, 0, waiting),
    )
    return moved, Since(*(jnp.asarray(s, dt.dtype) for s in sums))


def carry(scale: Array, since: Since) -> Array:
    """Return how errors move over the samples summed up in `since`.

    Args:
        scale: (3,) the gyro's scale in the estimate.
        since: the sums.

    Returns:
        (16, 16), to first order in the errors; the velocity's is counted from the orientation at the start.
    """
    dtype = since.time.dtype
    x, y, z = since.push
    zero = jnp.zeros((), dtype)
    pushed = jnp.stack([jnp.stack([zero, z, -y]), jnp.stack([-z, zero, x])])  # theta x push, its flat part
    two = jnp.eye(2, dtype=dtype)
    transition = jnp.eye(16, dtype=dtype)
    transition = transition.at[0:3, 7:10].set(-since.turn * (1 + scale)[None, :])
    rates = since.sweep / (1 + scale)[None, :]
    transition = transition.at[0:3, 10:13].set(rates)
    transition = transition.at[3:5, 0:3].set(pushed)
    transition = transition.at[5:7, 0:3].set(pushed * since.time / 2)
    return transition.at[5:7, 3:5].set(two * since.time)


__all__ = ["MANIFOLD", "EarthRotation", "Since", "Track", "again", "begin", "carry", "integrate"]
