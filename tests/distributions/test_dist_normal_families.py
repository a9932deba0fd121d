"""Normal, truncated normal, inverse-gamma and inverse-Wishart densities against SciPy and quadrature."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bingham_cases import LIGHT
from scipy import stats
from scipy.special import digamma, polygamma

from jaxest.distributions import gaussian, inverse_gamma, inverse_wishart, truncated_normal
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK

COUNT = 100_000
# location, scale, low, high; float32 numbers on both sides of the mode, in both tails, narrow, wide and one-sided
BOUNDED = np.array(
    [
        [0, 1, -1, 2],
        [0, 1, 3, np.inf],
        [0, 1, -np.inf, -5],
        [0, 1, -np.inf, np.inf],
        [1, 0.5, 10, 10.0009765625],
        [0, 1, 30, np.inf],
        [0, 1, 1000, np.inf],
        [5, 2, -3, 5.5],
        [0, 1, -8, -6],
        [0, 1, 0, 1],
        [2, 3, 50, 90],
        [-4, 2, 2, 2.5],
        [0, 1, -0.125, 40],
    ]
)


def light(function):
    return jax.jit(function, compiler_options=LIGHT)


def eps(dtype):
    return float(np.finfo(dtype).eps)


def bounded_reference(location, scale, low, high):
    """Mean's distance from `origin`, entropy and log density at `origin`, the bound next to the mode or the mode."""
    a, b = (low - location) / scale, (high - location) / scale
    origin, sign = (location, 1) if a <= 0 <= b else (low, 1) if a > 0 else (high, -1)
    start = abs(origin - location) / scale
    reach = 40 / (1 + start)
    first, last = sorted(((low - origin) / scale * sign, (high - origin) / scale * sign))
    edges = np.linspace(max(first, -reach), min(last, reach), 801)
    x, w = np.polynomial.legendre.leggauss(12)
    half = np.diff(edges)[:, None] / 2
    t = edges[:-1, None] + half * (1 + x)
    log_density = -t * (start + t / 2)
    mass = np.exp(log_density) * w * half
    total = mass.sum()
    centre, spread = (mass * t).sum() / total, (mass * log_density).sum() / total
    log_scale = np.log(total) + np.log(scale)
    return origin, sign * scale * centre, log_scale - spread, -log_scale


@pytest.fixture(params=range(len(BOUNDED)))
def bounded(request):
    return BOUNDED[request.param]


def test_bounded_log_prob_mean_entropy(dtype):
    origin, centre, entropy, top = np.array([bounded_reference(*row) for row in BOUNDED]).T
    columns = BOUNDED.T.astype(dtype)
    got = light(truncated_normal.log_prob)(origin.astype(dtype), *columns)
    assert got.dtype == dtype
    assert (np.abs(got - top) < 8 * eps(dtype) * np.maximum(1, np.abs(top))).all()
    mean = light(truncated_normal.mean)(*columns)
    assert (np.abs(mean - (origin + centre)) < 4 * eps(dtype) * np.maximum(np.abs(origin + centre), 0.1)).all()
    assert np.abs(light(truncated_normal.entropy)(*columns) - entropy).max() < 16 * eps(dtype)
    assert truncated_normal.log_prob(np.asarray(3, dtype), 0.0, 1.0, -1.0, 2.0) == -np.inf


def test_bounded_distance_from_the_bound_keeps_its_digits():
    """The mean lies 1e-3 above a bound at 0 that is 1000 deviations out, in float32."""
    got = truncated_normal.mean(np.float32(-1000), np.float32(1), np.float32(0), np.float32(np.inf))
    assert float(got) == pytest.approx(bounded_reference(-1000, 1, 0, np.inf)[1], rel=1e-6)


def test_bounded_samples(dtype):
    columns = BOUNDED.T.astype(dtype)
    draw = light(lambda key: truncated_normal.sample(key, *columns, (COUNT, len(BOUNDED))))
    x = np.asarray(draw(jax.random.key(0)), np.float64)
    low, high = columns[2].astype(np.float64), columns[3].astype(np.float64)
    assert ((x >= low) & (x <= high)).all()
    for i, row in enumerate(BOUNDED):
        origin, centre, _, _ = bounded_reference(*row)
        apart = x[:, i] - origin
        rounding = eps(dtype) * abs(origin) / 10  # of each draw; they have no common sign
        assert abs(apart.mean() - centre) < 4 * apart.std() / np.sqrt(COUNT) + rounding


