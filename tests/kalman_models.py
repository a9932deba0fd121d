"""A body that turns and moves among landmarks, as a Kalman model: on SO(3) x R^3, and as a system for the contract."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters import kalman, run
from jaxest.manifolds import Euclidean, product, quaternion
from jaxest.types import Reading, System

LANDMARKS = np.array([[2.0, 0.3, 1.0], [-1.0, 2.0, 0.5], [0.5, -1.5, -1.0]])


class Body(NamedTuple):
    orientation: object
    """(4,) body to world"""
    position: object
    """(3,) m"""


class Look(NamedTuple):
    gyroscope: Reading
    """(3,) rad/s; drives the dynamics"""
    landmarks: Reading
    """(3, 3) m, landmarks in the body frame, each with its own mask"""
    compass: Reading
    """(4,) an orientation"""
    dt: object


class Params(NamedTuple):
    turn: object = 0.05
    """rad/sqrt(s)"""
    move: object = 0.2
    """m/sqrt(s)"""
    landmark: object = 0.3
    """m"""
    compass: object = 0.2
    """rad"""
    start: object = 0.2
    """rad and m"""


BODY = product.of(Body(quaternion, Euclidean((3,))))


def dynamics(params, x, measurement):
    turned = quaternion.retract(x.orientation, measurement.gyroscope.value * measurement.dt)
    return Body(turned, x.position)


def process_noise(params, x, measurement):
    ones = jnp.ones(3, jnp.result_type(params.turn))
    return jnp.diag(jnp.concatenate([params.turn**2 * ones, params.move**2 * ones])) * measurement.dt


def seen(params, x, measurement):
    marks = jnp.asarray(LANDMARKS, x.position.dtype) - x.position[None]
    return jax.vmap(lambda p: quaternion.rotate(quaternion.inverse(x.orientation), p))(marks)


def landmark_noise(params, measurement):
    like = jnp.eye(3) + 0.3 * jnp.ones((3, 3))
    return jnp.tile((params.landmark**2 * like)[None], (3, 1, 1))


def model(loss=None, gate=None, **options):
    """Landmarks of correlated coordinates in blocks of three, and a compass on the manifold of rotations."""
    return kalman.Model(
        BODY,
        dynamics,
        process_noise,
        (
            kalman.sensor("landmarks", seen, landmark_noise, loss=loss, gate=gate),
            kalman.sensor(
                "compass",
                lambda params, x, measurement: x.orientation,
                lambda params, measurement: params.compass**2 * jnp.ones(3),
                manifold=quaternion,
            ),
        ),
        **options,
    )


def start(params, *, key=None):
    dtype = jnp.result_type(params.start)
    mean = Body(quaternion.identity(dtype), jnp.zeros(3, dtype))
    return kalman.init(mean, params.start**2 * jnp.eye(6, dtype=dtype))


def simulate(params, *, key, steps=12, missing=0.2):
    """Draw from the model itself: measurements, and the states they come from."""
    keys = jax.random.split(key, 6)
    state0 = start(params)
    dtype = state0.covariance.dtype
    normal = partial(jax.random.normal, dtype=dtype)
    dt = jnp.full(steps, 0.1, dtype)
    rates = jnp.cumsum(0.3 * normal(keys[0], (steps, 3)), axis=0)
    first = BODY.retract(state0.mean, params.start * normal(keys[1], (6,)))
    scales = jnp.concatenate([jnp.full(3, params.turn, dtype), jnp.full(3, params.move, dtype)])
    empty = Reading(jnp.zeros((3, 3), dtype), jnp.zeros(3, bool))

    def advance(x, inputs):
        rate, dt, noise = inputs
        look = Look(Reading(rate, jnp.bool_(True)), empty, empty, dt)
        x = BODY.retract(dynamics(params, x, look), scales * jnp.sqrt(dt) * noise)
        return x, x

    truth = jax.lax.scan(advance, first, (rates, dt, normal(keys[2], (steps, 6))))[1]
    root = params.landmark * jnp.linalg.cholesky(jnp.eye(3, dtype=dtype) + 0.3)
    marks = jax.vmap(lambda x: seen(params, x, None))(truth) + normal(keys[3], (steps, 3, 3)) @ root.T
    compass = jax.vmap(quaternion.retract)(truth.orientation, params.compass * normal(keys[4], (steps, 3)))
    there = jax.random.uniform(keys[5], (steps, 4)) >= missing
    there = there.at[5].set(True)
    look = Look(Reading(rates, jnp.ones(steps, bool)), Reading(marks, there[:, :3]), Reading(compass, there[:, 3]), dt)
    return look, truth


def build(**options):
    return System(Params(), start, kalman.filter_step(model(**options)), simulate)


def filtered(model, params, measurements, **options):
    return run(kalman.filter_step(model), params, start(params), measurements, **options)
