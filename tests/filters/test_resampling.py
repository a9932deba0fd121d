"""Resampling: unbiased, exact in number at any size, and what each scheme promises of single counts."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK

from jaxest.filters import resampling
from jaxest.filters.resampling import adaptive, multinomial, residual, stratified, systematic

SCHEMES = [systematic, stratified, multinomial, residual]
NAMES = [scheme.__name__ for scheme in SCHEMES]
DRAWS = 20_000
# Compiles faster.


@pytest.fixture(params=SCHEMES, ids=NAMES)
def scheme(request):
    return request.param


def weights(size, spread, seed=0):
    w = np.exp(spread * np.random.default_rng(seed).normal(size=size))
    return w / w.sum()


@cache
def jitted(scheme):
    return jax.jit(scheme, compiler_options=QUICK)


def counts(ancestors, size):
    return np.bincount(np.asarray(ancestors), minlength=size)


def many(scheme, log_weights, count=None, draws=DRAWS, seed=0):
    """Counts (draws, N) of independent resamplings."""

    def one(key):
        ancestors = scheme(key, log_weights, count).ancestors
        return jnp.zeros(log_weights.shape[0], jnp.int32).at[ancestors].add(1)

    return np.asarray(jax.jit(jax.vmap(one), compiler_options=QUICK)(jax.random.split(jax.random.key(seed), draws)))


@pytest.mark.parametrize("count", [None, 40])
def test_counts_are_right_on_average(scheme, count, dtype):
    w = weights(17, 1.5)
    w[3] = 0
    w /= w.sum()
    with np.errstate(divide="ignore"):
        found = many(scheme, jnp.asarray(np.log(w), dtype), count)
    n = 17 if count is None else count
    assert np.all(found.sum(axis=1) == n)
    assert np.all(found[:, 3] == 0)
    error = found.std(axis=0) / np.sqrt(DRAWS)
    # A tick is 2^-24 draws at these sizes; a count that never varies has no sampling error.
    np.testing.assert_array_less(np.abs(found.mean(axis=0) - n * w), 4.5 * error + 1e-5)


def test_single_counts_are_what_the_drawnpromises(scheme):
    w = weights(31, 1.0)
    found = many(scheme, jnp.asarray(np.log(w), jnp.float32), draws=2000)
    low = np.floor(31 * w)
    if scheme is systematic:
        assert np.all((found == low) | (found == low + 1))
    elif scheme is stratified:
        assert np.all((found >= low - 1) & (found <= low + 2))
    elif scheme is residual:
        assert np.all(found >= low)
    else:
        assert np.any(found < low - 2)
        assert np.any(found > low + 3)


def test_multinomial_counts_have_the_multinomial_covariance():
    w = weights(6, 0.8)
    found = many(multinomial, jnp.asarray(np.log(w), jnp.float32), draws=50_000)
    expected = 6 * (np.diag(w) - np.outer(w, w))
    centred = found - 6 * w
    products = centred[:, :, None] * centred[:, None, :]
    error = products.std(axis=0) / np.sqrt(len(found))
    np.testing.assert_array_less(np.abs(products.mean(axis=0) - expected), 4.5 * error)


def test_stratified_and_residual_vary_less_than_multinomial():
    """Source: Douc and Cappe 2005 (Comparison of resampling schemes), theorems 1 and 2; systematic has no such law."""
    w = weights(64, 1.0)
    value = np.linspace(-1, 1, 64)
    sums = [many(each, jnp.asarray(np.log(w), jnp.float32)) @ value for each in (stratified, residual, multinomial)]
    of_stratified, of_residual, of_multinomial = (x.var() for x in sums)  # each to 1 % of itself
    ends = np.concatenate([[0], np.cumsum(w)])
    strata = np.arange(65) / 64
    overlap = np.minimum(ends[1:], strata[1:, None]) - np.maximum(ends[:-1], strata[:-1, None])
    share = 64 * np.maximum(overlap, 0)
    np.testing.assert_allclose(of_stratified, np.sum(share @ value**2 - (share @ value) ** 2), rtol=0.05)
    assert of_stratified < 0.9 * of_multinomial
    assert of_residual < 0.9 * of_multinomial
    exact = 64 * (np.sum(w * value**2) - np.sum(w * value) ** 2)
    np.testing.assert_allclose(of_multinomial, exact, rtol=0.05)


@pytest.mark.parametrize("size", [1, 3, 1_000_000])
def test_as_many_go_on_as_were_asked_for(scheme, size):
    for spread in (0.0, 0.1, 2.0, 30.0):
        w = np.float32(spread * np.random.default_rng(size).normal(size=size))
        ancestors = np.asarray(jitted(scheme)(jax.random.key(1), jnp.asarray(w)).ancestors)
        assert ancestors.shape == (size,)
        assert ancestors.dtype == np.int32
        assert ancestors.min() >= 0
        assert ancestors.max() < size
        assert np.all(np.diff(ancestors) >= 0)


@pytest.mark.parametrize("spread", [0.1, 2.0, 8.0])
def test_a_million_float32_weights_are_not_lost_in_their_sum(spread):
    """Systematic counts never stray by more than one from their share, nor do their sums: no drift along the way."""
    size = 1_000_000
    log_weights = np.float32(spread * np.random.default_rng(2).normal(size=size))
    found = counts(jitted(systematic)(jax.random.key(3), jnp.asarray(log_weights)).ancestors, size)
    w = np.exp(log_weights.astype(float))
    w /= w.sum()
    # A share is rounded to 2^-10 of a draw, and float32 exponentials are good to 1e-7 of themselves.
    assert np.abs(found - size * w).max() < 1.01 + 1e-6 * size * w.max()
    # Rounding by chance: a million roundings of 2^-10 / sqrt(12) make 0.28, here within 5 of it.
    assert np.abs(np.cumsum(found) - size * np.cumsum(w)).max() < 1 + 5 * 0.28


def test_extreme_weights(scheme, dtype):
    key, drawn = jax.random.key(0), jitted(scheme)
    one = np.full(50, -np.inf)
    one[7] = -1e4
    one[3] = np.nan
    one[4] = np.inf
    chosen = drawn(key, jnp.asarray(one, dtype))
    assert np.all(np.asarray(chosen.ancestors) == 7)
    np.testing.assert_allclose(chosen.log_weights, -np.log(50), rtol=1e-6)
    vanished = drawn(key, jnp.full(50, -jnp.inf, dtype))
    assert counts(vanished.ancestors, 50).sum() == 50
    equal = drawn(key, jnp.zeros(50, dtype))
    np.testing.assert_array_equal(vanished.ancestors, equal.ancestors)
    if scheme is not multinomial:
        np.testing.assert_array_equal(equal.ancestors, np.arange(50))
    assert chosen.log_weights.dtype == dtype


def test_adaptive_waits_for_few_effective_particles(dtype):
    assert adaptive(systematic, 0.5) is adaptive(systematic, 0.5)
    half, always = jitted(adaptive(systematic, 0.5)), jitted(systematic)
    good = jnp.asarray(np.log(weights(100, 0.3)), dtype)
    bad = jnp.asarray(np.log(weights(100, 2.0)), dtype)
    assert resampling.effective_sample_size(good) > 50 > resampling.effective_sample_size(bad)
    key = jax.random.key(0)
    kept, drawn = half(key, good), half(key, bad)
    np.testing.assert_array_equal(kept.ancestors, np.arange(100))
    np.testing.assert_allclose(kept.log_weights, good, rtol=1e-5)
    np.testing.assert_array_equal(drawn.ancestors, always(key, bad).ancestors)
    np.testing.assert_allclose(drawn.log_weights, -np.log(100), rtol=1e-6)
    both = jax.jit(jax.vmap(adaptive(systematic, 0.5)), compiler_options=QUICK)(
        jnp.stack([key, key]), jnp.stack([good, bad])
    )
    for row, single in zip((0, 1), (kept, drawn), strict=True):
        np.testing.assert_array_equal(both.ancestors[row], single.ancestors)
        np.testing.assert_allclose(both.log_weights[row], single.log_weights, rtol=1e-6)
    np.testing.assert_array_equal(jitted(adaptive(systematic, 0.0))(key, bad).ancestors, np.arange(100))
    np.testing.assert_array_equal(jitted(adaptive(systematic, 1.0))(key, good).ancestors, always(key, good).ancestors)


def test_batch_is_loop(scheme):
    log_weights = jnp.asarray(np.random.default_rng(0).normal(size=(5, 33)), jnp.float32)
    keys = jax.random.split(jax.random.key(2), 5)
    batch = jax.jit(jax.vmap(scheme), compiler_options=QUICK)(keys, log_weights)
    for i in range(5):
        np.testing.assert_array_equal(batch.ancestors[i], jitted(scheme)(keys[i], log_weights[i]).ancestors)


def test_weights_after_resampling_carry_the_derivative(scheme, x64):
    """The mean of what resampled particles say has, on average, the gradient of what all of them say."""
    log_weights = jnp.log(jnp.asarray(weights(12, 1.0)))
    value = jnp.linspace(-1.0, 2.0, 12) ** 2

    def before(log_weights):
        return jnp.sum(jax.nn.softmax(log_weights) * value)

    def after(log_weights, key):
        chosen = scheme(key, log_weights)
        return jnp.sum(jnp.exp(chosen.log_weights) * value[chosen.ancestors])

    keys = jax.random.split(jax.random.key(0), DRAWS)
    slopes = np.asarray(jax.jit(jax.vmap(jax.grad(after), (None, 0)), compiler_options=QUICK)(log_weights, keys))
    error = slopes.std(axis=0) / np.sqrt(DRAWS)
    exact = np.asarray(jax.grad(before)(log_weights))
    assert np.abs(exact).max() > 0.05
    np.testing.assert_array_less(np.abs(slopes.mean(axis=0) - exact), 4.5 * error + 1e-6)


def test_normalize(dtype):
    random = np.random.default_rng(0)
    given = 50 * random.normal(size=200)
    given[[3, 8]] = -np.inf
    scaled, total, vanished = resampling.normalize(jnp.asarray(given, dtype))
    exact = given.max() + np.log(np.sum(np.exp(given - given.max())))
    eps = np.finfo(dtype).eps
    np.testing.assert_allclose(total, exact, rtol=4 * eps)
    np.testing.assert_allclose(scaled, given - exact, rtol=4 * eps, atol=400 * eps)
    assert not vanished
    slope = jax.grad(lambda x: resampling.normalize(x)[1])(jnp.asarray(given, dtype))
    np.testing.assert_allclose(slope, np.exp(given - exact), rtol=1000 * eps, atol=eps)
    ess = resampling.effective_sample_size(jnp.asarray(given, dtype))
    share = np.exp(given - exact)
    np.testing.assert_allclose(ess, 1 / np.sum(share**2), rtol=1000 * eps)


def test_nothing_left():
    scaled, total, vanished = resampling.normalize(jnp.array([jnp.nan, -jnp.inf, jnp.inf]))
    np.testing.assert_allclose(scaled, -np.log(3), rtol=1e-6)
    assert total == -np.inf
    assert vanished
    slope = jax.grad(lambda x: jnp.sum(resampling.normalize(x)[0]))(jnp.array([jnp.nan, -jnp.inf, jnp.inf]))
    np.testing.assert_array_equal(slope, 0)


def test_bad_arguments_are_named(scheme):
    key = jax.random.key(0)
    with pytest.raises(ValueError, match=r"log_weights: has shape \(2, 3\), expected \(N,\)"):
        scheme(key, jnp.zeros((2, 3)))
    with pytest.raises(ValueError, match="count: got 0, expected at least 1"):
        scheme(key, jnp.zeros(3), 0)
    with pytest.raises(ValueError, match=r"threshold: got 1\.5, expected a share from 0 to 1"):
        adaptive(scheme, 1.5)
    with pytest.raises(ValueError, match="count: got 4, expected 3, the number of weights"):
        adaptive(scheme, 0.5)(key, jnp.zeros(3), 4)
