"""Recursive least squares against loops, batch solutions and repeated draws."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK

from jaxest.filters import last, rls, run
from jaxest.types import NON_FINITE, Reading

X = np.array([0.2, -0.1, 0.05])


def observed(o, y, noise=None, valid=None):
    count = len(o)
    there = np.ones(count, bool) if valid is None else valid
    noise = np.zeros((count, 3, 3)) if noise is None else noise
    dtype = o.dtype
    return rls.Observation(Reading(o, there), Reading(y, there), noise.astype(dtype), np.zeros(count, dtype))


def loop(o, y, gamma, lag, floor):
    """Algorithm 1 with the forgetting on the old term and as many residuals as there are."""
    p, q, x, queue = np.zeros((3, 3)), np.zeros(3), np.zeros(3), []
    out = []
    for ok, yk in zip(o, y, strict=True):
        queue = [*queue, yk - ok @ x][-lag:]
        c = sum(np.outer(d, d) for d in queue) / (max(len(queue), 2) - 1) + floor**2 * np.eye(3)
        p = gamma * p + ok.T @ np.linalg.pinv(c) @ ok
        q = gamma * q + ok.T @ np.linalg.pinv(c) @ yk
        x = np.linalg.solve(p, q)
        out.append((x, np.linalg.inv(p), c))
    return [np.array(x) for x in zip(*out, strict=True)]


def test_against_algorithm_1(dtype):
    random = np.random.default_rng(0)
    o = random.normal(size=(60, 3, 3)) + 2 * np.eye(3)
    y = o @ X + 0.01 * random.normal(size=(60, 3)) * [1, 2, 0.5]
    params = rls.Params(*(np.asarray(v, dtype) for v in (0.97, 0.0, 1e-2)))
    step = partial(rls.step, start=rls.pseudo_inverse)
    _, info = run(step, params, rls.init(params, lag=20), observed(o.astype(dtype), y.astype(dtype)))
    x, p, c = loop(o, y, 0.97, 20, 1e-2)
    tight = dtype == "float64"
    np.testing.assert_allclose(info.estimate, x, atol=1e-11 if tight else 1e-4)
    np.testing.assert_allclose(info.noise, c, rtol=1e-9 if tight else 2e-3, atol=1e-14 if tight else 1e-7)
    scale = np.abs(p).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(info.formal / scale, p / scale, atol=1e-9 if tight else 5e-3)
    assert info.estimate.dtype == dtype


def test_a_patient_start_is_least_squares_until_the_queue_is_full(x64):
    random = np.random.default_rng(0)
    o = random.normal(size=(60, 3, 3)) + 2 * np.eye(3)
    y = o @ X + 0.01 * random.normal(size=(60, 3))
    params = rls.Params(1.0, 0.0, 0.0)
    _, info = run(rls.step, params, rls.init(params, lag=40), observed(o, y))
    expected = np.linalg.lstsq(o[:30].reshape(-1, 3), y[:30].reshape(-1), rcond=None)[0]
    np.testing.assert_allclose(info.estimate[29], expected, atol=1e-12)
    variance = np.trace(info.noise[29]) / 3
    gram = np.einsum("nij,nik->jk", o[:30], o[:30])
    np.testing.assert_allclose(info.formal[29], variance * np.linalg.inv(gram), rtol=1e-9)
    # Nothing jumps where the weights change.
    assert np.abs(np.diff(np.asarray(info.estimate[35:45]), axis=0)).max() < 2e-3
    np.testing.assert_allclose(np.trace(info.formal[39]), np.trace(info.formal[38]), rtol=0.5)


def test_square_roots_give_the_same_with_half_the_digits():
    """A regressor with columns of very different size, in float32: the factor is right where the square is not."""
    random = np.random.default_rng(1)
    o = random.normal(size=(40, 3, 3)) @ np.diag([1.0, 1.0, 0.0]) + 1e-4 * random.normal(size=(40, 3, 3))
    x = np.array([1.0, -2.0, 3.0])
    y = o @ x
    state = rls.Triangle(jnp.zeros((3, 3), jnp.float32), jnp.zeros(3, jnp.float32))
    step = jax.jit(rls.square_root_step)
    for ok, yk in zip(o.astype(np.float32), y.astype(np.float32), strict=True):
        state = step(state, ok, yk, 0.9)
    w = np.repeat(0.9 ** (np.arange(39, -1, -1.0) / 2), 3)
    expected = np.linalg.lstsq(w[:, None] * o.reshape(-1, 3), w * y.reshape(-1), rcond=None)[0]
    root = np.asarray(state.root, float)
    np.testing.assert_allclose(np.linalg.solve(root, np.asarray(state.right, float)), expected, atol=5e-3)
    gram = (w[:, None] * o.reshape(-1, 3)).T @ (w[:, None] * o.reshape(-1, 3))
    np.testing.assert_allclose(root.T @ root, gram, atol=1e-5 * gram.max())
    assert np.all(np.tril(root, -1) == 0)


@pytest.fixture(scope="module")
def attenuated():
    """100 runs of 1000 steps whose regressors are noisy and whose errors are running means of 5."""
    random = np.random.default_rng(3)
    runs, steps, width = 100, 1000, 5
    clean = random.normal(size=(runs, steps, 3, 3))
    clean = np.repeat(clean[:, ::10], 10, axis=1)  # slow, so that correlated errors matter
    noise = 0.3 * random.normal(size=clean.shape)
    white = 0.1 * random.normal(size=(runs, steps + width, 3))
    error = np.stack([white[:, i : i + steps] for i in range(width)]).sum(axis=0) / width
    y = np.einsum("rtij,j->rti", clean, X) + error
    return clean, noise, y


def final(o, y, expected):
    params = rls.Params(1.0, 0.0, 1e-3)

    @partial(jax.jit, compiler_options=QUICK)
    @jax.vmap
    def many(o, y):
        samples = observed(o, y, jnp.broadcast_to(expected, o.shape))
        return run(partial(rls.step, block=50), params, rls.init(params), samples, history=last)[1]

    return many(o, y)


def test_noisy_regressors_shrink_the_estimate_unless_told(attenuated, x64):
    clean, noise, y = attenuated
    plain, told = (final(clean + noise, y, expected) for expected in (np.zeros((3, 3)), 3 * 0.09 * np.eye(3)))
    spread = np.std(told.estimate, axis=0) / np.sqrt(100)
    assert np.all(np.abs(np.mean(told.estimate, axis=0) - X) < 4 * spread)
    gram = np.einsum("rtij,rtik->rjk", clean, clean)
    shrunk = np.linalg.solve(gram + 1000 * 3 * 0.09 * np.eye(3), (gram @ X)[..., None])[..., 0]
    np.testing.assert_allclose(np.mean(plain.estimate, axis=0), np.mean(shrunk, axis=0), atol=4 * spread.max())
    assert np.abs(np.mean(plain.estimate, axis=0) - X).max() > 8 * spread.max()


def test_blocks_make_the_covariance_honest(attenuated, x64):
    """NEES with 3 x 100 samples and 20 blocks each: between 3 - 4 sd and Hotelling's 3 * 19 / 16 + 4 sd."""
    clean, _, y = attenuated
    info = final(clean, y, np.zeros((3, 3)))
    error = np.asarray(info.estimate) - X

    def nees(covariance):
        return np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error).mean()

    assert 3 - 4 * np.sqrt(6 / 100) < nees(info.covariance) < 3 * 19 / 16 + 4 * np.sqrt(6 / 100) * 1.5
    assert nees(info.formal) > 3 * 2  # 5 times where a regressor is constant over the errors' correlation


def test_what_cannot_be_used():
    params = rls.Params(np.float32(1), np.float32(0), np.float32(1e-6))
    state = rls.init(params)
    good = at_first(observed(np.eye(3, dtype=np.float32)[None], np.ones((1, 3), np.float32)))
    bad = good._replace(target=Reading(np.float32([np.inf, 0, 0]), np.True_))
    after, info = rls.step(params, state, bad)
    assert int(info.status) == NON_FINITE
    assert int(after.seen) == 0
    assert not info.valid
    with pytest.raises(ValueError, match=r"expected \(3, 3\), \(3,\)"):
        rls.step(params, state, good._replace(target=Reading(np.zeros(4), np.True_)))
    with pytest.raises(ValueError, match="lag: got 2"):
        rls.init(params, lag=2)
    with pytest.raises(ValueError, match="block: got 0"):
        rls.step(params, state, good, block=0)


def at_first(tree):
    return jax.tree.map(lambda x: x[0], tree)
