"""How an IMU moves: pose, velocity and biases, carried from scan to scan by its samples.

Source: Forster et al. 2017 (On-manifold preintegration) for the integration over an interval; the errors here are those
of the state, differentiated through it.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters._time import elapsed
from jaxest.filters.kalman import Gaussian, predict
from jaxest.manifolds import Euclidean, product, quaternion, se3
from jaxest.types import Array


class Track(NamedTuple):
    """How the IMU moves, and what it is off by."""

    pose: Any
    """IMU to world."""
    velocity: Any
    """(3,) m/s, in the world."""
    gyroscope: Any
    """(3,) rad/s, bias."""
    accelerometer: Any
    """(3,) m/s2, bias."""


MANIFOLD = product.of(Track(se3, *(Euclidean((3,)) for _ in range(3))))
"""Where a `Track` lives: 15 dimensions in the order of its fields, rotation before translation."""


def advance(track: Track, gyroscope: Array, accelerometer: Array, gravity: Array, dt: Array) -> Track:
    """Move over one sample whose rate and specific force are constant in the IMU's axes at its middle.

    Args:
        track: at its beginning.
        gyroscope: (3,) rad/s.
        accelerometer: (3,) m/s2.
        gravity: (3,) m/s2, in the world.
        dt: () s.

    Returns:
        The track at its end.
    """
    turn = (gyroscope - track.gyroscope) * dt
    middle = quaternion.retract(track.pose.rotation, turn / 2)
    push = quaternion.rotate(middle, accelerometer - track.accelerometer) + gravity
    place = track.pose.translation + (track.velocity + push * dt / 2) * dt
    pose = se3.Pose(quaternion.retract(track.pose.rotation, turn), place)
    return track._replace(pose=pose, velocity=track.velocity + push * dt)


def integrate(params: Any, track: Gaussian, measurement: Any, gravity: Array) -> tuple[Gaussian, Array]:
    """Move over the samples between two scans.

    Args:
        params: the IMU's noise, as in `slam_inertial.Params`.
        track: at the scan before.
        measurement: with S samples, as `slam_inertial.Driven`.
        gravity: (3,) m/s2.

    Returns:
        The track at this scan, and the covariance (6, 6) of how far the pose is from where it was: rotation and
        translation in the IMU's axes.
    """
    dtype = track.covariance.dtype
    zero = jnp.zeros((), dtype)
    white = (params.gyroscope, zero, params.accelerometer, params.gyroscope_walk, params.accelerometer_walk)
    density = jnp.concatenate([jnp.broadcast_to(jnp.asarray(d, dtype) ** 2, 3) for d in white])
    moving = jnp.where(jnp.arange(15) < 6, 0, 1).astype(dtype)
    here = track.covariance * moving[:, None] * moving[None, :]

    def over(beliefs: tuple[Array, Gaussian], row: tuple[Array, Array, Array]) -> tuple[tuple[Array, Gaussian], None]:
        apart, belief = beliefs
        gyroscope, accelerometer, dt = row
        noise = jnp.diag(density * dt)

        def move(x: Track) -> Track:
            return advance(x, gyroscope, accelerometer, gravity, dt)

        both = (predict(MANIFOLD, belief._replace(covariance=p), move, noise) for p in (apart, belief.covariance))
        first, second = both
        return (first.covariance, second), None

    samples = (measurement.gyroscope.value, measurement.accelerometer.value, elapsed(measurement.spacing)[0])
    (apart, after), _ = jax.lax.scan(over, (here, track), jax.tree.map(lambda x: jnp.asarray(x, dtype), samples))
    return after, apart[:6, :6]


__all__ = ["MANIFOLD", "Track", "advance", "integrate"]
