"""Linear-Gaussian models against the filter and smoother written as loops, and in rational numbers."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK
from reference import ref_kalman as reference

from jaxest.filters import kalman, run
from jaxest.manifolds import Euclidean
from jaxest.types import NON_FINITE, OK, Reading

N, M, T = 4, 3, 11
# Compiles five times faster.


class Line(NamedTuple):
    position: Reading
    dt: object


def linear_model(**options):
    return kalman.Model(
        Euclidean((N,)),
        lambda p, x, z: p["f"] @ x,
        lambda p, x, z: p["q"],
        (kalman.sensor("position", lambda p, x, z: p["h"] @ x, lambda p, z: p["r"]),),
        **options,
    )


MODEL = linear_model()


@pytest.fixture(scope="module")
def problem():
    random = np.random.default_rng(0)
    a, b = random.normal(size=(N, N)), random.normal(size=(M, M))
    numbers = {
        "f": np.eye(N) + 0.1 * random.normal(size=(N, N)),
        "q": 0.1 * a @ a.T,
        "h": random.normal(size=(M, N)),
        "r": b @ b.T + 0.1 * np.eye(M),
    }
    mean, values, valid = random.normal(size=N), random.normal(size=(T, M)), random.random((T, M)) > 0.3
    valid[3] = False
    return numbers, mean, 2 * np.eye(N), values, valid


def measured(values, valid):
    return Line(Reading(np.where(valid, values, np.nan), valid), np.ones(len(values), values.dtype))


def close(actual, desired, tolerance):
    desired = np.asarray(desired)
    np.testing.assert_allclose(actual, desired, rtol=0, atol=tolerance * max(1.0, np.abs(desired).max()))


@pytest.mark.parametrize("gain", [kalman.measurement_gain, kalman.state_gain, kalman.by_size])
@pytest.mark.parametrize("iterations", [1, 4])
def test_filter_is_the_loop(problem, gain, iterations, dtype):
    numbers, mean, cov, values, valid = problem
    expected = reference.kalman_filter(*numbers.values(), mean, cov, values, valid)
    params, mean, cov, values = jax.tree.map(lambda x: np.asarray(x, dtype), (numbers, mean, cov, values))
    step = kalman.filter_step(linear_model(gain=gain, iterations=iterations))
    _, history = run(step, params, kalman.init(mean, cov), measured(values, valid))
    tolerance = 1e-10 if dtype == np.float64 else 1e-4
    assert history.mean.dtype == dtype
    close(history.mean, expected["mean"], tolerance)
    close(history.covariance, expected["cov"], tolerance)
    close(history.log_likelihood, expected["density"], tolerance)
    close(history.nis, expected["nis"], tolerance)
    np.testing.assert_array_equal(history.dof, valid.sum(1))
    np.testing.assert_array_equal(history.covariance, np.swapaxes(history.covariance, 1, 2))
    assert np.all(np.asarray(history.status) == OK)
    assert np.all(history.log_likelihood[3] == 0)


@pytest.mark.parametrize(("series", "iterations"), [(kalman.smooth_series, 3), (kalman.smooth_series_parallel, 1)])
@pytest.mark.parametrize("dtype", [pytest.param("float32", marks=pytest.mark.slow), "float64"], indirect=True)
def test_smoother_is_the_loop(problem, series, iterations, dtype):
    numbers, mean, cov, values, valid = problem
    means, covs = reference.rts_smoother(*numbers.values(), mean, cov, values, valid)
    density = reference.kalman_filter(*numbers.values(), mean, cov, values, valid)["density"]
    params, mean, cov, values = jax.tree.map(lambda x: np.asarray(x, dtype), (numbers, mean, cov, values))
    smooth = jax.jit(partial(kalman.smooth, MODEL, iterations=iterations, series=series), compiler_options=QUICK)
    history = smooth(params, kalman.init(mean, cov), measured(values, valid))
    tolerance = 1e-10 if dtype == np.float64 else 1e-4
    close(history.mean, means[1:], tolerance)
    close(history.start, means[0], tolerance)
    close(history.covariance, covs[1:], tolerance)
    close(history.start_covariance, covs[0], tolerance)
    close(history.log_likelihood, density, tolerance)
    assert np.all(np.asarray(history.status) == OK)


def test_series_of_any_length_in_parallel(problem, x64):
    numbers, mean, cov, values, valid = problem
    f, q, h, r = numbers.values()

    @partial(jax.jit, compiler_options=QUICK)
    def both(series, start):
        return kalman.filter_series(series, start), kalman.filter_series_parallel(series, start)

    for length in (1, T):
        rows = jax.vmap(partial(kalman.whitened, jnp.asarray(h), noise=jnp.asarray(r)))(
            value=values[:length], valid=valid[:length]
        )
        tiled = [jnp.tile(x[None], (length, *(1 for _ in x.shape))) for x in (f, np.zeros(N), np.linalg.cholesky(q))]
        series = kalman.Series(*tiled, *rows)
        start = kalman.Root(jnp.asarray(mean), jnp.linalg.cholesky(jnp.asarray(cov)))
        (expected, expected_density), (filtered, density) = both(series, start)
        close(filtered.mean, expected.mean, 1e-12)
        close(filtered.covariance, expected.covariance, 1e-12)
        close(density, expected_density, 1e-12)
        if length == T:
            loop = reference.kalman_filter(f, q, h, r, mean, cov, values, valid)
            close(filtered.mean, loop["mean"], 1e-10)


def test_weakly_informed_parameters_survive(x64):
    """A position, a velocity and a constant offset, all known to 1e4 (one sd) or not at all, noise of 1e-4 (one sd)."""
    f = np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]])
    q = np.diag([1e-8, 1e-8, 0])
    h = np.array([[1.0, 0, 1], [0, 0, 1]])
    r = np.diag([1e-8, 1e2])
    random = np.random.default_rng(1)
    values = np.stack([3 + 0.7 * np.arange(8), np.full(8, 0.5)], axis=1) + random.normal(size=(8, 2)) * [1e-4, 10]
    mean, cov = np.zeros(3), 1e8 * np.eye(3)
    means, covs = reference.exact_smoother(f, q, h, r, mean, cov, values)
    model = kalman.Model(
        Euclidean((3,)),
        lambda p, x, z: jnp.asarray(f) @ x,
        lambda p, x, z: q,
        (kalman.sensor("position", lambda p, x, z: jnp.asarray(h) @ x, lambda p, z: r),),
    )
    sd = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    smooth = jax.jit(partial(kalman.smooth, model, None, iterations=1), compiler_options=QUICK)
    history = smooth(kalman.init(mean, cov), measured(values, np.ones((8, 2), bool)))
    found = np.asarray(history.covariance)
    np.testing.assert_allclose((history.mean - means[1:]) / sd[1:], 0, atol=1e-6)
    np.testing.assert_allclose(np.diagonal(found, axis1=1, axis2=2), sd[1:] ** 2, rtol=1e-6)
    assert np.linalg.eigvalsh(found).min() > 0


def test_a_known_start_and_no_noise_stay_exact(x64):
    """Singular covariances, and derivatives at them."""
    numbers = {"f": np.eye(N), "q": np.zeros((N, N)), "h": np.eye(N)[:M], "r": np.eye(M)}
    known = np.diag([0.0, 1, 0, 2])
    values = np.random.default_rng(3).normal(size=(5, M))
    line = measured(values, np.ones((5, M), bool))
    _, filtered = run(kalman.filter_step(MODEL), numbers, kalman.init(np.zeros(N), known), line)
    smooth = jax.jit(partial(kalman.smooth, MODEL, iterations=2), compiler_options=QUICK)
    smoothed = smooth(numbers, kalman.init(np.zeros(N), known), line)
    for mean in (filtered.mean[-1], smoothed.mean[0], smoothed.start):
        np.testing.assert_allclose(mean, [0, values[:, 1].sum() / 6, 0, 0], atol=1e-14)
    np.testing.assert_allclose(smoothed.covariance[0], np.diag([0, 1 / 6, 0, 2]), atol=1e-14)

    def evidence(q):
        params = numbers | {"q": q}
        return jnp.sum(run(kalman.filter_step(MODEL), params, kalman.init(np.zeros(N), known), line)[1].log_likelihood)

    slope = jax.grad(evidence)(numbers["q"])
    h = 1e-7
    ahead = [evidence(numbers["q"] + s * h * np.diag([1.0, 1, 1, 1])) for s in (1, -1)]
    np.testing.assert_allclose(np.trace(slope), (ahead[0] - ahead[1]) / (2 * h), rtol=1e-6)


@pytest.mark.parametrize("which", ["filter", pytest.param("smoother", marks=pytest.mark.slow)])
def test_gradient_of_the_evidence_in_the_noise(problem, which, x64):
    numbers, mean, cov, values, valid = problem
    state0, line = kalman.init(mean, cov), measured(values, valid)

    def evidence(logs):
        params = numbers | {"q": jnp.exp(logs[0]) * numbers["q"], "r": jnp.exp(logs[1]) * numbers["r"]}
        if which == "filter":
            return jnp.sum(run(kalman.filter_step(MODEL), params, state0, line)[1].log_likelihood)
        return jnp.sum(kalman.smooth(MODEL, params, state0, line, iterations=3).log_likelihood)

    slope = jax.jit(jax.grad(evidence), compiler_options=QUICK)(jnp.zeros(2))
    evidence = jax.jit(evidence, compiler_options=QUICK)
    h = 1e-4
    for i, direction in enumerate(np.eye(2)):
        far = [evidence(jnp.asarray(s * h * direction)) for s in (-2, -1, 1, 2)]
        np.testing.assert_allclose(slope[i], (far[0] - 8 * far[1] + 8 * far[2] - far[3]) / (12 * h), rtol=1e-8)


def test_bad_readings_are_reported(problem, x64):
    numbers, mean, cov, values, valid = problem
    hidden = valid.copy()
    hidden[7] = False
    line = measured(values, hidden)
    seen = line._replace(position=line.position._replace(valid=valid))
    (_, expected), (_, history) = (
        run(kalman.filter_step(MODEL), numbers, kalman.init(mean, cov), each) for each in (line, seen)
    )
    np.testing.assert_array_equal(history.mean, expected.mean)
    assert np.flatnonzero(history.status).tolist() == [7]
    assert history.status[7] == NON_FINITE
    smooth = jax.jit(partial(kalman.smooth, MODEL, iterations=1), compiler_options=QUICK)
    smoothed = smooth(numbers, kalman.init(mean, cov), seen)
    assert np.flatnonzero(smoothed.status).tolist() == [7]
