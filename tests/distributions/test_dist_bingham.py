"""Bingham densities: parameters, products, rotations, divergence and fits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bingham_cases import BOUNDS, LAM, LIGHT, rotations
from reference import ref_bingham as reference

from jaxest.distributions import _symmetric, bingham
from jaxest.manifolds import quaternion
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK

LAM_SMALL = np.array([[0, -3, -12, -3], [-20, -20, 0, -1.0]])


def light(function):
    return jax.jit(function, compiler_options=LIGHT)


def unit(rng, *shape):
    x = rng.normal(size=(*shape, 4))
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


@pytest.fixture
def densities():
    """Two densities (D, lam) in general position."""
    return [bingham.Params(jnp.asarray(d), jnp.asarray(x)) for d, x in zip(rotations(2, 5), LAM_SMALL, strict=True)]


def at(q, params):
    """Log density as a number."""
    return float(bingham.log_prob(q, params))


def matrix(params):
    return np.asarray(params.directions) @ np.diag(params.lam) @ np.asarray(params.directions).T


def test_eigenvectors(dtype):
    rng = np.random.default_rng(0)
    kinds = np.array([[0, -1e6, -1e6, -1e6], [0, 0, -5, -5], [1, 1, 1, 1], [3, -2, 1e-3, 40], [0, 0, 0, 0]])
    q = rotations(50, 1)
    a = np.einsum("nij,nj,nkj->nik", q, kinds[np.arange(50) % 5], q)
    extra = [np.diag([1.0, 2, 2, 1]), np.eye(4)[[1, 0, 2, 3]], np.zeros((4, 4)), rng.normal(size=(4, 4))]
    a = np.concatenate([a, extra])
    a = ((a + np.swapaxes(a, 1, 2)) / 2).astype(dtype)
    w, v = (np.asarray(x, np.float64) for x in light(jax.vmap(_symmetric.eigh))(a))
    eps, size = np.finfo(dtype).eps, np.maximum(np.linalg.norm(a, axis=(1, 2)), 1e-30)
    again = np.einsum("nij,nj,nkj->nik", v, w, v)
    assert (np.abs(again - a).max(axis=(1, 2)) / size).max() < 20 * eps
    assert np.abs(np.swapaxes(v, 1, 2) @ v - np.eye(4)).max() < 20 * eps


def test_small_eigenvalues_of_a_graded_matrix_keep_their_digits():
    size = np.array([1, 1e-3, 1e-5, 1e-6])
    rng = np.random.default_rng(3)
    core = np.eye(4) + 0.1 * rng.normal(size=(4, 4))
    graded = ((core @ core.T) * np.outer(size, size)).astype(np.float32)
    exact = np.linalg.eigvalsh(graded.astype(np.longdouble).astype(np.float64))
    exact = np.sort(1 / np.linalg.eigvalsh(np.linalg.inv(graded.astype(np.float64))))  # LAPACK is right for the inverse
    got = np.sort(np.asarray(_symmetric.eigh(graded)[0], np.float64))
    assert np.abs(got[:2] / exact[:2] - 1).max() < 1e-5


def test_log_prob(dtype, densities):
    x = unit(np.random.default_rng(2), 20).astype(dtype)
    for params in densities:
        cast = bingham.Params(*(np.asarray(v, dtype) for v in params))
        log_c = reference.moments(np.asarray(params.lam))[0]
        expected = np.einsum("ni,ij,nj->n", x.astype(float), matrix(params), x.astype(float)) - log_c
        forms = cast, (cast.directions, cast.lam), matrix(params).astype(dtype)
        for form in forms:
            got = light(jax.vmap(bingham.log_prob, (0, None)))(x, form)
            assert got.dtype == dtype
            assert np.abs(got - expected).max() < 40 * BOUNDS[dtype.name].log_c / 10
    got = bingham.log_prob(x[0], LAM_SMALL[0].astype(dtype))
    assert got == pytest.approx(
        float(x[0].astype(float) ** 2 @ LAM_SMALL[0]) - reference.moments(LAM_SMALL[0])[0], 1e-5
    )


def test_matrix_and_back(x64, densities):
    for params in densities:
        again = bingham.from_matrix(bingham.to_matrix(params))
        assert np.abs(matrix(again) - matrix(params)).max() < 1e-13


def test_rotation_of_a_density(x64, densities):
    rng = np.random.default_rng(3)
    x, turn = unit(rng, 10), unit(rng)
    for params in densities:
        plain = [at(q, params) for q in x]
        left = bingham.rotate_left(params, turn)
        right = bingham.rotate_right(params, turn)
        back = bingham.inverse(params)
        for q, value in zip(x, plain, strict=True):
            assert at(quaternion.compose(turn, q), left) == pytest.approx(value, abs=1e-12)
            assert at(quaternion.compose(q, turn), right) == pytest.approx(value, abs=1e-12)
            assert at(quaternion.inverse(q), back) == pytest.approx(value, abs=1e-12)


def test_about_has_its_errors_in_the_body(x64):
    centre = unit(np.random.default_rng(4))
    params = bingham.about(centre, [0.0, -800, -800, 0])
    assert abs(bingham.mode(bingham.about(centre, [0.0, -8, -8, -1])) @ centre) == pytest.approx(1, abs=1e-12)
    free = quaternion.compose(centre, quaternion.exp(jnp.asarray([0, 0, 1.3])))
    bent = quaternion.compose(centre, quaternion.exp(jnp.asarray([0.1, 0, 0])))
    top = at(centre, params)
    assert at(free, params) == pytest.approx(top, abs=1e-10)
    assert at(bent, params) == pytest.approx(top - 800 * np.sin(0.05) ** 2, abs=1e-10)


def test_product(x64, densities):
    a, b = densities
    both = bingham.multiply(a, b)
    x = unit(np.random.default_rng(5), 30)
    each = [jax.vmap(bingham.log_prob, (0, None))(x, p) for p in (a, b, both)]
    assert np.ptp(each[0] + each[1] - each[2]) < 1e-11
    assert np.abs(np.asarray(bingham.multiply(b, a).directions.T @ both.directions) ** 2).max(axis=0) == pytest.approx(
        1
    )


def test_product_of_a_narrow_and_a_wide_density_in_float32():
    """The wide one decides along the axis that the narrow one leaves free."""
    centre = np.array([0.5, 0.5, -0.5, 0.5], np.float32)
    narrow = bingham.about(centre, np.array([0, -1e6, -1e6, 0], np.float32))
    wide = bingham.about(centre, np.array([0, -4, -4, -4], np.float32))
    lam = np.sort(np.asarray(bingham.multiply(wide, narrow).lam))
    assert lam[2] - lam[3] == pytest.approx(-4, rel=1e-4)


def test_entropy_and_divergence(x64, densities):
    """Against their definitions by E[q q^T] of the reference."""
    a, b = densities
    log_c, moments, _ = reference.moments(np.asarray(a.lam))
    other = reference.moments(np.asarray(b.lam))[0]
    assert bingham.entropy(a) == pytest.approx(log_c - moments @ np.asarray(a.lam), abs=1e-12)
    moment = np.asarray(a.directions) @ np.diag(moments) @ np.asarray(a.directions).T
    expected = np.sum((matrix(a) - matrix(b)) * moment) - log_c + other
    assert bingham.kl_divergence(a, b) == pytest.approx(expected, abs=1e-11)
    assert np.abs(bingham.second_moment(a) - moment).max() < 1e-13
    assert bingham.kl_divergence(a, a) == pytest.approx(0, abs=1e-13)
    uniform = bingham.standard(np.zeros(4))
    assert bingham.entropy(uniform) == pytest.approx(np.log(2 * np.pi**2), abs=1e-13)


def test_fit_moment_inverts_second_moment(dtype):
    lam = LAM.astype(dtype)
    found = light(jax.vmap(lambda x: bingham.fit_moment(jnp.diag(bingham.second_moments(x)))))(lam)
    assert (np.asarray(found.status) == OK).all()
    got = np.sort(np.asarray(found.params.lam, np.float64), axis=1)
    expected = np.sort(LAM, axis=1)
    # A relative error of the moments, which sum to one, moves lam by about as much of 1 + |lam|.
    assert (np.abs(got - expected) / (1 + np.abs(expected))).max() < 4 * BOUNDS[dtype.name].moments
    assert found.params.directions.dtype == dtype


def test_fit_of_a_sample(dtype):
    """Within 4 standard errors, which follow from the Hessian, also where moments are 5e-7 in float32."""
    lam = np.array([0, -1e6, -1e4, -800])
    count = 20000
    truth = bingham.about(np.array([0.5, 0.5, -0.5, 0.5], dtype), lam.astype(dtype))
    xs = light(lambda key: bingham.sample(key, truth, (count,)))(jax.random.key(0))
    fit = light(bingham.fit)
    found = fit(xs)
    assert found.status == OK
    assert found.params.lam.dtype == dtype
    order = np.argsort(-np.asarray(found.params.lam))
    got = np.asarray(found.params.lam, np.float64)[order]
    expected = -np.sort(-lam)
    assert got[0] == 0
    assert (np.abs(got[1:] / expected[1:] - 1) < 4 * np.sqrt(2 / count)).all()  # lam_i is 1 / (2 E[x_i^2])
    across = np.abs(np.asarray(truth.directions[:, [0, 3, 2, 1]]).T @ np.asarray(found.params.directions)[:, order])
    assert np.abs(across - np.eye(4)).max() < 4 / np.sqrt(2 * 800 * count) * 5  # of neighbours less than 12 apart
    weighted = fit(np.concatenate([xs, xs[:5] * 0 + 0.5]), np.concatenate([np.ones(count), np.zeros(5)]))
    assert (
        np.abs(weighted.params.lam / np.where(found.params.lam == 0, 1, found.params.lam) - 1)[order[1:]].max() < 1e-3
    )


def test_fit_says_when_there_is_none():
    xs = unit(np.random.default_rng(0), 10).astype(np.float32)
    assert bingham.fit(xs).status == OK
    assert bingham.fit(xs[:3]).status == NOT_CONVERGED
    bad = bingham.fit(np.where(np.arange(10)[:, None] == 4, np.nan, xs))
    assert bad.status == NON_FINITE
    assert np.isnan(bad.params.lam).all()
    assert bingham.fit(xs, np.zeros(10, np.float32)).status == NON_FINITE
    assert bingham.fit_moment(np.diag([1.0, 1, 1, 0]).astype(np.float32)).status == NOT_CONVERGED


@pytest.mark.parametrize("params", [np.zeros((3, 3)), np.zeros(5), (np.zeros((4, 4)), np.zeros(3))])
def test_wrong_parameters(params):
    with pytest.raises(ValueError, match="has shape"):
        bingham.mode(params)
