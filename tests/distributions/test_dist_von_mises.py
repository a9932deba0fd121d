"""The von Mises distribution against 60 digits, from concentration 0 to 1e8, and samples of both samplers."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bingham_cases import LIGHT
from reference import ref_von_mises as reference

from jaxest.distributions import von_mises
from jaxest.types import NON_FINITE, OK, InputError

# float32 numbers on both sides of the switch at 4, and powers of ten
CONCENTRATIONS = np.array([0, 2.0**-26, 1e-3, 0.25, 1, 2.5, 3.999, 4, 4.001, 6, 10, 80, 1e3, 1e5, 1e8], np.float32)
EXACT = [reference.bessel(float(k)) for k in CONCENTRATIONS]
COUNT = 200_000


def light(function):
    return jax.jit(function, compiler_options=LIGHT)


def column(name):
    return np.array([float(getattr(b, name)) for b in EXACT])


def eps(dtype):
    return float(np.finfo(dtype).eps)


def test_ratio_complement_and_slopes_to_a_few_eps(dtype):
    k = CONCENTRATIONS.astype(dtype)

    def both(k):
        functions = von_mises.mean_resultant_length, von_mises.circular_variance
        return [(f(k), jax.grad(f)(k)) for f in functions]

    (ratio, slope), (complement, fall) = light(jax.vmap(both))(k)
    assert ratio.dtype == slope.dtype == complement.dtype == dtype
    assert ratio[0] == 0
    assert fall[0] == -0.5
    for got, expected, bound in (
        (ratio[1:], column("ratio")[1:], 4),
        (complement, column("complement"), 8),  # 0.14 is I0 - I1 of two that are eps-exact, just below k = 4
        (slope, column("slope"), 40),  # 1 - A/k - A^2 would lose 1e8 of them
        (-fall, column("slope"), 40),
    ):
        assert np.abs(np.asarray(got, np.float64) / expected - 1).max() < bound * eps(dtype)


def test_log_prob(dtype):
    k = CONCENTRATIONS.astype(dtype)
    turned = np.array([0.0, 0.7, -2.5, 3.1, 40.0], dtype)[:, None] / np.sqrt(np.maximum(k, 1))[None, :]
    mean = np.asarray(0.25, dtype)
    x = (turned + mean).astype(dtype)
    got = light(von_mises.log_prob)(x, np.full_like(x, mean), np.broadcast_to(k, x.shape))
    apart = x.astype(np.float64) - 0.25
    energy = 2 * CONCENTRATIONS.astype(np.float64) * np.sin(apart / 2) ** 2
    expected = -energy - column("log_i0e") - np.log(2 * np.pi)
    assert got.dtype == dtype
    # The difference x - mean is exact to eps; the energy is quadratic in it, log I0e and log 2 pi have an eps of each.
    rounding = np.abs(energy) * 8 + np.abs(column("log_i0e")) + 4
    assert (np.abs(np.asarray(got, np.float64) - expected) < rounding * eps(dtype)).all()


def test_log_prob_gradients(x64):
    f = von_mises.log_prob
    by = light(jax.vmap(jax.grad(f, (0, 1, 2)), (None, None, 0)))(1.5, 0.2, jnp.asarray(CONCENTRATIONS, float))
    k = CONCENTRATIONS.astype(np.float64)
    assert by[0] == pytest.approx(-k * np.sin(1.3), rel=1e-14)
    assert by[1] == pytest.approx(k * np.sin(1.3), rel=1e-14)
    assert by[2] == pytest.approx(np.cos(1.3) - column("ratio"), rel=1e-12)
    assert float(jax.grad(f, 2)(0.3, 0.2, 0.0)) == pytest.approx(np.cos(0.1), rel=1e-14)


def test_whole_turns_do_not_matter(dtype):
    turn = np.asarray(2 * np.pi, dtype)
    a, b = (von_mises.log_prob(np.asarray(x, dtype), 0.0, 5.0) for x in (0.4, 0.4 + turn))
    assert float(a) == pytest.approx(float(b), abs=16 * eps(dtype))
    assert float(von_mises.residual(np.asarray(3.0, dtype), -3.0)) == pytest.approx(6 - 2 * np.pi, abs=8 * eps(dtype))


def test_entropy(dtype):
    got = light(von_mises.entropy)(CONCENTRATIONS.astype(dtype))
    expected = [reference.entropy(float(k)) for k in CONCENTRATIONS]
    assert np.asarray(got, np.float64) == pytest.approx(np.array(expected), abs=10 * eps(dtype))
    assert von_mises.entropy(np.asarray(np.inf, dtype)) == -np.inf


def test_concentration_from_both_ends(dtype):
    k = CONCENTRATIONS[1:].astype(np.float64)
    r, b, slope = (column(name)[1:] for name in ("ratio", "complement", "slope"))
    for given, function, low in (
        (r, von_mises.concentration, k < 5),
        (b, von_mises.concentration_from_circular_variance, k > 0.2),
    ):
        rounded = given[low].astype(dtype)
        exact = k[low] + (rounded.astype(np.float64) - given[low]) / slope[low] * (1 if given is r else -1)
        got = light(function)(rounded)
        assert got.dtype == dtype
        assert np.abs(np.asarray(got, np.float64) / exact - 1).max() < 20 * eps(dtype)


def test_concentration_at_the_edges(dtype):
    r = np.array([0, 1, -0.1, 1.1, np.nan], dtype)
    np.testing.assert_array_equal(von_mises.concentration(r), np.array([0, np.inf, np.nan, np.nan, np.nan], dtype))
    ends = np.array([0, 1], dtype)
    np.testing.assert_array_equal(von_mises.concentration_from_circular_variance(ends), np.array([np.inf, 0], dtype))
    assert jax.grad(von_mises.concentration)(np.asarray(0, dtype)) == 2


def test_concentration_gradient(x64):
    for k in (0.3, 3.0, 300.0):
        b = reference.bessel(k)
        got = jax.grad(von_mises.concentration_from_circular_variance)(float(b.complement))
        assert float(got) == pytest.approx(-1 / float(b.slope), rel=1e-11)


def test_a_negative_concentration_is_no_number(dtype):
    k = np.asarray(-1, dtype)
    values = von_mises.log_prob(np.asarray(0, dtype), 0.0, k), von_mises.mean_resultant_length(k), von_mises.entropy(k)
    assert np.isnan(values).all()


@functools.cache
def draws(fast):
    if fast:
        return light(lambda key, sampler: von_mises.sample_fast(key, sampler, shape=(COUNT,)))
    return light(lambda key, k: von_mises.rejection(key, jnp.zeros_like(k), k, (COUNT,)))


def deviations(x, k):
    """Standard errors by which E[1 - cos], E[sin] and E[sin^2] are off."""
    exact = reference.bessel(k)
    x = np.asarray(x, np.float64)
    complement, slope = float(exact.complement), float(exact.slope)
    square = float(exact.ratio) / k if k else 0.5
    sine = np.sin(x)
    return max(
        abs(np.mean(2 * np.sin(x / 2) ** 2) - complement) / np.sqrt(slope / COUNT),
        abs(np.mean(sine)) / np.sqrt(square / COUNT),
        abs(np.mean(sine**2) - square) / (np.std(sine**2) / np.sqrt(COUNT)),
    )


@pytest.mark.parametrize("k", [0, 0.25, 2.5, 30, 1e4, 1e8])
@pytest.mark.parametrize("fast", [False, True], ids=["general", "fast"])
def test_moments(k, fast):
    """Float32; 36 means within 4 standard errors each."""
    k = float(np.float32(k))
    if fast:
        x = draws(True)(jax.random.key(1), von_mises.fast_sampler(k))
    else:
        x, done = draws(False)(jax.random.key(1), np.float32(k))
        assert np.asarray(done).all()
    assert x.dtype == np.float32
    assert (np.abs(x) <= np.float32(np.pi)).all()
    assert deviations(x, k) < 4


@pytest.mark.slow
@pytest.mark.recorded
@pytest.mark.parametrize("fast", [False, True], ids=["general", "fast"])
def test_moments_at_every_setting_of_the_table(shared, fast):
    """249 means within 4 standard errors: by chance one is beyond with probability 0.016."""
    with np.load(shared / "oracles" / "von_mises.npz") as oracle:
        table = oracle["kappa"].astype(np.float32)
    for i, k in enumerate(table):
        key = jax.random.key(i)
        x = draws(True)(key, von_mises.fast_sampler(float(k))) if fast else draws(False)(key, k).value
        assert deviations(x, float(k)) < 4, k


def test_sample_shapes_and_means(dtype):
    key = jax.random.key(0)
    mean = np.array([0.5, -3.0, 3.1], dtype)
    k = np.array([1e6, 1e5, 1e4], dtype)
    x = von_mises.sample(key, mean, k, (4, 3))
    assert x.shape == (4, 3)
    assert x.dtype == dtype
    apart = np.abs(np.asarray(von_mises.residual(x, np.broadcast_to(mean, (4, 3)))))
    assert (apart < 6 / np.sqrt(k)).all()
    assert (apart > 0).all()
    assert von_mises.sample(key, mean, np.asarray(2, dtype)).shape == (3,)
    assert von_mises.sample(key, 0.0, 2.0).shape == ()
    assert von_mises.sample_fast(key, von_mises.fast_sampler(2.0, dtype), mean).dtype == dtype
    with pytest.raises(ValueError, match=r"shape: got \(4,\), expected one that the parameters' \(3,\) broadcast to"):
        von_mises.sample(key, mean, k, (4,))


def test_each_with_its_own_concentration(dtype):
    k = np.tile(np.array([0, 3, 1e5], dtype), (4000, 1))
    x, done = light(lambda key: von_mises.rejection(key, np.zeros((), dtype), k))(jax.random.key(5))
    assert np.asarray(done).all()
    for i, b in enumerate(reference.bessel(float(v)) for v in k[0]):
        loss = np.mean(2 * np.sin(np.asarray(x[:, i], np.float64) / 2) ** 2)
        assert loss == pytest.approx(float(b.complement), abs=4 * np.sqrt(float(b.slope) / 4000))


@pytest.mark.parametrize("k", [0.0, 0.3, 6.0, 40.0, 1e8])
def test_the_fast_map_is_the_quantile_function(dtype, k):
    """The probability beyond the angle, by quadrature, is what the bits say, to the rounding of the angle."""
    sampler = von_mises.fast_sampler(k, dtype)
    size = 8 * dtype.itemsize
    words = (
        [0, 1, 5] + [int(2.0 ** (0.5 * i)) for i in range(4, 2 * size - 2)] + [3 << (size - 3), (1 << (size - 1)) - 1]
    )
    words = [w for w in words if w < 1 << (size - 1)]
    bits = np.array(words, f"uint{size}")
    theta = np.asarray(von_mises.from_bits(sampler, jnp.asarray(bits)), np.float64)
    mirrored = von_mises.from_bits(sampler, jnp.asarray(bits + bits.dtype.type(1 << (size - 1))))
    np.testing.assert_array_equal(-theta, np.asarray(mirrored, np.float64))
    assert (theta <= np.pi * (1 + eps(dtype))).all()
    end = np.pi if k < 20 else 2 * np.arcsin(min(1.0, np.sqrt(50 / k)))
    cuts = np.append(0, 2.0 ** np.arange(-20, 1))
    nodes, weights = np.polynomial.legendre.leggauss(30)
    tail = np.zeros_like(theta)
    for low, high in itertools.pairwise(cuts):
        at = theta[:, None] + (end - theta)[:, None] * ((low + high) / 2 + (high - low) / 2 * nodes)
        tail += np.exp(-2 * k * np.sin(at / 2) ** 2) @ weights * (end - theta) * (high - low) / 2
    norm = 2 * np.pi * np.exp(float(reference.bessel(k).log_i0e))
    wanted = np.array([(w + 0.5) / 2.0**size for w in words])
    angle_error = np.abs(tail / norm - wanted) * norm * np.exp(2 * k * np.sin(theta / 2) ** 2)
    width = 1 / np.sqrt(max(k, 0.1))
    bound = {"float32": 1e-6, "float64": 1e-11}[dtype.name]
    assert angle_error.max() < bound * width


def test_fast_sampler_refuses(x64):
    with pytest.raises(InputError, match="concentration: got -1"):
        von_mises.fast_sampler(-1.0)
    with pytest.raises(ValueError, match="dtype: got int32"):
        von_mises.fast_sampler(1.0, "int32")
    with pytest.raises(ValueError, match="bits: got uint32, expected uint64"):
        von_mises.from_bits(von_mises.fast_sampler(1.0, "float64"), jnp.zeros(3, jnp.uint32))


@pytest.mark.parametrize("k", [0.5, 50.0, 1e8])
def test_fit(dtype, k):
    count = 20000
    xs = von_mises.sample(jax.random.key(2), np.asarray(3.1, dtype), np.asarray(k, dtype), (count,))
    fit = light(von_mises.fit)
    found = fit(xs)
    exact = reference.bessel(k)
    assert found.status == OK
    assert found.mean.dtype == found.concentration.dtype == dtype
    deviation = 1 / np.sqrt(count * k * float(exact.ratio))
    assert abs(von_mises.residual(found.mean, 3.1)) < 4 * deviation + 4 * eps(dtype)
    assert abs(float(found.concentration) - k) < 4 / np.sqrt(count * float(exact.slope)) + (k * eps(dtype) * k**0.5)
    doubled = fit(np.append(xs, dtype.type(0)), np.append(np.full(count, 2, dtype), dtype.type(0)))
    assert float(doubled.concentration) == pytest.approx(float(found.concentration), rel=1e-3)


def test_fit_says_what_is_wrong():
    xs = np.array([0.1, np.nan, 0.3], np.float32)
    fit = light(von_mises.fit)
    even = np.full(3, 1, np.float32)
    assert fit(xs, even).status == NON_FINITE
    assert fit(np.full(3, 0.5, np.float32), even * 0).status == NON_FINITE
    same = fit(np.full(3, 0.5, np.float32), even)
    assert same.status == OK
    assert same.concentration > 1e12


@pytest.mark.recorded
def test_oracle_table(shared, dtype):
    with np.load(shared / "oracles" / "von_mises.npz") as oracle:
        table = {name: oracle[name] for name in oracle.files}
    k = table["kappa"].astype(dtype)
    moved = k.astype(np.float64) - table["kappa"]  # the rounding of the table's concentrations to float32
    ratio, complement = von_mises.mean_resultant_length(k), von_mises.circular_variance(k)
    assert np.abs(ratio / (table["A"] + table["dA"] * moved) - 1).max() < 4 * eps(dtype)
    assert np.abs(complement / (table["one_minus_A"] - table["dA"] * moved) - 1).max() < 8 * eps(dtype)
    peak = -np.log(2 * np.pi) - (table["logI0e"] - table["one_minus_A"] * moved)
    assert np.abs(von_mises.log_prob(np.zeros_like(k), 0.0, k) - peak).max() < 16 * eps(dtype)
    # The table's entropies are log I0 - k A, which has lost its digits for large k: see test_entropy for those.
    low = table["kappa"] < 10
    assert np.abs(von_mises.entropy(k) - table["entropy"])[low].max() < 16 * eps(dtype)
    r, b = table["inv_r"].astype(dtype), table["inv_one_minus_r"].astype(dtype)
    got = von_mises.concentration(r), von_mises.concentration_from_circular_variance(b)
    assert np.abs((got[0] / table["inv_kappa"] - 1) * (1 - r)).max() < 4 * eps(dtype)
    assert np.abs(got[1] / table["inv_kappa_from_one_minus_r"] - 1).max() < 4 * eps(dtype)