def test_bounded_quantile_inverts_the_density(x64):
    """The slope of the quantile is one over the density, exactly, for every case; and so are its derivatives."""
    u = np.array([1e-9, 0.01, 0.3, 0.5, 0.8, 1 - 1e-6])

    def both(u, location, scale, low, high):
        f = truncated_normal.quantile
        x, slope = f(u, location, scale, low, high), jax.grad(f)(u, location, scale, low, high)
        return slope, truncated_normal.log_prob(x, location, scale, low, high)

    grid = light(jax.vmap(jax.vmap(both, (0, None, None, None, None)), (None, 0, 0, 0, 0)))
    moderate = BOUNDED[np.abs(BOUNDED[:, 2]) != 1000]  # there x itself has lost the digits of x - low
    slope, log_density = grid(u, *moderate.T)
    assert np.abs(np.abs(slope) * np.exp(log_density) - 1).max() < 1e-11
    f, h = (lambda m: truncated_normal.quantile(0.3, m, 1.0, 3.0, np.inf)), 1e-5
    assert float(jax.grad(f)(0.0)) == pytest.approx(float(f(h) - f(-h)) / (2 * h), rel=1e-6)


def test_bounded_gradient_of_log_prob(x64):
    x = np.where(np.isfinite(BOUNDED[:, 2]), BOUNDED[:, 2], -7) + 1e-4

    def slopes(x, location, scale, low, high):
        return jax.grad(truncated_normal.log_prob, (1, 2, 3))(x, location, scale, low, high)

    got = light(jax.vmap(slopes))(x, *BOUNDED.T)
    assert all(np.isfinite(g).all() for g in got)
    for i, row in enumerate(BOUNDED[[0, 1, 5, 7, 10, 11]]):
        at = float(x[[0, 1, 5, 7, 10, 11][i]])
        for j in range(2):
            h = 1e-5 * np.eye(4)[j]
            rise = float(truncated_normal.log_prob(at, *(row + h)) - truncated_normal.log_prob(at, *(row - h)))
            assert float(got[j][[0, 1, 5, 7, 10, 11][i]]) == pytest.approx(rise / 2e-5, rel=1e-5, abs=1e-6)


ALPHA, BETA = np.array([0.25, 1.5, 3, 7.5, 9, 40, 1e4]), np.array([2.0, 0.5, 2.0**-20, 1, 3, 1e-3, 5e3])


def test_inverse_gamma_density_entropy_mean(dtype):
    a, b = ALPHA.astype(dtype), BETA.astype(dtype)
    wide = a.astype(np.float64), b.astype(np.float64)
    mode = (wide[1] / (wide[0] + 1)).astype(dtype)
    for factor in (0.3, 1, 1.02, 4):
        x = (mode * dtype.type(factor)).astype(dtype)
        got = light(inverse_gamma.log_prob)(x, a, b)
        assert got.dtype == dtype
        with jax.enable_x64(True):
            exact = stats.invgamma(wide[0], scale=wide[1]).logpdf(x.astype(np.float64))
        # one rounding of the ratio beta / x counts alpha |log ratio| times; SciPy's own cancels at alpha = 1e4
        apart = np.abs(wide[1] / (x * wide[0]) - 1)
        rounding = eps(dtype) * (8 * (1 + np.abs(exact) + 2 * wide[0] * apart)) + 4e-11
        assert (np.abs(got - exact) < rounding).all()
    entropy = stats.invgamma(wide[0], scale=wide[1]).entropy()
    assert np.abs(light(inverse_gamma.entropy)(a, b) - entropy).max() < 32 * eps(dtype) + 4e-11
    mean = inverse_gamma.mean(a, b)
    assert mean[0] == np.inf
    assert mean[1:] == pytest.approx(wide[1][1:] / (wide[0][1:] - 1), rel=4 * eps(dtype))
    assert inverse_gamma.log_prob(np.asarray(-1, dtype), a[0], b[0]) == -np.inf


