"""Means: the point where the weighted differences vanish, its derivatives, and the cases that have no answer."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from manifold_cases import LIGHT, apart
from reference import ref_manifolds as reference

from jaxest.manifolds import Group, circle, quaternion, se3, so3

GROUPS: dict[str, Group] = {"circle": circle, "quaternion": quaternion, "so3": so3, "se3": se3}
SPREADS = np.array([1e-6, 1e-3, 0.1, 0.5, 1.0])


def clouds(name, dtype):
    """Tangent vectors (n, 8, dim) of samples around centres (n, dim), the rotations up to a quarter turn away."""
    rng = np.random.default_rng(6)
    dim = GROUPS[name].dim
    v = rng.normal(size=(4 * len(SPREADS), 8, dim)) * np.repeat(SPREADS, 4)[:, None, None]
    length = np.linalg.norm(v[..., :3], axis=-1, keepdims=True)
    v[..., :3] *= np.minimum(1, 1.5 / length)
    return rng.normal(size=(len(v), dim)).astype(dtype), v.astype(dtype), rng.uniform(0.1, 1, (len(v), 8)).astype(dtype)


@functools.cache
def functions(name):
    """retract (n,) -> (n, 8), mean over the samples, local (n,) -> (n, 8), each compiled once a precision."""
    group = GROUPS[name]
    spread = functools.partial(jax.vmap, in_axes=(None, 0))
    return tuple(
        jax.jit(jax.vmap(f), compiler_options=LIGHT) for f in (spread(group.retract), group.mean, spread(group.local))
    )


@pytest.fixture(params=GROUPS)
def name(request):
    return request.param


@functools.cache
def results(name, dtype):
    """Samples, weights and their means."""
    retract, mean, _ = functions(name)
    centre, vs, weights = clouds(name, dtype)
    xs = retract(jax.vmap(GROUPS[name].exp)(centre), vs)
    return xs, weights, mean(xs, weights)


def test_the_weighted_differences_from_the_mean_vanish(name, dtype):
    xs, weights, m = results(name, dtype)
    assert all(leaf.dtype == dtype for leaf in jax.tree.leaves(m))
    differences = np.asarray(functions(name)[2](m, xs), np.float64)
    rest = np.einsum("ns,nsi->ni", weights, differences) / weights.sum(axis=1, keepdims=True)
    # Differences of elements of size one to four, each right to a few eps.
    assert apart(rest, 0) <= 8 * float(np.finfo(dtype).eps)


def test_the_mean_of_two_lies_between_them(name, dtype):
    xs, weights, _ = results(name, dtype)
    _, mean, local = functions(name)
    m = mean(xs, np.broadcast_to(np.array([3, 1, 0, 0, 0, 0, 0, 0], dtype), weights.shape))
    first = jax.tree.map(lambda leaf: leaf[:, 0], xs)
    ways = np.asarray(local(first, jax.tree.map(lambda leaf, mid: leaf.at[:, 2].set(mid), xs, m)))
    assert apart(ways[:, 2], ways[:, 1] / 4) <= 16 * float(np.finfo(dtype).eps)


def test_mean_against_plain_gradient_descent(x64):
    xs, weights, means = results("quaternion", np.dtype(np.float64))
    for i in range(0, len(weights), 3):
        exact = reference.rotation_mean(np.asarray(xs[i]), weights[i])
        mean = np.asarray(means[i])
        assert apart(mean * np.sign(mean @ exact), exact) <= 1e-14


@pytest.mark.parametrize("name", ["circle", "quaternion", "se3"])  # SO(3)'s mean is the quaternion's
def test_derivative_of_the_mean(name, x64):
    """Against difference quotients, all samples moved along (1, ..., 1)."""
    retract, mean, _ = functions(name)
    centre, vs, weights = clouds(name, np.float64)
    x, h = jax.vmap(GROUPS[name].exp)(centre), 1e-5
    xs, high, low = (retract(x, vs + k * h) for k in (0, 1, -1))

    def quotient(high, low):
        return jax.tree.map(lambda a, b: (a - b) / (2 * h), high, low)

    def total(xs, weights):
        return jnp.sum(ravel_pytree(GROUPS[name].mean(xs, weights))[0])

    moved = quotient(high, low)
    pull = jax.jit(jax.vmap(jax.grad(total)), compiler_options=LIGHT)(xs, weights)
    along = sum(inner(a, b) for a, b in zip(jax.tree.leaves(pull), jax.tree.leaves(moved), strict=True))
    expected = quotient(mean(high, weights), mean(low, weights))
    assert apart(along, sum(inner(leaf, np.ones_like(leaf)) for leaf in jax.tree.leaves(expected))) <= 1e-8
    if name == "quaternion":  # SE(3) adds nothing of its own

        def push(xs, moved, weights):
            return jax.jvp(lambda xs: quaternion.mean(xs, weights), (xs,), (moved,))[1]

        got = jax.jit(jax.vmap(push), compiler_options=LIGHT)(xs, moved, weights)
        assert apart(got, expected) <= 1e-8


def inner(a, b):
    """Inner products (n,) of the rest of two arrays (n, ...)."""
    return np.sum((np.asarray(a) * np.asarray(b)).reshape(len(a), -1), axis=1)


def test_equal_weights_are_the_default_and_neither_scale_nor_sign_matters():
    xs = jax.vmap(quaternion.exp)(jax.random.normal(jax.random.key(0), (6, 3)) * 0.5)
    mean = jax.jit(quaternion.mean, compiler_options=LIGHT)
    flipped = xs * jnp.array([1, -1, 1, -1, -1, 1.0])[:, None]
    assert apart(mean(flipped, 7 * jnp.ones(6)), mean(xs)) <= 1e-6


@pytest.mark.parametrize("name", ["circle", "quaternion"])
def test_no_samples_that_count_is_finite(name):
    group = GROUPS[name]
    xs = jax.vmap(group.exp)(jnp.ones((3, group.dim)))
    value, slope = jax.jit(jax.value_and_grad(lambda xs: jnp.sum(group.mean(xs, jnp.zeros(3)))))(xs)
    assert np.isfinite(value)
    assert np.isfinite(slope).all()


def test_circle_means():
    # The intrinsic mean is linear, also across the cut; the direction of the mean vector is not.
    xs = jnp.array([3.0, -3.0, 2.5])
    unwrapped = np.array([3.0, 2 * np.pi - 3, 2.5]).mean()
    assert float(circle.mean(xs)) == pytest.approx(unwrapped, abs=1e-6)
    assert float(circle.mean_direction(xs)) == pytest.approx(np.angle(np.exp(1j * np.asarray(xs)).mean()), abs=1e-6)
    weights = jnp.array([1.0, 2.0, 3.0])
    slope = jax.grad(lambda xs: circle.mean(xs, weights))(xs)
    assert apart(slope, np.asarray(weights) / 6) <= 1e-6
    assert np.isfinite(jax.grad(circle.mean_direction)(jnp.zeros(2), jnp.zeros(2))).all()
