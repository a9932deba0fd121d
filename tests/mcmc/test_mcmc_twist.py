"""The backward information filter against dense normal densities, and the iterated smoother against the shared one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mcmc_models import PENDULUM, SPRING, case, dense, normal_log

from jaxest.mcmc import conditional_smc, model, twist
from jaxest.mcmc.model import Unknown

pytestmark = pytest.mark.usefixtures("x64")


def prepared(which, steps=12, theta=0.0):
    one = case(which, steps)
    centre = jnp.array([theta])
    linear = model.linearize(one.model, one.params, one.prior, one.data, one.path, centre)
    return one, linear, twist.backward(one.model, one.prior, one.data, linear, one.unknown.variances, True)


def test_evidence_is_that_of_the_dense_density():
    one, linear, found = prepared(SPRING)
    d = dense(one)
    mean, covariance = d.rows @ d.mean, d.rows @ d.covariance @ d.rows.T + d.noise
    wanted = normal_log(d.value, mean, covariance)
    np.testing.assert_allclose(twist.log_evidence(found, linear, one.unknown.theta), wanted, rtol=1e-10)


def test_theta_is_integrated_out():
    one, linear, found = prepared(SPRING)
    d = dense(one)
    covariance = d.rows @ d.covariance @ d.rows.T + d.noise
    slope, left = d.rows @ d.slope, d.value - d.rows @ (d.mean - d.slope * float(one.unknown.theta[0]))
    precision = slope @ np.linalg.solve(covariance, slope)
    mean = slope @ np.linalg.solve(covariance, left) / precision
    collapsed = twist.collapse(one.prior, linear, found)
    np.testing.assert_allclose(collapsed.mean[0], mean, rtol=1e-5)
    np.testing.assert_allclose(collapsed.root[0, 0] ** 2, precision, rtol=1e-5)
    wanted = normal_log(left, slope * mean, covariance) + np.log(2 * np.pi / precision) / 2
    np.testing.assert_allclose(collapsed.log_evidence, wanted, rtol=1e-6)


def test_draws_have_the_conditional_mean_and_covariance():
    one, linear, found = prepared(SPRING)
    d = dense(one)
    gain = d.covariance @ d.rows.T @ np.linalg.inv(d.rows @ d.covariance @ d.rows.T + d.noise)
    mean = d.mean + gain @ (d.value - d.rows @ d.mean)
    covariance = d.covariance - gain @ d.rows @ d.covariance
    given = twist.flow(found, linear, one.unknown.theta)
    flat = lambda numbers: twist.draw(given, linear, numbers.reshape(1, -1, 2)).ravel()  # noqa: E731
    zero = jnp.zeros(one.path.size)
    np.testing.assert_allclose(flat(zero), mean, atol=1e-12)
    root = jax.jacfwd(flat)(zero)
    np.testing.assert_allclose(root @ root.T, covariance, atol=1e-14)


@pytest.mark.parametrize("which", [SPRING, PENDULUM], ids=["spring", "pendulum"])
def test_whitening_undoes_drawing(which):
    one, linear, found = prepared(which, theta=0.3)
    numbers = jax.random.normal(jax.random.key(3), one.path.shape)
    path = twist.draw(twist.flow(found, linear, one.unknown.theta), linear, numbers[None])[0]
    np.testing.assert_allclose(twist.whiten(found, linear, one.unknown.theta, path), numbers, atol=1e-9)


@pytest.mark.parametrize(
    "look", [twist.backward, *(pytest.param(look, marks=pytest.mark.slow) for look in (twist.next_only, twist.nothing))]
)
def test_a_linear_models_evidence_is_estimated_without_bias(look):
    one, linear, whole = prepared(SPRING)
    exact = twist.log_evidence(whole, linear, one.unknown.theta)
    options = {"whole": True} if look is twist.backward else {}
    given = look(one.model, one.prior, one.data, linear, one.unknown.variances, **options)

    def ratio(key):
        found = conditional_smc.run(one.model, one.params, one.data, linear, given, one.unknown, key=key, count=200)
        return jnp.exp(found.log_evidence - exact)

    ratios = jax.jit(jax.vmap(ratio))(jax.random.split(jax.random.key(0), 200))
    if look is twist.backward:  # the weights of a linear model are all equal
        np.testing.assert_allclose(ratios, 1, rtol=1e-8)
    error = float(jnp.std(ratios)) / np.sqrt(200)
    assert abs(float(jnp.mean(ratios)) - 1) < 4 * error + 1e-8
    assert float(jnp.std(ratios)) < 0.5


def test_filters_of_a_nonlinear_model_agree():
    one, linear, given = prepared(PENDULUM)
    bootstrap = twist.nothing(one.model, one.prior, one.data, linear, one.unknown.variances)
    common = (one.model, one.params, one.data, linear)

    def estimates(key):
        plain = conditional_smc.run(*common, bootstrap, one.unknown, key=key, count=400)
        guided = conditional_smc.run(*common, given, one.unknown, key=key, count=16)
        whole = conditional_smc.at_once(*common, given, one.unknown, key=key, count=16)
        again = conditional_smc.at_once(*common, given, one.unknown, key=key, count=16, corrected=True)
        return jnp.stack([x.log_evidence for x in (plain, guided, whole, again)])

    found = jax.jit(jax.vmap(estimates))(jax.random.split(jax.random.key(1), 100))
    top = jnp.max(found)
    means, errors = jnp.exp(found - top).mean(0), jnp.exp(found - top).std(0) / 10
    for i in (1, 2, 3):
        assert abs(means[i] - means[0]) < 4 * jnp.hypot(errors[i], errors[0])
        assert errors[i] < errors[0] / 5
    assert errors[3] < errors[2] / 2
    with pytest.raises(ValueError, match="expected no path to keep"):
        conditional_smc.at_once(
            *common, given, one.unknown, key=jax.random.key(0), count=4, path=one.path, corrected=True
        )


@pytest.mark.slow
def test_the_path_found_is_that_of_the_shared_smoother():
    from jaxest.filters import kalman
    from jaxest.manifolds import Euclidean
    from jaxest.types import Reading

    one = case(PENDULUM)

    class Seen(tuple):
        pass

    from typing import NamedTuple

    class Look(NamedTuple):
        angle: Reading
        first: jax.Array

    def dynamics(params, x, measurement):
        moved = one.model.transition(params, x[2:], x[:2], jnp.zeros(()))
        return jnp.where(measurement.first, x, jnp.concatenate([moved, x[2:]]))

    def noise(params, x, measurement):
        s = jnp.concatenate([one.unknown.variances[:2], jnp.zeros(1)])
        return jnp.diag(jnp.where(measurement.first, 0, s))

    sensor = kalman.sensor("angle", lambda p, x, m: x[:1], lambda p, m: one.unknown.variances[2:])
    shared = kalman.Model(Euclidean((3,)), dynamics, noise, (sensor,))
    wide = 1e6
    start = kalman.init(jnp.concatenate([one.prior.mean, jnp.zeros(1)]),
                        jnp.diag(jnp.concatenate([one.prior.variance, jnp.array([wide])])))  # fmt: skip
    looks = Look(Reading(one.data.value, one.data.valid[:, 0]), jnp.arange(12) == 0)
    wanted = kalman.smooth(shared, one.params, start, looks, iterations=20, tolerance=1e-10)
    first = Unknown(jnp.zeros(1), one.unknown.variances)
    linear = twist.fit_path(one.model, one.params, one.prior, one.data, first, one.path, 12)
    np.testing.assert_allclose(linear.path, wanted.mean[:, :2], atol=1e-6)
    np.testing.assert_allclose(linear.centre, wanted.mean[-1, 2:], atol=1e-5)
    given = twist.backward(one.model, one.prior, one.data, linear, one.unknown.variances)
    ours = twist.collapse(one.prior, linear, given).log_evidence
    flat = float(jnp.sum(wanted.log_likelihood)) + np.log(2 * np.pi * wide) / 2
    np.testing.assert_allclose(ours, flat, atol=1e-4)