def test_inverse_gamma_samples(dtype):
    """E[1/x] = alpha / beta and E[log x] = log beta - digamma(alpha), within 4 standard errors."""
    a, b = ALPHA.astype(dtype), BETA.astype(dtype)
    x = np.asarray(light(lambda key: inverse_gamma.sample(key, a, b, (20000, a.size)))(jax.random.key(1)), np.float64)
    inverse = b.astype(np.float64) / x
    assert (np.abs(inverse.mean(axis=0) - ALPHA) < 4 * np.sqrt(ALPHA / 20000) + ALPHA * eps(dtype)).all()
    logs = np.log(inverse).mean(axis=0) - digamma(ALPHA)
    assert (np.abs(logs) < 4 * np.sqrt(polygamma(1, ALPHA) / 20000) + eps(dtype)).all()


def test_inverse_gamma_fit(dtype):
    """Against SciPy's maximum of the same likelihood, and the likelihood equations for a narrow sample."""
    fit = light(inverse_gamma.fit)
    for alpha in (0.5, 3.0, 500.0):
        xs = stats.invgamma(alpha, scale=2e-7).rvs(2000, random_state=0).astype(dtype)
        found = fit(xs)
        assert found.status == OK
        assert found.alpha.dtype == dtype
        wide = xs.astype(np.float64)
        equation = (
            np.log(float(found.alpha)) - digamma(float(found.alpha)) - np.log(np.mean(1 / wide)) - np.mean(np.log(wide))
        )
        assert abs(equation) * 2 * alpha < (1e-4 if dtype == np.float32 else 1e-11) * np.sqrt(max(alpha, 1))
        assert float(found.beta) == pytest.approx(float(found.alpha) / np.mean(1 / wide), rel=40 * eps(dtype))
    ones = np.ones(2000, dtype)
    assert fit(np.where(np.arange(2000) == 7, -ones, ones)).status == NON_FINITE
    assert fit(ones).status == NOT_CONVERGED


def spd(p, seed=0):
    a = np.random.default_rng(seed).normal(size=(p, p))
    return a @ a.T + p * np.eye(p)


@pytest.mark.parametrize("p", [1, 3, 6])
def test_inverse_wishart_density(dtype, p):
    x, scale, dof = spd(p, 1), spd(p, 2), p + 2.5
    got = light(inverse_wishart.log_prob)(x.astype(dtype), np.asarray(dof, dtype), scale.astype(dtype))
    exact = stats.invwishart(dof, scale).logpdf(x)
    assert got.dtype == dtype
    assert float(got) == pytest.approx(float(exact), rel=100 * eps(dtype))
    assert inverse_wishart.mean(dof, scale) == pytest.approx(scale / (dof - p - 1), rel=1e-6)
    # SciPy 1.17's own entropy is that of another density for p > 1: its density on its samples is not.
    other = stats.invwishart(dof, scale)
    draws = other.rvs(20000, random_state=0).reshape(-1, p, p)
    surprise = -other.logpdf(np.moveaxis(draws, 0, -1))
    entropy = inverse_wishart.entropy(np.asarray(dof, dtype), scale.astype(dtype))
    assert entropy.dtype == dtype
    assert float(entropy) == pytest.approx(surprise.mean(), abs=4 * surprise.std() / np.sqrt(20000))


def test_inverse_wishart_samples_and_posterior():
    """The inverse is Wishart: its mean dof scale^-1, entry by entry within 4 standard errors."""
    scale, dof, count = spd(3, 2).astype(np.float32), np.float32(7), 50000
    x = inverse_wishart.sample(jax.random.key(0), dof, scale, (count,))
    assert x.dtype == np.float32
    inverse = np.linalg.inv(np.asarray(x, np.float64))
    v = np.linalg.inv(scale.astype(np.float64))
    variance = dof * (v**2 + np.outer(np.diag(v), np.diag(v)))
    assert (np.abs(inverse.mean(axis=0) - dof * v) < 4 * np.sqrt(variance / count)).all()
    residuals = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    after = inverse_wishart.posterior(dof, scale, residuals.T @ residuals, 5)
    joint = [
        float(inverse_wishart.log_prob(c, dof, scale))
        + sum(float(gaussian.log_prob(r, np.zeros(3, np.float32), c)) for r in residuals)
        - float(inverse_wishart.log_prob(c, *after))
        for c in np.asarray(x[:5])
    ]
    assert np.ptp(joint) < 1e-4


