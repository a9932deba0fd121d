"""The torque benchmark: its rows, and whether its peer computes the same."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jaxest import bench, kinematics, models
from jaxest.bench import torque_peers
from jaxest.mcmc import particle_gibbs
from jaxest.mcmc.kernel import Params
from jaxest.mcmc.model import Unknown
from jaxest.systems import torque, torque_model


@pytest.mark.slow  # compiles a dozen programs
def test_torque():
    rows = list(bench.rows("torque", peers=False, small=True))
    assert [row.metric for row in rows] == [
        "the paper's run", "R-hat, largest", "effective draws of torques", "effective draws of variances",
        "effective draws of the path", "iteration",
    ]  # fmt: skip
    assert all(row.value > 0 for row in rows)


@pytest.mark.slow
def test_the_paper_sampler_of_the_torque_benchmark_draws_what_ours_draws(x64):
    """A peer that computes something else would be no peer: torques and variances given a path, many draws of each."""
    model = mujoco.MjModel.from_xml_string(models.chain(2))
    robot = kinematics.load(models.chain(2))
    start = jnp.array([0.3, -0.2])
    given = torque.default_params(robot)._replace(mean=jnp.concatenate([start, jnp.zeros(2), jnp.array([0.6, 0.4])]))
    measured, truth = torque.simulate(given, key=jax.random.key(0), steps=20, dt=0.01)
    data, prior = torque.data_of(measured), torque.paper_prior(start, 2)
    path = jnp.concatenate([truth.angles, truth.velocity], axis=1)
    unknown = Unknown(jnp.array([0.5, 0.5]), jnp.full(6, 2e-7))
    ours = torque_model.constant(2)
    params = Params(robot, prior, None)
    draw = jax.jit(lambda key: particle_gibbs.draw_unknown(ours, params, data, path, unknown, key=key))
    mine = jax.jit(jax.vmap(draw))(jax.random.split(jax.random.key(1), 2000))
    problem = torque_peers.problem(model, data, prior)
    random = np.random.default_rng(2)
    theirs = [torque_peers.unknowns(random, problem, np.asarray(path), *map(np.asarray, unknown)) for _ in range(2000)]
    for a, b in zip((mine.theta, jnp.log(mine.variances)), (0, 1), strict=True):
        other = np.array([one[b] for one in theirs])
        other = np.log(other) if b else other
        error = np.hypot(a.std(axis=0), other.std(axis=0)) / np.sqrt(2000)
        assert np.all(np.abs(a.mean(axis=0) - other.mean(axis=0)) < 4.5 * error)
        assert np.all(np.abs(np.log(a.std(axis=0) / other.std(axis=0))) < 0.1)  # four times its error
