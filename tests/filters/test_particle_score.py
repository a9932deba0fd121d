"""The gradient of a particle filter's log-likelihood is the score, by Fisher's identity, to within its sampling error.

The exact score is the Kalman filter's gradient. An estimate from N particles has a bias of the order of 1 / N, allowed
here as 3 % of the score's size; differentiating through resampling instead is wrong by much more (the last test).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK

from jaxest.filters import kalman, particle, resampling, run
from jaxest.manifolds import Euclidean
from jaxest.types import Reading

PLANE = Euclidean((2,))
RUNS, COUNT = 300, 512
VALUES = np.array([0.3, 0.9, 0.0, 1.6, 1.4, 1.9])
VALID = VALUES != 0.0


class Seen(NamedTuple):
    value: Reading
    dt: object


class Params(NamedTuple):
    walk: object
    """(2,)"""
    seen: object
    pull: object
    """what the mean is multiplied by"""


PARAMS = Params(jnp.array([0.3, 0.4]), jnp.array(0.25), jnp.array(0.85))


def mean(params, x, measurement):
    return params.pull * jnp.stack([x[0] + 0.3 * x[1], x[1]])


def residual(params, x, measurement):
    return jnp.where(measurement.value.valid, measurement.value.value - x[0], 0)[None] / params.seen


def log_likelihood(params, x, measurement):
    square = jnp.sum(residual(params, x, measurement) ** 2)
    return jnp.where(measurement.value.valid, -(square + jnp.log(2 * jnp.pi * params.seen**2)) / 2, 0)


NOISE = particle.gaussian(mean, lambda params, measurement: params.walk)
ROWS = particle.differentiated(PLANE, residual)
KALMAN = kalman.Model(
    PLANE,
    mean,
    lambda params, x, measurement: jnp.diag(params.walk**2),
    (kalman.sensor("value", lambda params, x, z: x[0], lambda params, z: params.seen[None] ** 2),),
)


def line(values):
    return Seen(Reading(values, jnp.asarray(VALID)), jnp.ones(len(VALUES)))


def exact_score():
    def total(params, values):
        start = kalman.init(jnp.zeros(2), jnp.eye(2))
        return jnp.sum(run(kalman.filter_step(KALMAN), params, start, line(values))[1].log_likelihood)

    return jax.jit(jax.grad(total, (0, 1)), compiler_options=QUICK)(PARAMS, jnp.asarray(VALUES, jnp.float32))


def estimated_scores(model):
    def total(params, values, key):
        first, rest = jax.random.split(key)
        start = particle.init(jax.random.normal(first, (COUNT, 2)))
        return jnp.sum(run(particle.filter_step(model), params, start, line(values), key=rest)[1].log_likelihood)

    keys = jax.random.split(jax.random.key(1), RUNS)
    gradient = jax.jit(jax.vmap(jax.grad(total, (0, 1)), (None, None, 0)), compiler_options=QUICK)
    return gradient(PARAMS, jnp.asarray(VALUES, jnp.float32), keys)


@pytest.mark.parametrize(
    ("propose", "resample"),
    [
        pytest.param(particle.bootstrap(PLANE, NOISE, log_likelihood), resampling.systematic, marks=pytest.mark.slow),
        (particle.bootstrap(PLANE, NOISE, log_likelihood), resampling.adaptive(resampling.stratified, 0.6)),
        pytest.param(
            particle.guided(PLANE, NOISE, log_likelihood, ROWS, iterations=1),
            resampling.systematic,
            marks=pytest.mark.slow,
        ),
        (particle.guided(PLANE, NOISE, log_likelihood, ROWS, defensive=0.1), resampling.residual),
    ],
    ids=["bootstrap", "adaptive", "guided", "defensive"],
)
def test_gradient_is_the_score(propose, resample):
    exact = exact_score()
    found = estimated_scores(particle.Model(PLANE, propose, resample))
    for (path, one), many in zip(jax.tree_util.tree_leaves_with_path(exact), jax.tree.leaves(found), strict=True):
        one, many = np.asarray(one), np.asarray(many)
        error = many.std(axis=0) / np.sqrt(RUNS)
        size = np.abs(one).max()
        assert np.all(error < 0.2 * size), path  # a test that could not fail otherwise
        off = np.abs(many.mean(axis=0) - one)
        assert np.all(off < 4.5 * error + 0.03 * size), (path, off, error, one)
    assert np.all(np.asarray(found[1])[:, ~VALID] == 0)  # nothing leads to a masked value


def test_frozen_random_numbers_have_another_gradient():
    """Draws that move with the parameters and weights without their past: what automatic differentiation would give."""

    def propose(params, particles, measurement, key):
        noise = params.walk[None] * jax.random.normal(key, particles.shape)
        moved = jax.vmap(lambda x, v: mean(params, x, measurement) + v)(particles, noise)
        return moved, jax.vmap(lambda x: log_likelihood(params, x, measurement))(moved)

    def forgetful(key, log_weights, count=None):
        return jax.lax.stop_gradient(resampling.systematic(key, log_weights, count))

    exact = exact_score()[0]
    found = np.asarray(estimated_scores(particle.Model(PLANE, propose, forgetful))[0].pull)
    assert abs(found.mean() - exact.pull) > 10 * found.std() / np.sqrt(RUNS) + 0.1 * abs(exact.pull)