def test_inverse_gamma_posterior(x64):
    residuals = np.random.default_rng(0).normal(size=7)
    after = inverse_gamma.posterior(2.5, 0.7, np.sum(residuals**2), 7)
    joint = [
        float(inverse_gamma.log_prob(v, 2.5, 0.7) - inverse_gamma.log_prob(v, *after))
        + stats.norm(0, np.sqrt(v)).logpdf(residuals).sum()
        for v in (0.1, 0.5, 2.0)
    ]
    assert np.ptp(joint) < 1e-12


def test_gaussian_density(dtype):
    rng = np.random.default_rng(0)
    x, mean, covariance = rng.normal(size=4), rng.normal(size=4), spd(4)
    cast = [v.astype(dtype) for v in (x, mean, covariance)]
    got = light(gaussian.log_prob)(*cast)
    assert got.dtype == dtype
    assert float(got) == pytest.approx(stats.multivariate_normal(mean, covariance).logpdf(x), rel=40 * eps(dtype))
    variances = np.diag(covariance)
    exact = stats.multivariate_normal(mean, np.diag(variances))
    assert float(gaussian.log_prob(cast[0], cast[1], variances.astype(dtype))) == pytest.approx(
        exact.logpdf(x), rel=40 * eps(dtype)
    )
    assert float(gaussian.entropy(variances.astype(dtype))) == pytest.approx(exact.entropy(), rel=40 * eps(dtype))
    whole = stats.multivariate_normal(mean, covariance).entropy()
    assert float(gaussian.entropy(cast[2])) == pytest.approx(whole, rel=40 * eps(dtype))
    assert np.isnan(gaussian.log_prob(cast[0], cast[1], -cast[2]))


def test_gaussian_samples_and_fit():
    mean, covariance = np.array([1, -2, 3], np.float32), spd(3).astype(np.float32)
    xs = gaussian.sample(jax.random.key(0), mean, covariance, (COUNT,))
    found = gaussian.fit(xs)
    assert found.status == OK
    assert (np.abs(found.mean - mean) < 4 * np.sqrt(np.diag(covariance) / COUNT)).all()
    variance = covariance**2 + np.outer(np.diag(covariance), np.diag(covariance))
    assert (np.abs(found.covariance - covariance) < 4 * np.sqrt(variance / COUNT)).all()
    assert gaussian.fit(xs[:2]).status == NOT_CONVERGED
    assert gaussian.fit(np.full((3, 2), np.nan, np.float32)).status == NON_FINITE
    assert gaussian.sample(jax.random.key(0), mean, np.diag(covariance), (2, 5)).shape == (2, 5, 3)


def test_gaussian_conditionals(x64):
    covariance, mean = spd(4), np.arange(4.0)
    precision = np.linalg.inv(covariance)
    got = gaussian.from_information(precision @ mean, precision)
    assert got[0] == pytest.approx(mean, abs=1e-12)
    assert got[1] == pytest.approx(covariance, rel=1e-12)
    known, rest, value = (2, 0), [1, 3], np.array([0.5, -1.0])
    gain = covariance[np.ix_(rest, known)] @ np.linalg.inv(covariance[np.ix_(known, known)])
    centre, spread = gaussian.condition(mean, covariance, known, value)
    assert centre == pytest.approx(mean[rest] + gain @ (value - mean[list(known)]), abs=1e-12)
    left = covariance[np.ix_(rest, rest)] - gain @ covariance[np.ix_(known, rest)]
    assert spread == pytest.approx(left, abs=1e-12)
    x = np.array([3.0, 0, 1, -1])
    location, scale = gaussian.component_given_rest(x, mean, precision, 1)
    others = (0, 2, 3)
    exact = gaussian.condition(mean, covariance, others, x[list(others)])
    assert float(location) == pytest.approx(float(exact[0][0]), abs=1e-12)
    assert float(scale) ** 2 == pytest.approx(float(exact[1][0, 0]), rel=1e-12)


def test_wrong_shapes_are_named():
    with pytest.raises(ValueError, match=r"covariance: has shape \(2, 3\), expected \(3, 3\)"):
        gaussian.log_prob(np.zeros(3), np.zeros(3), np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"scale: has shape \(2, 3\), expected \(n, n\)"):
        inverse_wishart.mean(5.0, np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"x \(2,\), location \(3,\)"):
        truncated_normal.log_prob(np.zeros(2), np.zeros(3), 1.0, 0.0, 1.0)
    with pytest.raises(ValueError, match=r"shape: got \(2,\)"):
        inverse_gamma.sample(jax.random.key(0), jnp.ones(3), 1.0, (2,))
