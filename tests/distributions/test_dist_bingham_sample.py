"""Bingham samples: moments of 2e5 draws within 4 standard errors, which come from the exact fourth moments."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bingham_cases import LIGHT, SAMPLED, rotations

from jaxest.distributions import bingham

COUNT = 200_000


@functools.cache
def program():
    """Second moments of draws along the principal directions, summed in float64 outside."""
    return jax.jit(lambda key, params: bingham.rejection(key, params, (COUNT,)), compiler_options=LIGHT)


def deviations(key, params, moments, fourth):
    """How many standard errors the ten second moments are off; the mean of q vanishes and is the eleventh."""
    value, done = program()(key, params)
    assert value.dtype == params.lam.dtype
    assert np.asarray(done).all()
    x = np.asarray(value, np.float64)
    assert np.abs(np.sum(x * x, axis=1) - 1).max() < 8 * np.finfo(value.dtype).eps
    y = x @ np.asarray(params.directions, np.float64)
    variance = fourth - np.diag(moments**2)
    second = y.T @ y / COUNT - np.diag(moments)
    largest = np.abs(second) / np.sqrt(variance / COUNT)
    centre = np.abs(y.mean(axis=0)) / np.sqrt(moments / COUNT)
    return max(largest.max(), centre.max())


def exact(lam):
    with jax.enable_x64(True):
        lam = np.asarray(lam, np.float64)
        return np.asarray(bingham.second_moments(lam)), np.asarray(bingham.fourth_moments(lam))


@pytest.mark.parametrize("index", range(len(SAMPLED)))
def test_moments(index):
    lam = SAMPLED[index].astype(np.float32)
    assert deviations(jax.random.key(index), bingham.standard(lam), *exact(lam)) < 4


def test_moments_along_turned_directions():
    """Rounding of the turn is 1e-7 of the whole: settings that it does not reach."""
    directions = rotations(1, 7)[0].astype(np.float32)
    lam = np.array([-3, 0, -100, -800], np.float32)
    assert deviations(jax.random.key(1), bingham.Params(jnp.asarray(directions), jnp.asarray(lam)), *exact(lam)) < 4


@pytest.mark.slow
@pytest.mark.recorded
def test_moments_at_every_setting_of_the_table(shared):
    """2860 means of 2e5 draws: none beyond 4 standard errors is expected with probability 0.83, so 4.8 bounds them
    all (probability of one beyond by chance 0.005), and at most one may lie beyond 4."""
    with np.load(shared / "oracles" / "bingham_s3.npz") as oracle:
        table = oracle["lam"].astype(np.float32)
    worst = [deviations(jax.random.key(i), bingham.standard(x), *exact(x)) for i, x in enumerate(table)]
    assert np.max(worst) < 4.8
    assert np.sum(np.array(worst) > 4) <= 1


def test_one_draw_a_particle_and_shapes(dtype):
    lam = jnp.asarray(np.tile(SAMPLED[1], (500, 1)), dtype)
    keys = jax.random.split(jax.random.key(3), 500)
    one = jax.jit(jax.vmap(lambda key, x: bingham.rejection(key, x)), compiler_options=LIGHT)
    value, done = one(keys, lam)
    assert value.shape == (500, 4)
    assert value.dtype == dtype
    assert np.asarray(done).all()
    moments, fourth = exact(SAMPLED[1])
    error = np.mean(np.asarray(value, np.float64) ** 2, axis=0) - moments
    assert (np.abs(error) < 4 * np.sqrt((np.diag(fourth) - moments**2) / 500)).all()
    assert bingham.sample(jax.random.key(0), lam[0], 3).shape == (3, 4)
    assert bingham.sample(jax.random.key(0), lam[0], (2, 3)).shape == (2, 3, 4)


def test_too_few_rounds_are_admitted():
    """One round at acceptance 0.45: about that many draws are done, and they come first."""
    done = np.asarray(bingham.rejection(jax.random.key(0), SAMPLED[1].astype(np.float32), (1000,), rounds=1).done)
    assert done.sum() == pytest.approx(448, abs=4 * np.sqrt(1000 * 0.45 * 0.55))
    assert (np.sort(done)[::-1] == done).all()


@pytest.mark.recorded
def test_acceptance(shared):
    """The envelope is the best angular central Gaussian one."""
    with np.load(shared / "oracles" / "bingham_s3.npz") as oracle:
        rows = [0, 12, 44, 76, 160, 240]
        table, expected = oracle["lam"][rows].astype(np.float32), oracle["kgm_acceptance"][rows]
    first = jax.jit(lambda key, x: bingham.rejection(key, x, (20000,), rounds=1).done, compiler_options=LIGHT)
    for i, (lam, p) in enumerate(zip(table, expected, strict=True)):
        share = np.mean(np.asarray(first(jax.random.key(i), lam)))
        assert share == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / 20000) + 1e-9)
