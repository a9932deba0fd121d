"""Small decompositions against NumPy in float64, by their backward errors, alone and in batches of every kind."""

import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxest
from jaxest import linalg

SIZES = (1, 6, 9, 17, 30)
"""Both sides of where a batch changes from rows side by side to LAPACK in turn."""
COUNT = 9
"""Items, which are enough for rows side by side; three are not."""
QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}  # compiles faster


def drawn(n, dtype, positive=False):
    """Matrices (COUNT, n, n) whose singular values spread from not at all to as far as the dtype resolves."""
    rng = np.random.default_rng(n)
    left, right = (np.linalg.qr(rng.normal(size=(COUNT, n, n)))[0] for _ in range(2))
    spread = np.linspace(0, 0.8 * -np.log10(np.finfo(dtype).eps), COUNT)
    values = 10 ** (-spread[:, None] * np.linspace(0, 1, n)[None])
    a = (left * values[:, None]) @ np.swapaxes(left if positive else right, 1, 2)
    scale = 10.0 ** rng.integers(-6, 6, size=(COUNT, 1, 1))
    return (scale * (a + np.swapaxes(a, 1, 2)) / 2 if positive else scale * a).astype(dtype)


def right(n, dtype, columns=3):
    return np.random.default_rng(100 + n).normal(size=(COUNT, n, columns)).astype(dtype)


def every_way(f, *args):
    """The results (COUNT, ...) of a function of one item: alone, and many at once."""
    args = tuple(map(jnp.asarray, args))
    alone = jax.jit(lambda *x: jax.lax.map(lambda item: f(*item), x), compiler_options=QUICK)
    yield np.asarray(alone(*args), float)
    yield np.asarray(jax.jit(jax.vmap(f), compiler_options=QUICK)(*args), float)


def norm(x):
    return np.sqrt(np.sum(np.square(x), axis=tuple(range(1, x.ndim))))


@pytest.mark.parametrize("n", SIZES)
def test_cholesky_gives_the_matrix_back(n, dtype):
    a = drawn(n, dtype, positive=True)
    for root in every_way(linalg.cholesky, a):
        assert np.all(np.triu(root, 1) == 0)
        left = norm(root @ np.swapaxes(root, 1, 2) - a)
        assert np.all(left <= 2 * n * np.finfo(dtype).eps * norm(a.astype(float)))


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("n", SIZES)
def test_triangles_are_solved(n, transposed, dtype):
    a = drawn(n, dtype, positive=True)
    root, b = np.linalg.cholesky(a.astype(float)).astype(dtype), right(n, dtype)
    above = root + np.triu(np.ones_like(root), 1)  # is not looked at
    whole = np.swapaxes(root, 1, 2) if transposed else root
    for x in every_way(lambda m, y: linalg.solve_triangular(m, y, transposed=transposed), above, b):
        left = norm(whole.astype(float) @ x - b)
        assert np.all(left <= 2 * n * np.finfo(dtype).eps * norm(whole.astype(float)) * norm(x))


@pytest.mark.parametrize("n", SIZES)
def test_systems_are_solved(n, dtype):
    a, b = drawn(n, dtype), right(n, dtype)
    for x in every_way(linalg.solve, a, b):
        left = norm(a.astype(float) @ x - b)
        assert np.all(left <= 4 * n * np.finfo(dtype).eps * norm(a.astype(float)) * norm(x))


def test_vectors_and_shared_matrices(x64):
    a, b = drawn(5, "float64", positive=True)[0], right(5, "float64")
    root = np.linalg.cholesky(a)
    want = np.linalg.solve(a[None], b)
    for solve, matrix in ((linalg.solve, a), (linalg.cho_solve, root)):
        shared = jax.jit(jax.vmap(solve, (None, 0)))(matrix, b)
        np.testing.assert_allclose(shared, want, rtol=1e-11)
        vectors = jax.jit(jax.vmap(jax.vmap(solve, (None, 1), 1), (None, 0)))(matrix, b)
        np.testing.assert_allclose(vectors, want, rtol=1e-11)
        few = jax.jit(jax.vmap(jax.vmap(solve)))(jnp.broadcast_to(matrix, (3, 3, 5, 5)), b.reshape(3, 3, 5, 3))
        np.testing.assert_allclose(few.reshape(b.shape), want, rtol=1e-11)
        alone = solve(jnp.asarray(matrix), jnp.asarray(b[0, :, 0]))
        np.testing.assert_allclose(alone, want[0, :, 0], rtol=1e-11)


