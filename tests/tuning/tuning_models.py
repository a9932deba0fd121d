"""A random walk seen through noise: a Kalman filter, a particle filter, and data whose parameters are known."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxest import tuning
from jaxest.filters import kalman, particle
from jaxest.manifolds import Euclidean
from jaxest.types import Reading, System

LINE = Euclidean((1,))


class Params(NamedTuple):
    """Standard deviations."""

    walk: object = 0.5
    seen: object = 1.0
    pull: object = 0.9
    scale: object = 1.0
    """Multiplies `seen`: the two cannot be told apart."""


class Seen(NamedTuple):
    value: Reading
    dt: object


def mean(params, x, measurement):
    return params.pull * x


def deviation(params, measurement):
    return jnp.asarray(params.walk)[None]


def noise(params):
    return jnp.asarray(params.seen * params.scale)


def log_likelihood(params, x, measurement):
    z = (jnp.where(measurement.value.valid, measurement.value.value - x, 0) / noise(params))[0]
    return jnp.where(measurement.value.valid, -(z * z + jnp.log(2 * jnp.pi * noise(params) ** 2)) / 2, 0)


MODEL = kalman.Model(
    LINE,
    mean,
    lambda params, x, measurement: jnp.square(jnp.asarray(params.walk))[None, None],
    (kalman.sensor("value", lambda params, x, z: x, lambda params, z: noise(params)[None] ** 2),),
)
NOISE = particle.gaussian(mean, deviation)
FILTER = particle.Model(LINE, particle.bootstrap(LINE, NOISE, log_likelihood))


def begin(params):
    return kalman.init(jnp.zeros(1), jnp.eye(1))


KALMAN = tuning.kalman_system(MODEL, begin)


def particles(step, count=256):
    import jax

    def init(params, *, key=None):
        return particle.init(jax.random.normal(key, (count, 1)))

    return System(Params(), init, step, None)


def drawn(seed, steps=60, walk=0.5, seen=1.0, pull=0.9, missing=0.1):
    """One recording of that model, the state as its truth."""
    rng = np.random.default_rng(seed)
    x, states, values = rng.normal(), [], []
    for _ in range(steps):
        x = pull * x + walk * rng.normal()
        states.append([x])
        values.append([x + seen * rng.normal()])
    valid = rng.uniform(size=steps) >= missing
    measurements = Seen(Reading(np.array(values, np.float32), valid), np.ones(steps, np.float32))
    return tuning.recording(measurements, np.array(states, np.float32))
