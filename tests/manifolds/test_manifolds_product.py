"""States put together from manifolds: the tangent vector is cut and joined in the order of the leaves."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxest.manifolds import Euclidean, Manifold, Pose, Power, circle, product, quaternion, se3, so3


class State(NamedTuple):
    joints: object
    base: object
    parts: object


def manifold():
    return product.of(
        State(
            Power(circle, 3), se3, {"bias": Euclidean((3,)), "imus": (Power(quaternion, 2), so3), "gain": Euclidean()}
        )
    )


def state():
    q = quaternion.exp(jnp.array([0.1, 0.2, -0.3]))
    imus = (jnp.stack([q, quaternion.identity()]), so3.exp(jnp.array([0.0, 0.4, 0.0])))
    return State(
        jnp.array([3.0, -3.0, 0.1]),
        Pose(q, jnp.array([1.0, 2.0, 3.0])),
        {"bias": jnp.array([0.1, 0.0, -0.1]), "gain": jnp.array(2.0), "imus": imus},
    )


def test_local_undoes_retract_and_keeps_the_structure():
    space, x = manifold(), state()
    assert space.dim == 3 + 6 + 3 + 1 + 6 + 3
    v = 0.5 * jax.random.normal(jax.random.key(0), (space.dim,))
    y = jax.jit(space.retract)(x, v)
    assert jax.tree.structure(y) == jax.tree.structure(x)
    assert jax.tree.map(jnp.shape, y) == jax.tree.map(jnp.shape, x)
    assert np.asarray(jax.jit(space.local)(x, y)) == pytest.approx(np.asarray(v), abs=1e-6)
    half = jax.jit(space.interpolate)(x, y, 0.5)
    assert np.asarray(jax.jit(space.local)(x, half)) == pytest.approx(np.asarray(v) / 2, abs=1e-6)


def test_split_and_join_name_the_rows_of_a_covariance():
    space = manifold()
    v = jnp.arange(space.dim, dtype=jnp.float32)
    pieces = space.split(v)
    assert np.asarray(pieces.joints).tolist() == [0, 1, 2]
    assert np.asarray(pieces.base).tolist() == [3, 4, 5, 6, 7, 8]
    assert np.asarray(pieces.parts["gain"]).tolist() == [12]
    assert np.asarray(space.join(pieces)).tolist() == list(range(space.dim))


def test_mean_is_the_mean_of_every_part():
    space = product.of({"joints": Power(circle, 3), "base": quaternion, "bias": Euclidean((3,))})
    x = {"joints": state().joints, "base": state().base.rotation, "bias": state().parts["bias"]}
    v = 0.3 * jax.random.normal(jax.random.key(1), (5, space.dim))
    weights = jnp.array([1.0, 2.0, 3.0, 4.0, 0.0])

    @jax.jit
    def residual(x, v, weights):
        xs = jax.vmap(space.retract, (None, 0))(x, v)
        m = space.mean(xs, weights)
        return m, weights @ jax.vmap(space.local, (None, 0))(m, xs) / jnp.sum(weights)

    m, rest = residual(x, v, weights)
    assert np.abs(rest).max() <= 1e-6
    assert jax.tree.map(jnp.shape, m) == jax.tree.map(jnp.shape, x)


def test_a_product_is_static_and_equal_to_its_twin():
    assert manifold() == manifold()
    assert hash(manifold()) == hash(manifold())
    assert not jax.tree.leaves(manifold())
    nested = product.of((manifold(), circle))
    assert nested.dim == manifold().dim + 1
    any_manifold: list[Manifold] = [circle, quaternion, so3, se3, Euclidean((2, 3)), Power(se3, 2), nested]
    assert [m.dim for m in any_manifold] == [1, 3, 3, 6, 6, 12, nested.dim]


def test_euclidean_of_any_shape():
    space = Euclidean((2, 3))
    x = jnp.arange(6.0).reshape(2, 3)
    y = space.retract(x, jnp.ones(6))
    assert y.shape == (2, 3)
    assert np.asarray(space.local(x, y)).tolist() == [1] * 6
    mean = space.mean(jnp.stack([x, y, y]), jnp.array([2.0, 1.0, 1.0]))
    assert np.asarray(mean) == pytest.approx(np.asarray(x) + 0.5)
    assert np.asarray(space.interpolate(x, y, 0.25)) == pytest.approx(np.asarray(x) + 0.25)


def test_errors_say_what_was_expected():
    space, x = manifold(), state()
    with pytest.raises(ValueError, match=r"v: has shape \(3,\), expected \(22,\)"):
        space.retract(x, jnp.zeros(3))
    with pytest.raises(ValueError, match="x: expected the tree"):
        space.retract((x, x), jnp.zeros(22))
    with pytest.raises(ValueError, match="has the leaf 3, expected a manifold"):
        product.of({"a": 3})
