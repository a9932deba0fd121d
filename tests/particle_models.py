"""Two joints seen by encoders and a marker at the tip, as a particle filter: for the contract and for its own tests."""

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.special import i0e

from jaxest.filters import particle
from jaxest.filters.resampling import systematic
from jaxest.manifolds import Power, circle
from jaxest.types import Reading, System

JOINTS = Power(circle, 2)


class Seen(NamedTuple):
    encoder: Reading
    """(2,) rad, each joint with its own mask"""
    marker: Reading
    """(2,) m, the tip of two links of 1 m in the plane"""
    dt: object


class Params(NamedTuple):
    walk: object = 0.4
    """rad, of each step"""
    encoder: object = 15.0
    """concentration"""
    marker: object = 0.05
    """m"""


def von_mises(v, concentration):
    return concentration * (jnp.cos(v) - 1) - jnp.log(2 * jnp.pi * i0e(concentration))


def tip(x):
    return jnp.stack([jnp.cos(x[0]) + jnp.cos(x[0] + x[1]), jnp.sin(x[0]) + jnp.sin(x[0] + x[1])])


def wide(valid, value):
    return jnp.broadcast_to(jnp.reshape(valid, jnp.shape(valid) + (1,) * (value.ndim - jnp.ndim(valid))), value.shape)


def log_likelihood(params, x, measurement):
    encoder, marker = measurement.encoder, measurement.marker
    angles = jnp.where(encoder.valid, encoder.value - x, 0)
    way = jnp.where(wide(marker.valid, marker.value), marker.value - tip(x), 0)
    one = von_mises(angles, jnp.asarray(params.encoder))
    two = -((way / params.marker) ** 2) / 2 - jnp.log(params.marker) - jnp.log(2 * jnp.pi) / 2
    return jnp.sum(jnp.where(encoder.valid, one, 0)) + jnp.sum(jnp.where(wide(marker.valid, way), two, 0))


def residual(params, x, measurement):
    """Half the squared length is what the log-likelihood falls by: 2 sin(e/2) is the root of 2 (1 - cos e)."""
    encoder, marker = measurement.encoder, measurement.marker
    angles = jnp.where(encoder.valid, encoder.value - x, 0)
    way = jnp.where(wide(marker.valid, marker.value), marker.value - tip(x), 0)
    return jnp.concatenate([2 * jnp.sin(angles / 2) * jnp.sqrt(params.encoder), way / params.marker])


def stay(params, x, measurement):
    return x


WALK = particle.gaussian(stay, lambda params, measurement: jnp.full(2, params.walk, jnp.result_type(params.walk)))
BOOTSTRAP = particle.bootstrap(JOINTS, WALK, log_likelihood)
GUIDED = particle.guided(JOINTS, WALK, log_likelihood, particle.differentiated(JOINTS, residual))


def start(params, *, key, count=48):
    dtype = jnp.result_type(params.walk)
    return particle.init(jax.random.uniform(key, (count, 2), dtype, -1, 2))


def simulate(params, *, key, steps=12, missing=0.2) -> Any:
    """Draw measurements, and the angles they come from."""
    keys = jax.random.split(key, 5)
    dtype = jnp.result_type(params.walk)
    normal = partial(jax.random.normal, dtype=dtype)
    x = jnp.array([[0.4, 0.7]], dtype) + 0.2 * jnp.cumsum(normal(keys[0], (steps, 2)), axis=0)
    encoder = circle.wrap(x + normal(keys[1], (steps, 2)) / jnp.sqrt(params.encoder))
    marker = jax.vmap(tip)(x) + params.marker * normal(keys[2], (steps, 2))
    there = (jax.random.uniform(keys[3], (steps, 3)) >= missing).at[5].set(True)
    dt = jnp.full(steps, 0.01, dtype)
    return Seen(Reading(encoder, there[:, :2]), Reading(marker, there[:, 2]), dt), x


@cache
def build(propose=BOOTSTRAP, resample=systematic, count=48):
    step = particle.filter_step(particle.Model(JOINTS, propose, resample))
    return System(Params(), partial(start, count=count), step, simulate)
