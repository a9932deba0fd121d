"""The Bingham normalizer, its gradient and its Hessian against 60 digits and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bingham_cases import BOUNDS, LAM, LIGHT, SIZES, rotations
from reference import ref_bingham as reference
from reference.ref_von_mises import bessel

from jaxest.distributions import bingham

REFERENCE = [reference.moments(lam) for lam in LAM]
CLOSED = {"three_equal": [-1, -1, -1, 0], "one_low": [-1, 0, 0, 0], "two_equal": [-1, -1, 0, 0]}


def orders(lam):
    """log C, gradient and Hessian by jax.grad and jax.hessian, as a user has them."""
    f = bingham.log_normalizer
    return f(lam), jax.grad(f)(lam), jax.hessian(f)(lam)


def batched(function, *arguments):
    out = jax.jit(jax.vmap(function), compiler_options=LIGHT)(*arguments)
    dtype = arguments[0].dtype
    assert all(x.dtype == dtype for x in jax.tree.leaves(out))
    return jax.tree.map(lambda x: np.asarray(x, np.float64), out)


def check(got, expected, dtype):
    bounds = BOUNDS[dtype.name]
    assert np.abs(got[0] - expected[0]).max() < bounds.log_c
    assert np.abs(got[1] / expected[1] - 1).max() < bounds.moments
    if len(expected) > 2:
        assert np.abs(got[2] - expected[2]).max() < bounds.hessian


def test_value_gradient_and_hessian(dtype):
    check(batched(orders, LAM.astype(dtype)), [np.array(x) for x in zip(*REFERENCE, strict=True)], dtype)


def test_the_named_functions_are_the_derivatives(dtype):
    lam = LAM.astype(dtype)
    _, gradient, hessian = batched(orders, lam)
    named = batched(lambda x: (bingham.second_moments(x), bingham.moment_covariance(x)), lam)
    # The same sums in other programs: their terms are up to 120 times as large as the sum, each with its rounding.
    assert np.abs(named[0] / gradient - 1).max() < 120 * np.finfo(dtype).eps
    assert np.abs(named[1] - hessian).max() < 120 * np.finfo(dtype).eps


def test_up_to_a_million(dtype):
    cases = [(np.array(lam) * size, getattr(reference, name)(size)) for name, lam in CLOSED.items() for size in SIZES]
    lam = np.array([x for x, _ in cases]).astype(dtype)
    check(batched(orders, lam), [np.array(x) for x in zip(*(e for _, e in cases), strict=True)], dtype)


def test_a_shift_is_added_and_a_permutation_follows(dtype):
    lam = LAM[[0, 1, 2, 3, 5, 6, 7]].astype(dtype)  # those that a shift by 64 does not round
    log_c, moments, hessian = batched(orders, lam)
    shifted = batched(orders, lam + np.asarray(64, dtype))
    eps = np.finfo(dtype).eps
    assert np.abs(shifted[0] - 64 - log_c).max() <= 64 * eps  # an ulp of 64
    np.testing.assert_array_equal(shifted[1], moments)
    order = [2, 0, 3, 1]
    check(batched(orders, lam[:, order]), (log_c, moments[:, order], hessian[:, order][:, :, order]), dtype)


def test_leading_axes_and_no_jit(x64):
    lam = jnp.asarray(LAM[:6].reshape(2, 3, 4))
    assert np.asarray(bingham.log_normalizer(lam)).ravel() == pytest.approx([r[0] for r in REFERENCE[:6]], abs=1e-12)
    assert bingham.second_moments(lam).shape == (2, 3, 4)
    assert bingham.moment_covariance(lam).shape == (2, 3, 4, 4)


def test_infinite_concentration_is_the_limit(dtype):
    """Two infinite ones leave a circle: the von Mises distribution of concentration 2 for the doubled angle."""
    lam = np.array([-np.inf, -np.inf, -4, 0], dtype)
    moments = np.asarray(bingham.second_moments(lam), np.float64)
    half = float(bessel(2).complement) / 2
    assert (moments[:2] == 0).all()
    assert np.abs(moments[2:] / [half, 1 - half] - 1).max() < BOUNDS[dtype.name].moments
    assert bingham.log_normalizer(lam) == -np.inf


def test_third_derivative(x64):
    lam = jnp.asarray([-3.0, -1.0, -1.0, 0.0])
    third = jax.jit(jax.jacfwd(bingham.moment_covariance), compiler_options=LIGHT)(lam)
    h = 1e-4
    for i in range(4):
        step = h * np.eye(4)[i]
        slope = (reference.moments(lam + step)[2] - reference.moments(lam - step)[2]) / (2 * h)
        assert np.abs(third[..., i] - slope).max() < 1e-8  # truncation h^2, rounding 1e-16 / h


@pytest.mark.parametrize("shape", [(), (3,), (2, 5)])
def test_wrong_shapes(shape):
    with pytest.raises(ValueError, match=r"lam: has shape .* expected \(\.\.\., 4\)"):
        bingham.log_normalizer(np.zeros(shape, np.float32))


def test_of_a_matrix_with_equal_eigenvalues(x64):
    """Value, gradient and Hessian of the log density where eigenvectors have no derivative."""
    x = np.array([0.5, -0.5, 0.1, 0.7])
    x /= np.linalg.norm(x)
    directions = rotations(3)
    lam = np.array([[0, -5, -5, -40], [-2, -2, -2, -2], [-7, 0, 0, -7.0]])
    matrices = jnp.asarray(np.einsum("nij,nj,nkj->nik", directions, lam, directions))
    moves = np.random.default_rng(1).normal(size=(2, 4, 4))
    moves = moves + np.swapaxes(moves, 1, 2)

    def along(matrix, s, t):
        return bingham.log_prob(x, matrix + s * moves[0] + t * moves[1])

    def derivatives(matrix):
        f = lambda s, t: along(matrix, s, t)  # noqa: E731
        first, second = jax.grad(f), jax.grad(jax.grad(f), 1)
        return f(0.0, 0.0), first(0.0, 0.0), second(0.0, 0.0)

    got = jax.jit(jax.vmap(derivatives), compiler_options=LIGHT)(matrices)

    def exact(matrix):
        values, vectors = np.linalg.eigh(matrix)
        return x @ matrix @ x - reference.moments(values)[0], vectors

    h = 1e-3
    for i, matrix in enumerate(np.asarray(matrices)):
        value = [[exact(matrix + a * h * moves[0] + b * h * moves[1])[0] for b in (-1, 0, 1)] for a in (-1, 0, 1)]
        assert got[0][i] == pytest.approx(value[1][1], abs=1e-12)
        assert got[1][i] == pytest.approx((value[2][1] - value[0][1]) / (2 * h), abs=2e-5)
        mixed = (value[2][2] - value[2][0] - value[0][2] + value[0][0]) / (4 * h * h)
        assert got[2][i] == pytest.approx(mixed, abs=2e-5)  # truncation of order h^2 times a fourth derivative


@pytest.mark.recorded
def test_oracle_table(shared, dtype):
    with np.load(shared / "oracles" / "bingham_s3.npz") as oracle:
        lam = oracle["lam"].astype(dtype)
        check(batched(orders, lam), [oracle["logC"], oracle["moments"], oracle["hess_logC"]], dtype)
        entropy = batched(bingham.entropy, lam)
        assert np.abs(entropy - oracle["entropy"]).max() < BOUNDS[dtype.name].log_c
        pairs = oracle["sm_D"].astype(dtype), lam[oracle["sm_index"]]
        moment = batched(lambda d, x: bingham.second_moment(bingham.Params(d, x)), *pairs)
        assert np.abs(moment - oracle["sm_second_moment"]).max() < BOUNDS[dtype.name].moments
