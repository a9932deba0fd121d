"""Two small models for the samplers: a damped spring pulled by an unknown force, and a pendulum."""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.mcmc.model import Data, Model, Prior, Unknown

DT = 0.1


def spring(params, theta, x, given):
    return jnp.stack([x[0] + DT * x[1], x[1] + DT * (theta[0] - params * x[0] - 0.5 * x[1])])


def pendulum(params, theta, x, given):
    return jnp.stack([x[0] + DT * x[1], x[1] + DT * (theta[0] - params * jnp.sin(x[0]))])


SPRING, PENDULUM = Model(spring, (0,), 2, 1), Model(pendulum, (0,), 2, 1)
PARAMS = {SPRING: 4.0, PENDULUM: 9.0}
VARIANCES = np.array([1e-3, 2e-3, 2e-3])


class Case(NamedTuple):
    model: Model
    params: object
    prior: Prior
    data: Data
    path: object
    """(T, n) the true one."""
    unknown: Unknown


def prior(alpha=6.0):
    return Prior(jnp.array([-3.0]), jnp.array([3.0]), jnp.full(3, alpha), (alpha - 1) * jnp.asarray(VARIANCES),
                 jnp.array([0.5, 0.0]), jnp.array([0.01, 0.02]))  # fmt: skip


def draw(model, key, steps, unknown, params=None, given=None):
    """A path and a series drawn from the model; every third measurement is missing."""
    given = given or prior()
    params = PARAMS[model] if params is None else params
    keys = jax.random.split(key, 3)
    x0 = given.mean + jnp.sqrt(given.variance) * jax.random.normal(keys[0], (2,))
    noise = jnp.sqrt(unknown.variances[:2])[None] * jax.random.normal(keys[1], (2 * (steps - 1),)).reshape(-1, 2)

    def advance(x, u):
        x = model.transition(params, unknown.theta, x, jnp.zeros(())) + u
        return x, x

    path = jnp.concatenate([x0[None], jax.lax.scan(advance, x0, noise)[1]])
    y = path[:, :1] + jnp.sqrt(unknown.variances[2]) * jax.random.normal(keys[2], (steps,))[:, None]
    valid = jnp.arange(steps)[:, None] % 3 != 2
    return path, Data(jnp.where(valid, y, 0), valid, jnp.zeros(steps - 1))


@cache
def case(model, steps=12, seed=0, theta=0.7):
    with jax.enable_x64(True):
        unknown = Unknown(jnp.array([theta]), jnp.asarray(VARIANCES))
        path, data = draw(model, jax.random.key(seed), steps, unknown)
        return Case(model, PARAMS[model], prior(), data, path, unknown)


class Dense(NamedTuple):
    """Joint normal density of path and measurements of the spring, given theta: mean and covariance, loop-written."""

    mean: np.ndarray
    """(T n,)"""
    slope: np.ndarray
    """(T n,) of the mean by theta."""
    covariance: np.ndarray
    """(T n, T n)"""
    rows: np.ndarray
    """(k, T n) measurement matrix of what is valid."""
    noise: np.ndarray
    """(k, k)"""
    value: np.ndarray
    """(k,)"""


def dense(case):
    k, theta, s = case.params, float(case.unknown.theta[0]), np.asarray(case.unknown.variances)
    f = np.array([[1, DT], [-DT * k, 1 - 0.5 * DT]])
    steps = len(case.path)
    means, slopes = [np.asarray(case.prior.mean)], [np.zeros(2)]
    blocks = {(0, 0): np.diag(np.asarray(case.prior.variance))}
    for t in range(1, steps):
        means.append(f @ means[-1] + [0, DT * theta])
        slopes.append(f @ slopes[-1] + [0, DT])
        for j in range(t):
            blocks[t, j] = f @ blocks[t - 1, j]
            blocks[j, t] = blocks[t, j].T
        blocks[t, t] = f @ blocks[t - 1, t - 1] @ f.T + np.diag(s[:2])
    covariance = np.block([[blocks[i, j] for j in range(steps)] for i in range(steps)])
    seen = np.flatnonzero(np.asarray(case.data.valid)[:, 0])
    rows = np.zeros((len(seen), 2 * steps))
    rows[np.arange(len(seen)), 2 * seen] = 1
    value = np.asarray(case.data.value)[seen, 0]
    return Dense(np.concatenate(means), np.concatenate(slopes), covariance, rows, s[2] * np.eye(len(seen)), value)


def normal_log(x, mean, covariance):
    away = x - mean
    return -(away @ np.linalg.solve(covariance, away) + np.linalg.slogdet(2 * np.pi * covariance)[1]) / 2