@pytest.mark.parametrize("n", [3, 16])
def test_determinants(n, dtype):
    a, b = drawn(n, dtype)[:1].repeat(COUNT, 0), right(n, dtype)  # well conditioned
    want = np.linalg.slogdet(a.astype(float))[1]
    for found in every_way(lambda m, y: linalg.solve_and_log_det(m, y)[1], a, b):
        np.testing.assert_allclose(found, want, rtol=0, atol=8 * n * np.finfo(dtype).eps * (1 + np.abs(want).max()))
    back = jax.jit(jax.vmap(linalg.inverse))(a)
    np.testing.assert_allclose(back @ a, np.broadcast_to(np.eye(n), a.shape), atol=32 * n * np.finfo(dtype).eps)


@pytest.mark.parametrize("n", [1, 5, 20])
def test_a_triangle_keeps_what_the_square_would_lose(n, dtype):
    a = np.concatenate([drawn(n, dtype), 0.5 * drawn(n, dtype)[:, ::-1]], axis=1)
    values = np.linalg.svd(a.astype(float), compute_uv=False)
    for r in every_way(linalg.upper, a):
        assert np.all(np.tril(r, -1) == 0)
        assert np.all(np.diagonal(r, axis1=1, axis2=2) >= 0)
        found = np.linalg.svd(r, compute_uv=False)
        assert np.all(np.abs(found - values).max(axis=1) <= 4 * n * np.finfo(dtype).eps * values[:, 0])
        left = norm(np.swapaxes(r, 1, 2) @ r - np.swapaxes(a, 1, 2).astype(float) @ a)
        assert np.all(left <= 8 * n * np.finfo(dtype).eps * norm(a.astype(float)) ** 2)


def test_a_triangle_of_nothing_is_nothing():
    a = np.zeros((COUNT, 6, 3), np.float32)
    a[:, :, 2] = 1
    for r in every_way(linalg.upper, a):
        np.testing.assert_allclose(r[:, :, :2], 0)
        np.testing.assert_allclose(np.linalg.norm(r[:, :, 2], axis=1), np.sqrt(6), rtol=1e-6)


@pytest.mark.parametrize("n", [4])
def test_eigenvalues(n, dtype):
    a = drawn(n, dtype, positive=True)
    for values in every_way(lambda m: linalg.eigh(m)[0], a):
        want = np.linalg.eigvalsh(a.astype(float))
        assert np.all(np.abs(values - want).max(axis=1) <= 4 * n * np.finfo(dtype).eps * want[:, -1])
    values, vectors = jax.jit(jax.vmap(linalg.eigh))(a)
    left = norm(np.asarray(vectors * values[:, None], float) @ np.swapaxes(vectors, 1, 2) - a)
    assert np.all(left <= 8 * n * np.finfo(dtype).eps * norm(a.astype(float)))


def test_what_is_not_positive_is_nan_and_its_neighbours_are_not(dtype):
    a = np.tile(np.eye(4, dtype=dtype), (COUNT, 1, 1))
    a[2, 3, 3], a[4, 0, 0], a[6, 1, 1] = -1, 0, np.nan
    bad = np.isin(np.arange(COUNT), [2, 4, 6])
    for root in every_way(linalg.cholesky, a):
        assert np.all(np.isnan(root[bad][:, 3, 3]))  # LAPACK leaves what came before a pivot that is NaN
        np.testing.assert_array_equal(root[~bad], a[~bad])


def ours(a, b):
    p = a @ a.T + jnp.eye(len(a))
    root = linalg.cholesky(p)
    solved, log_det = linalg.solve_and_log_det(a, b)
    r = linalg.upper(jnp.concatenate([a, b.T, a[:1] ** 2]))
    values, vectors = linalg.eigh(p)
    triangles = linalg.solve_triangular(root, b), linalg.solve_triangular(root, b[:, 0], transposed=True)
    return root, solved, log_det, linalg.solve(a, b), *triangles, r, values, (vectors * values[None]) @ vectors.T


