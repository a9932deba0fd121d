"""Whole noise covariances: the evidence against a dense normal density, and the joint density that is left as it is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mcmc_models import DT, normal_log
from scipy import stats

from jaxest.distributions import inverse_wishart
from jaxest.mcmc import full_noise, twist
from jaxest.mcmc.model import Covariances, Data, Model, Prior, Unknown, linearize
from jaxest.mcmc.state import Params, State, Tuning

pytestmark = pytest.mark.usefixtures("x64")
BLOCKS, STEPS, REPEATS, ALPHA = ((0, 1), (2, 3)), 6, 400, 6.0
SCALE = np.array([1e-3, 1e-3, 2e-3, 2e-3, 2e-3, 2e-3])
PUSH = jnp.array([[1.0, 0.3], [0.0, 1.0]])


def step(params, theta, x, given):
    del given
    pull = params * (x[:2] if params is LINEAR else jnp.sin(x[:2]))
    return jnp.concatenate([x[:2] + DT * x[2:], x[2:] + DT * (PUSH @ theta - pull)])


LINEAR, BENT = 4.0, 9.0
MODEL = Model(step, (0, 1), 4, 2)


def prior():
    beta = (ALPHA - 1) * jnp.asarray(SCALE)
    mean, wide = jnp.array([0.5, -0.2, 0.0, 0.0]), jnp.array([0.01, 0.01, 0.02, 0.02])
    return Prior(jnp.full(2, -3.0), jnp.full(2, 3.0), jnp.full(6, ALPHA), beta, mean, wide)


def drawn(key, unknown, params=BENT, missing=(2,)):
    """A path and a series; rows that miss a joint."""
    keys, given = jax.random.split(key, 3), prior()
    x0 = given.mean + jnp.sqrt(given.variance) * jax.random.normal(keys[0], (4,))
    root = jnp.linalg.cholesky(unknown.variances.process)
    noise = jax.random.normal(keys[1], (STEPS - 1, 4)) @ root.T

    def advance(x, u):
        x = step(params, unknown.theta, x, None) + u
        return x, x

    path = jnp.concatenate([x0[None], jax.lax.scan(advance, x0, noise)[1]])
    error = jax.random.normal(keys[2], (STEPS, 2)) @ jnp.linalg.cholesky(unknown.variances.sensor).T
    valid = jnp.ones((STEPS, 2), bool).at[jnp.array(missing), 0].set(False)
    return path, Data(jnp.where(valid, path[:, :2] + error, 0), valid, jnp.zeros(STEPS - 1))


def from_prior(key):
    given, keys = prior(), jax.random.split(key, 4)
    matrices = [
        inverse_wishart.sample(keys[i], *full_noise.prior_of(given, at)) for i, at in enumerate((*BLOCKS, (4, 5)))
    ]
    process = jax.scipy.linalg.block_diag(*matrices[:2])
    theta = jax.random.uniform(keys[3], (2,), minval=given.low, maxval=given.high)
    return Unknown(theta, Covariances(process, matrices[2]))


def test_the_evidence_is_that_of_the_dense_normal_density():
    unknown = from_prior(jax.random.key(3))
    path, data = drawn(jax.random.key(4), unknown, LINEAR)
    linear = linearize(MODEL, LINEAR, prior(), data, path + 0.1, jnp.array([0.2, -0.4]))
    found = twist.log_evidence(full_noise.backward(MODEL, prior(), data, linear, unknown.variances), linear,
                               unknown.theta)  # fmt: skip
    f = np.asarray(jax.jacfwd(lambda x: step(LINEAR, unknown.theta, x, None))(jnp.zeros(4)))
    push = np.asarray(step(LINEAR, unknown.theta, jnp.zeros(4), None))
    means, blocks = [np.asarray(prior().mean)], {(0, 0): np.diag(np.asarray(prior().variance))}
    for t in range(1, STEPS):
        means.append(f @ means[-1] + push)
        for j in range(t):
            blocks[t, j] = f @ blocks[t - 1, j]
            blocks[j, t] = blocks[t, j].T
        blocks[t, t] = f @ blocks[t - 1, t - 1] @ f.T + np.asarray(unknown.variances.process)
    seen = [t for t in range(STEPS) if t != 2]
    covariance = np.block([[blocks[i, j][:2, :2] for j in seen] for i in seen])
    covariance += np.kron(np.eye(len(seen)), np.asarray(unknown.variances.sensor))
    wanted = normal_log(np.asarray(data.value)[seen].ravel(), np.concatenate([means[t][:2] for t in seen]), covariance)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


@pytest.mark.slow  # a minute, most of it compiling
def test_the_joint_density_is_left_as_it_is():
    """Getting it right (Geweke 2004), from exact draws; a wrong degree of freedom or matrix would show."""
    given, sampler = prior(), full_noise.gibbs(MODEL, BLOCKS, count=4)

    def later(key):
        keys = jax.random.split(key, 3)
        unknown = from_prior(keys[0])
        path, data = drawn(keys[1], unknown)
        flat = jnp.tile(given.mean[None], (STEPS, 1))
        linear = linearize(MODEL, BENT, given, data, flat, jnp.zeros(2))
        z = jnp.ones(6)
        params = Params(BENT, given, Tuning(linear, z, jnp.diag(z), jnp.ones(()), jnp.eye(2)))
        state = State(path, unknown, jnp.zeros(()), jnp.zeros((), jnp.int32))
        return jax.lax.fori_loop(0, 4, lambda _, s: sampler(params, data, s, key=keys[2])[0], state).unknown

    found = jax.jit(jax.vmap(later))(jax.random.split(jax.random.key(12), REPEATS))
    process, sensor = np.asarray(found.variances.process), np.asarray(found.variances.sensor)
    assert np.all(process[:, :2, 2:] == 0)
    whole = np.concatenate([np.diagonal(process, axis1=1, axis2=2), np.diagonal(sensor, axis1=1, axis2=2)], axis=1)
    scores = [(np.asarray(found.theta)[:, i] + 3) / 6 for i in range(2)]
    scores += [stats.invgamma.cdf(whole[:, i], ALPHA, scale=(ALPHA - 1) * SCALE[i]) for i in range(6)]
    for matrix in (process[:, :2, :2], process[:, 2:, 2:], sensor):
        # The correlation of a 2 x 2 inverse-Wishart matrix of diagonal scale: Barnard, McCulloch and Meng 2000.
        r = matrix[:, 0, 1] / np.sqrt(matrix[:, 0, 0] * matrix[:, 1, 1])
        half = (2 * ALPHA + 1 - 1) / 2
        scores.append(stats.beta.cdf((1 + r) / 2, half, half))
    for uniform in scores:
        assert stats.kstest(uniform, "uniform").pvalue > 1e-4


def test_chains_start_from_those_of_variances():
    state = State(
        jnp.zeros((3, STEPS, 4)), Unknown(jnp.zeros((3, 2)), jnp.tile(jnp.asarray(SCALE), (3, 1))), None, None
    )
    noise = full_noise.start(MODEL, state).unknown.variances
    np.testing.assert_allclose(noise.process[1], np.diag(SCALE[:4]))
    np.testing.assert_allclose(noise.sensor[2], np.diag(SCALE[4:]))
