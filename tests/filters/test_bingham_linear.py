"""The Bingham linear filter against the stored oracle, loops over the pairs and repeated draws."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK
from scipy.spatial.transform import Rotation

from jaxest.filters import bingham_linear as bingham
from jaxest.filters import last, run
from jaxest.filters._small import inverse3, largest
from jaxest.linalg._eigen4 import eigen4
from jaxest.types import NON_FINITE, Reading


def matrix(a, b):
    """H written out."""
    d, s = a - b, a + b
    cross = np.array([[0, -s[2], s[1]], [s[2], 0, -s[0]], [-s[1], s[0], 0]])
    return np.block([[np.zeros((1, 1)), -d[None, :]], [d[:, None], cross]])


def pairs(seed, count, noise=0.02, bias=0.1, spread=(1.0, 1.0, 1.0)):
    random = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=random)
    b = random.normal(size=(count, 3)) * spread
    c = bias * random.normal(size=3)
    a = rotation.apply(b) + c + noise * random.normal(size=(count, 3))
    return a, b + noise * random.normal(size=(count, 3)), rotation, c


def measured(a, b, dtype=float):
    there = np.ones(len(a), bool)
    return bingham.Pair(Reading(a.astype(dtype), there), Reading(b.astype(dtype), there), np.zeros(len(a), dtype))


def test_the_matrix_vanishes_on_the_rotation(x64):
    a, b, rotation, c = pairs(0, 5, noise=0.0)
    q = rotation.as_quat(scalar_first=True)
    for x, y in zip(a - c, b, strict=True):
        found = np.asarray(bingham.pair_matrix(x, y))
        np.testing.assert_array_equal(found, matrix(x, y))
        np.testing.assert_allclose(found @ q, 0, atol=1e-14)
        wrong = rotation.inv().as_quat(scalar_first=True)
        assert np.linalg.norm(found @ wrong) > 0.1


@pytest.mark.recorded
def test_modes_of_the_oracle(shared, dtype):
    """80 cases, few or many pairs, well or barely determined: from A itself and from the pairs."""
    z = np.load(shared / "oracles" / "wahba.npz")
    tolerance = 1e-12 if dtype == "float64" else 1e-5

    def difference(q, expected):
        q = np.asarray(q, float)
        return np.minimum(np.abs(q - expected).max(axis=1), np.abs(q + expected).max(axis=1)).max()

    mode = jax.jit(jax.vmap(lambda a: largest(*eigen4(a))), compiler_options=QUICK)
    assert difference(mode(z["A_unit"].astype(dtype)), z["q_mode"]) < tolerance
    assert difference(mode(z["A_S1"].astype(dtype)), z["q_mode_S1"]) < tolerance
    there = np.arange(12) < z["npair"][:, None]
    w = np.where(there, z["w"], 0)
    stacked = np.where(there[..., None], np.concatenate([z["a"], z["b"]], axis=-1), 0)
    second = np.einsum("cn,cni,cnj->cij", w, stacked, stacked).astype(dtype)
    closed = jax.jit(jax.vmap(bingham.parameter), compiler_options=QUICK)(second)
    assert difference(mode(closed), z["q_mode"]) < tolerance

    @partial(jax.jit, compiler_options=QUICK)
    @jax.vmap
    def general(a, b, second):
        return bingham.noise_matrix(a, b), bingham.parameter(second, bingham.general(a, b))

    sigma, a = general(z["Sigma_a"].astype(dtype), z["Sigma_b"].astype(dtype), second)
    np.testing.assert_allclose(sigma, z["Sigma_H"], rtol=0, atol=10 * np.finfo(dtype).eps * np.abs(z["Sigma_H"]).max())
    count = np.einsum("cn,cni,cnj->cij", there.astype(float), stacked, stacked).astype(dtype)
    unweighted = general(z["Sigma_a"].astype(dtype), z["Sigma_b"].astype(dtype), count)[1]
    fits = [difference(mode(x), z["q_mode_S1"]) for x in (a, unweighted)]
    assert min(fits) < 30 * tolerance, fits


@pytest.mark.parametrize("information", [None, bingham.general])
def test_against_a_loop(information, dtype):
    """Forgetting and the prior of the bias, written as augmented least squares over the pairs."""
    a, b, _, _ = pairs(3, 40)
    gamma, deviation, level = 0.95, 0.3, 0.02**2
    noise = np.diag([level] * 3)
    params = bingham.Params(*(np.asarray(x, dtype) for x in (noise, noise, deviation, gamma)))
    step = partial(bingham.step, information=information)
    _, info = run(step, params, bingham.init(params), measured(a, b, dtype))
    w = gamma ** np.arange(39, -1, -1.0)
    # The bias' prior is an observation of c = 0 with a variance of deviation^2, per pair noise of 2 level.
    n, n0 = w.sum(), 2 * level / deviation**2
    mean = np.concatenate([w @ a, w @ b]) / n
    z = np.hstack([a, b]) - mean
    second = np.einsum("n,ni,nj->ij", w, z, z) + n * n0 / (n + n0) * np.outer(mean, mean)
    h = [matrix(*np.split(unit, 2)) for unit in np.eye(6)]
    total = -sum(second[i, j] * h[i].T @ h[j] for i in range(6) for j in range(6)) * 2 / (6 * level)
    q = np.linalg.eigh(total)[1][:, -1]
    q = q if q[0] > 0 else -q
    r = Rotation.from_quat(q, scalar_first=True).as_matrix()
    tolerance = 1e-11 if dtype == "float64" else 2e-5
    np.testing.assert_allclose(info.quaternion[-1], q, atol=tolerance)
    np.testing.assert_allclose(info.bias[-1], (mean[:3] - r @ mean[3:]) * n / (n + n0), atol=tolerance)
    assert info.quaternion.dtype == dtype


def test_the_covariance_is_that_of_repeated_draws(x64):
    """400 runs of 300 pairs, uneven motion: NEES of rotation and residual, within 4 standard errors."""
    draws = [pairs(seed, 300, 0.05, 0.2, (1.0, 0.3, 0.6)) for seed in range(400)]
    noise = 0.05**2 * np.eye(3)
    params = bingham.Params(noise, noise, 1.0, 1.0)
    a, b = (np.stack([d[i] for d in draws]) for i in (0, 1))

    @partial(jax.jit, compiler_options=QUICK)
    @jax.vmap
    def many(a, b):
        there = np.ones(300, bool)
        samples = bingham.Pair(Reading(a, there), Reading(b, there), np.zeros(300))
        return run(bingham.step, params, bingham.init(params), samples)[1]

    info = many(a, b)
    found = Rotation.from_quat(np.asarray(info.quaternion[:, -1]), scalar_first=True)
    truth = Rotation.concatenate([d[2] for d in draws])
    error = (found.inv() * truth).as_rotvec()
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(info.covariance[:, -1]), error)
    assert abs(nees.mean() - 3) < 4 * np.sqrt(6 / 400)
    np.testing.assert_allclose(np.mean(info.residual[:, -1], axis=0), 2 * noise, atol=2 * noise[0, 0] * 4 / 200)
    bias = np.asarray(info.bias[:, -1]) - np.stack([d[3] for d in draws])
    assert np.sqrt(np.mean(bias**2)) < 0.05 * np.sqrt(2 / 300) * 1.2
    # The evidence of the second half is that of white noise of the predicted size, to 4 standard errors of its mean.
    expected = -1.5 * (1 + np.log(2 * np.pi) + np.log(2 * 0.05**2))
    np.testing.assert_allclose(np.mean(info.log_evidence[:, 150:]), expected, atol=0.03)
    assert np.all(info.valid[:, -1])


def test_one_axis_alone_is_not_enough(x64):
    a, b, _, _ = pairs(5, 200, spread=(1.0, 0.0, 0.0))
    noise = 0.02**2 * np.eye(3)
    params = bingham.Params(noise, noise, 1.0, 1.0)
    _, info = run(bingham.step, params, bingham.init(params), measured(a, b), history=last)
    assert not info.valid
    assert np.linalg.eigvalsh(info.covariance)[-1] > 0.09


def test_what_cannot_be_used():
    params = bingham.Params(*(np.float32(x) for x in bingham.Params()))
    bad = bingham.Pair(Reading(np.float32([1, np.nan, 0]), np.True_), Reading(np.ones(3, np.float32), np.True_), 0.0)
    state, info = bingham.step(params, bingham.init(params), bad)
    assert int(info.status) == NON_FINITE
    assert float(state.weight) == 0
    with pytest.raises(ValueError, match=r"measurement\.b: got shapes \(4,\)"):
        bingham.step(params, state, bad._replace(b=Reading(np.ones(4), np.True_)))


def test_small_inverses_and_eigenvectors(dtype):
    random = np.random.default_rng(0)
    basis = np.linalg.qr(random.normal(size=(300, 4, 4)))[0]
    spectra = np.concatenate([random.normal(size=(200, 4)), np.tile([0, -1e-6, -1, -1e3], (50, 1)), np.ones((50, 4))])
    a = np.einsum("nij,nj,nkj->nik", basis, spectra, basis).astype(dtype)
    values, vectors = (np.asarray(x, float) for x in jax.jit(jax.vmap(eigen4), compiler_options=QUICK)(a))
    eps = np.finfo(dtype).eps
    rebuilt = np.einsum("nij,nj,nkj->nik", vectors, values, vectors)
    assert np.all(np.abs(rebuilt - a).max(axis=(1, 2)) < 20 * eps * np.abs(a).max(axis=(1, 2)))
    assert np.abs(np.einsum("nij,nik->njk", vectors, vectors) - np.eye(4)).max() < 20 * eps
    b = a[:200, :3, :3] @ a[:200, :3, :3] + np.eye(3, dtype=dtype)
    b = b * np.outer([1, 1e3, 1e-3], [1, 1e3, 1e-3]).astype(dtype)
    found = np.asarray(jax.jit(jax.vmap(inverse3), compiler_options=QUICK)(b), float)
    residual = found @ b.astype(float) - np.eye(3)
    scale = np.array([1, 1e3, 1e-3])
    assert np.abs(residual * scale[:, None] / scale[None, :]).max() < 2000 * eps
    assert np.all(np.asarray(inverse3(jnp.zeros((3, 3), dtype))) == 0)


def test_derivatives_of_the_mode(x64):
    random = np.random.default_rng(2)
    a, d = random.normal(size=(2, 4, 4))
    a, d = a + a.T, d + d.T

    def mode(a):
        return largest(*eigen4(a))

    slope = jax.jvp(mode, (a,), (d,))[1]
    np.testing.assert_allclose(slope, (mode(a + 1e-6 * d) - mode(a - 1e-6 * d)) / 2e-6, atol=1e-8)