def theirs(a, b):
    p = a @ a.T + jnp.eye(len(a))
    root = jnp.linalg.cholesky(p)
    solved = jnp.linalg.solve(a, b)
    r = jnp.linalg.qr(jnp.concatenate([a, b.T, a[:1] ** 2]), mode="r")
    r = r * jnp.sign(jnp.diagonal(r))[:, None]
    values, vectors = jnp.linalg.eigh(p)
    triangles = [
        jax.scipy.linalg.solve_triangular(root, y, trans=t, lower=True) for y, t in ((b, 0), (b[:, 0], 1))
    ]  # fmt: skip
    log_det = jnp.linalg.slogdet(a)[1]
    return root, solved, log_det, solved, *triangles, r, values, (vectors * values[None]) @ vectors.T


@pytest.mark.parametrize("n", [3, pytest.param(18, marks=pytest.mark.slow)])
def test_derivatives_are_those_of_jax(n, x64):
    a, b = (jnp.asarray(np.random.default_rng(n).normal(size=(COUNT, n, k))) for k in (n, 3))
    direction = (jnp.cos(a), jnp.sin(b))

    def loss(f):
        return lambda a, b: sum(jnp.sum(jnp.sin(x)) for x in f(a, b))

    def slopes(f):
        return jax.grad(lambda a, b: jnp.sum(jax.vmap(loss(f))(a, b)), (0, 1))

    def forward(a, b, *d):
        return jax.vmap(lambda a, b, *d: jax.jvp(loss(ours), (a, b), d)[1])(a, b, *d)

    want = jax.jit(slopes(theirs), compiler_options=QUICK)(a, b)
    got, along = jax.jit(lambda a, b, *d: (slopes(ours)(a, b), forward(a, b, *d)), compiler_options=QUICK)(
        a, b, *direction
    )
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-8 * float(jnp.abs(y).max())), got, want)
    total = sum(jnp.sum(g * d, axis=(1, 2)) for g, d in zip(want, direction, strict=True))
    np.testing.assert_allclose(along, total, atol=1e-8 * float(jnp.abs(total).max()))

    h = 1e-6
    ahead, behind = (loss(theirs)(*(x[0] + s * d[0] for x, d in zip((a, b), direction, strict=True))) for s in (h, -h))
    assert abs((ahead - behind) / (2 * h) - along[0]) < 1e-5 * (1 + abs(along[0]))


def test_equal_eigenvalues_have_finite_derivatives(x64):
    slope = jax.grad(lambda s: jnp.sum(linalg.eigh(s * jnp.eye(3))[1]) + jnp.sum(linalg.eigh(s * jnp.eye(3))[0]))(2.0)
    assert float(slope) == 3.0


LAPACK = re.compile(r"\b(?:jnp|jax\.numpy|lax|jax\.scipy|scipy)\.linalg\.(?!norm\b|block_diag\b)\w+")


def test_the_package_calls_no_other_linear_algebra():
    package = Path(jaxest.__file__).parent
    home = ("linalg", "bench", "reproduce")  # where what others do is measured, batches are the peers' own
    found = [
        f"{path.relative_to(package)}: {match.group()}"
        for path in package.rglob("*.py") if path.relative_to(package).parts[0] not in home
        for match in LAPACK.finditer(path.read_text())
    ]  # fmt: skip
    assert found == []


HANG = """
import jax, jax.numpy as jnp, numpy as np
from jaxest import linalg
a = np.random.default_rng(0).normal(size=(200, 20, 20)).astype(np.float32)
p = a @ a.swapaxes(1, 2) + 20 * np.eye(20, dtype=np.float32)
f = jax.jit(lambda a, p: (jax.vmap(linalg.cholesky)(p), jax.vmap(linalg.solve)(a, p[:, 0]), jax.vmap(linalg.upper)(p)))
for _ in range(300):
    jax.block_until_ready(f(a, p))
"""


@pytest.mark.slow
def test_batches_at_once_on_two_threads_return():
    # With LAPACK's own batches this sleeps for ever, most of the times.
    environment = {**os.environ, "NPROC": "2"}
    subprocess.run([sys.executable, "-c", HANG], env=environment, timeout=240, check=True)
