"""Objectives: gradients against differences (of the expectation, where they are drawn), and errors on the group."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK
from scipy.spatial.transform import Rotation
from tuning_models import FILTER, KALMAN, LINE, MODEL, NOISE, Params, begin, drawn, log_likelihood, particles

from jaxest import tuning
from jaxest.filters import complementary, particle, resampling
from jaxest.metrics import broad_rmse_deg
from jaxest.systems import orientation
from jaxest.tuning import errors
from jaxest.types import System

BATCH = tuning.padded([drawn(seed, steps=12 + seed) for seed in range(3)])


def gaussian_density(params, one):
    """Log-density of a recording as of one large normal vector."""
    steps = int(np.sum(np.asarray(one.measurements.value.valid) | True))
    valid = np.asarray(one.measurements.value.valid)
    spread, covariance = np.zeros((steps, steps)), np.eye(1)[0, 0]
    variances = []
    for _ in range(steps):
        covariance = params.pull**2 * covariance + params.walk**2
        variances.append(covariance)
    for i in range(steps):
        for j in range(i, steps):
            spread[i, j] = spread[j, i] = variances[i] * params.pull ** (j - i)
    spread = spread[np.ix_(valid, valid)] + (params.seen * params.scale) ** 2 * np.eye(valid.sum())
    value = np.asarray(one.measurements.value.value, np.float64)[valid, 0]
    sign, log = np.linalg.slogdet(2 * np.pi * spread)
    assert sign > 0
    return -(log + value @ np.linalg.solve(spread, value)) / 2


@pytest.mark.parametrize(
    "objective", [tuning.likelihood(KALMAN), tuning.smoothed(MODEL, begin)], ids=["filter", "smoother"]
)
def test_likelihood_is_that_of_one_large_normal(objective, x64):
    one = drawn(5, steps=15)
    params = Params(0.4, 0.8, 0.95, 1.1)
    loss = objective.loss(jax.tree.map(jnp.asarray, params), one, None)
    np.testing.assert_allclose(-loss, gaussian_density(params, one), rtol=1e-5)


@pytest.mark.parametrize("forward", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "objective",
    [tuning.likelihood(KALMAN), tuning.smoothed(MODEL, begin), tuning.consistency(KALMAN)],
    ids=["likelihood", "smoothed", "consistency"],
)
def test_gradient_is_the_difference(objective, forward, x64):
    space = tuning.space(Params(), ["walk", "seen", "pull"])
    problem = tuning.Problem(objective, space, forward=forward)
    z = space.pack(Params(), jnp.float64) + 0.1
    evaluate = jax.jit(lambda z: tuning.value_and_gradient(problem, z, BATCH), compiler_options=QUICK)
    _, gradient = evaluate(z)
    step = 1e-5
    numeric = [(evaluate(z + step * e)[0] - evaluate(z - step * e)[0]) / (2 * step) for e in np.eye(3)]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-7)


def test_consistency_vanishes_where_innovations_are_as_large_as_said(x64):
    objective = tuning.consistency(KALMAN)
    losses = [
        float(tuning.total(objective, jax.tree.map(jnp.asarray, Params(0.5 * k, 1.0 * k)), BATCH))
        for k in (0.2, 1.0, 5.0)
    ]
    assert losses[1] < 0.1
    assert min(losses[0], losses[2]) > 5 * losses[1]


def runs(objective, z, space, one, count, seed=0):
    problem = tuning.Problem(objective, space)
    keys = jax.random.split(jax.random.key(seed), count)
    batch = tuning.padded([one])
    evaluate = jax.jit(
        jax.vmap(lambda z, k: tuning.value_and_gradient(problem, z, batch, k), (None, 0)), compiler_options=QUICK
    )
    return jax.tree.map(lambda x: np.asarray(x, np.float64), evaluate(z, keys))


@pytest.mark.parametrize(
    "resample",
    [resampling.systematic, pytest.param(tuning.fading(resampling.systematic, 0.97), marks=pytest.mark.slow)],
    ids=["all", "fading"],
)
def test_score_is_the_difference_of_the_expectation(resample):
    """Differences of mean values with common random numbers, in steps wide beside their noise."""
    one = drawn(11, steps=10)
    objective = tuning.likelihood(particles(particle.filter_step(FILTER._replace(resample=resample))), random=True)
    space = tuning.space(Params(), ["walk", "seen", "pull"])
    z = space.pack(Params())
    count, step = 600, 0.15
    _, gradient = runs(objective, z, space, one, count)
    error = gradient.std(axis=0) / np.sqrt(count)
    for i, direction in enumerate(np.eye(3, dtype=np.float32)):
        sides = [runs(objective, z + sign * step * direction, space, one, count)[0] for sign in (1, -1)]
        numeric = (sides[0] - sides[1]) / (2 * step)
        noise = np.hypot(error[i], numeric.std() / np.sqrt(count))
        size = np.abs(gradient.mean(axis=0)).max()
        assert noise < 0.15 * size  # a test that could not fail otherwise
        # The difference's own curvature, the filter's 1 / N, and at most a few per cent of what is forgotten.
        assert abs(gradient[:, i].mean() - numeric.mean()) < 4 * noise + 0.06 * size, i


def test_fading_lowers_the_variance_and_leaves_the_value():
    one = drawn(12, steps=80)
    space = tuning.space(Params(), ["walk"])
    z = space.pack(Params())
    spreads = []
    values = []
    for resample in (resampling.systematic, tuning.fading(resampling.systematic, 0.8)):
        objective = tuning.likelihood(
            particles(particle.filter_step(FILTER._replace(resample=resample)), 64), random=True
        )
        value, gradient = runs(objective, z, space, one, 60)
        values.append(value)
        spreads.append(gradient.std())
    np.testing.assert_array_equal(values[0], values[1])
    assert spreads[1] < spreads[0] / 2
    with pytest.raises(ValueError, match="from 0 to 1"):
        tuning.fading(resampling.systematic, 1.5)


def test_relaxation_has_its_own_gradient_and_nearly_the_value(x64):
    one = drawn(13, steps=8)
    step = tuning.relaxed(LINE, NOISE, log_likelihood, smoothing=0.05)
    objective = tuning.likelihood(particles(step, 64), random=True)
    exact = tuning.likelihood(KALMAN)
    space = tuning.space(Params(), ["walk", "seen"])
    problem = tuning.Problem(objective, space)
    z, key = space.pack(Params(), jnp.float64), jax.random.key(3)
    batch = tuning.padded([one])
    evaluate = jax.jit(lambda z: tuning.value_and_gradient(problem, z, batch, key), compiler_options=QUICK)
    value, gradient = evaluate(z)
    numeric = [(evaluate(z + 1e-5 * e)[0] - evaluate(z - 1e-5 * e)[0]) / 2e-5 for e in np.eye(2)]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-6)
    assert abs(value - tuning.total(exact, Params(), batch)) < 0.5


def test_a_drawn_objective_wants_a_key():
    objective = tuning.likelihood(particles(particle.filter_step(FILTER)), random=True)
    with pytest.raises(ValueError, match="key: got None"):
        tuning.total(objective, Params(), BATCH)


def test_errors_are_broads(x64):
    rng = np.random.default_rng(0)
    truth = Rotation.from_rotvec(rng.normal(size=(30, 3)))
    wrong = truth * Rotation.from_rotvec(0.1 * rng.normal(size=(30, 3)))
    q, p = (np.roll(r.as_quat(), 1, axis=1) for r in (wrong, truth))
    counts = rng.uniform(size=30) < 0.7
    expected = broad_rmse_deg(q, p, counts)
    for error, part in (
        (errors.inclination, "inclination"),
        (errors.heading, "heading"),
        (errors.orientation, "total"),
    ):
        terms = jnp.stack(
            [error(complementary.Info(a, *[None] * 5), b) for a, b in zip(jnp.asarray(q), p, strict=True)]
        )
        found = np.rad2deg(tuning.objectives.rms(terms, jnp.asarray(counts)))
        np.testing.assert_allclose(found, getattr(expected, part), rtol=1e-9)


def test_free_heading_takes_the_best_heading_off(x64):
    rng = np.random.default_rng(1)
    tilt = Rotation.from_rotvec(0.1 * rng.normal(size=(40, 3)))
    counts = np.arange(40) >= 5
    turned = Rotation.from_rotvec([0, 0, 2.9]) * tilt  # error rotations in the earth frame

    def as_error(rotation):
        return jnp.asarray(np.roll(rotation.as_quat(), 1, axis=1))

    found = float(errors.free_heading(as_error(turned), jnp.asarray(counts)))
    best = min(
        np.sqrt(np.mean((Rotation.from_rotvec([0, 0, -h]) * turned)[counts].magnitude() ** 2))
        for h in np.linspace(2.7, 3.1, 2001)
    )
    np.testing.assert_allclose(found, best, rtol=1e-3)
    assert not np.isnan(jax.grad(lambda e: errors.free_heading(e, jnp.zeros(40, bool)))(as_error(turned))).any()


def test_supervised_gradient_of_an_orientation_filter(x64):
    system = orientation.build(sensors=("gyroscope", "accelerometer"))
    params = jax.tree.map(jnp.float64, system.default_params)
    measurements, truth = system.simulate(params, key=jax.random.key(0), steps=60, magnetic=False)
    batch = tuning.padded([tuning.recording(measurements, np.asarray(truth.quaternion))])
    space = tuning.space(system.default_params, ["proportional_gain", "integral_gain"])
    z = space.pack(params, jnp.float64)
    for objective in (
        tuning.supervised(system, errors.inclination),
        tuning.supervised(system, errors.error_rotation, errors.free_heading),
    ):
        problem = tuning.Problem(objective, space)
        evaluate = jax.jit(lambda z, p=problem: tuning.value_and_gradient(p, z, batch), compiler_options=QUICK)
        _, gradient = evaluate(z)
        numeric = [(evaluate(z + 1e-5 * e)[0] - evaluate(z - 1e-5 * e)[0]) / 2e-5 for e in np.eye(2)]
        np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-9)


def skipping(params, measurements):
    """Log-density of a level that is corrected at few steps."""

    def step(level, z):
        level = jax.lax.cond(jnp.abs(z) > 1.5, lambda: level + params.walk * (z - level), lambda: level)
        return level, -(((z - level) / params.seen) ** 2) / 2 - jnp.log(params.seen)

    return jnp.sum(jax.lax.scan(step, jnp.zeros(()), measurements.value.value[:, 0])[1])


def test_recordings_run_apart_skip_what_a_batch_does_for_all(x64):
    """The same losses, gradients and searches; a branch stays one, where a batch takes both sides of it."""
    beside = tuning.density(skipping)
    space = tuning.space(Params(), ["walk", "seen"])
    found, branches = [], []
    for objective in (beside, beside._replace(apart=True)):
        problem = tuning.Problem(objective, space)
        evaluate = partial(tuning.value_and_gradient, problem)
        z = space.pack(Params(), jnp.float64)
        branches.append(" cond[" in str(jax.make_jaxpr(evaluate)(z, BATCH)))
        search = tuning.minimise(problem, BATCH, starts=jnp.stack([z, z + 0.3]), evaluations=2)
        found.append((*evaluate(z, BATCH), search.trace.value, tuning.curvature(problem, z, BATCH).hessian))
    assert branches == [False, True]
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_perfect_estimates_have_no_slope():
    assert float(tuning.objectives.rms(jnp.zeros(3), jnp.ones(3, bool))) == 0
    assert not np.isnan(jax.grad(lambda x: tuning.objectives.rms(x, jnp.ones(3, bool)))(jnp.zeros(3))).any()


def test_a_model_alone_cannot_be_simulated():
    assert isinstance(KALMAN, System)
    with pytest.raises(ValueError, match="simulated"):
        KALMAN.simulate(Params(), key=jax.random.key(0))
