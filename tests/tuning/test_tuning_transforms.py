"""Constraints: every chart goes there and back, stays in its domain, and has the derivative that differences show."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK
from scipy.spatial.transform import Rotation

from jaxest.tuning import transforms as tr

RNG = np.random.default_rng(3)
QUATERNION = np.roll(Rotation.from_rotvec([0.3, -1.2, 0.7]).as_quat(), 1)
MATRIX = Rotation.from_rotvec([2.0, 0.4, -0.6]).as_matrix()
ROOT = RNG.normal(size=(3, 3))
COVARIANCE = ROOT @ ROOT.T + 0.1 * np.eye(3)


def rotation_matrix(x):
    return np.abs(x @ x.T - np.eye(3)).max() < 1e-5 and np.linalg.det(x) > 0


CASES = {
    "real": (tr.real, RNG.normal(size=(2, 3)), lambda x: True),
    "positive": (tr.positive, np.array([1e-6, 3.0, 4e5]), lambda x: (x > 0).all()),
    "number": (tr.positive, 5.0, lambda x: x > 0),
    "nonpositive": (tr.nonpositive, np.array([0.0, -800.0, -3.0, 0.0]), lambda x: (x <= 0).all() and x[0] == x[3] == 0),
    "interval": (tr.interval(-2.0, 5.0), np.array([-1.999, 0.0, 4.99]), lambda x: ((x >= -2) & (x <= 5)).all()),
    "share": (tr.named("share"), 0.9995, lambda x: 0 <= x <= 1),
    "simplex": (tr.simplex, np.array([0.2, 0.5, 0.05, 0.25]), lambda x: (x >= 0).all() and abs(x.sum() - 1) < 1e-5),
    "bingham": (
        tr.bingham,
        np.array([0.0, -800.0, -20.0, -0.5]),
        lambda x: x.max() == 0 and (np.argsort(x) == [1, 2, 3, 0]).all(),
    ),
    "axisymmetric": (tr.bingham, np.array([0.0, -800.0, -800.0, 0.0]), lambda x: x[1] == x[2] < 0 and x[3] == 0),
    "unimodal": (tr.bingham, np.array([0.0, -9.0, -9.0, -9.0]), lambda x: x[1] == x[2] == x[3] < 0),
    "unit_vector": (tr.unit_vector, np.array([-0.6, 0.0, 0.8]), lambda x: abs(np.linalg.norm(x) - 1) < 1e-5),
    "axis": (tr.unit_vector, np.array([0.0, 0.0, 1.0]), lambda x: abs(np.linalg.norm(x) - 1) < 1e-5),
    "quaternion": (tr.rotation, QUATERNION, lambda x: abs(np.linalg.norm(x) - 1) < 1e-5),
    "matrix": (tr.rotation, MATRIX, rotation_matrix),
    "covariance": (tr.covariance, COVARIANCE, lambda x: (np.linalg.eigvalsh(x) > -1e-5).all() and (x == x.T).all()),
    "equal": (tr.equal(tr.positive), np.full(3, 0.01), lambda x: (x == x[0]).all() and x[0] > 0),
}


def points(size, dtype, count=20):
    return jnp.asarray(np.random.default_rng(size).normal(size=(count, size)), dtype)


@pytest.mark.parametrize("name", CASES)
def test_value_is_its_own_start(name, dtype):
    constraint, value, inside = CASES[name]
    chart = constraint(value)
    back = chart.constrain(chart.unconstrain(jnp.asarray(value, dtype)))
    assert back.dtype == dtype
    assert back.shape == np.shape(value)
    scale = 30 * np.finfo(dtype).eps
    np.testing.assert_allclose(back, value, rtol=scale, atol=scale * min(1.0, np.abs(value).max()))
    assert inside(np.asarray(value))


@pytest.mark.parametrize("name", CASES)
def test_every_point_is_inside_and_comes_back(name, dtype):
    constraint, value, inside = CASES[name]
    chart = constraint(value)
    start = chart.unconstrain(jnp.asarray(value, dtype))
    # Rotations and directions come back within half a turn of their anchor, everything else from anywhere.
    z = (
        points(chart.size, dtype) * (0.6 if name in ("quaternion", "matrix", "unit_vector", "axis") else 2.0)
        + start[None]
    )
    x = jax.jit(jax.vmap(chart.constrain), compiler_options=QUICK)(z)
    assert x.dtype == dtype
    assert all(inside(np.asarray(one)) for one in x)
    again = jax.jit(jax.vmap(chart.unconstrain), compiler_options=QUICK)(x)
    eps = np.finfo(dtype).eps
    twice = jax.jit(jax.vmap(chart.constrain), compiler_options=QUICK)(again)
    scale = np.abs(np.asarray(x)).reshape(len(x), -1).max(axis=1).reshape(-1, *[1] * (x.ndim - 1))
    bound = 100 * eps * np.maximum(scale, 5.0 if name == "interval" else 0.0)
    assert (np.abs(np.asarray(twice) - np.asarray(x)) <= bound).all()
    if name not in ("share", "interval", "bingham", "covariance"):  # those round small gaps of large numbers
        np.testing.assert_allclose(again, z, atol=30 * eps * np.abs(z).max())


@pytest.mark.parametrize("name", CASES)
def test_derivative_is_the_difference(name, x64):
    constraint, value, _ = CASES[name]
    chart = constraint(value)
    start = chart.unconstrain(jnp.asarray(value, jnp.float64))
    slopes = jax.jit(lambda z: (jax.jacfwd(chart.constrain)(z), jax.jacrev(chart.constrain)(z)), compiler_options=QUICK)
    many = jax.jit(jax.vmap(chart.constrain), compiler_options=QUICK)
    size = max(1.0, np.abs(value).max())
    for z in (start, start + 0.3):
        slope, back = slopes(z)
        step = 1e-6 * np.eye(chart.size)
        numeric = np.moveaxis(np.asarray(many(z[None] + step) - many(z[None] - step)) / 2e-6, 0, -1)
        np.testing.assert_allclose(slope, numeric, atol=1e-7 * size)
        np.testing.assert_allclose(slope, back, atol=1e-12 * size)
        assert np.linalg.matrix_rank(np.asarray(slope).reshape(-1, chart.size)) == chart.size


def test_rotation_is_scipys():
    chart = tr.rotation(QUATERNION)
    z = np.array([0.4, -0.3, 1.1])
    mine = np.roll(np.asarray(chart.constrain(jnp.asarray(z))), -1)
    theirs = Rotation.from_quat(np.roll(QUATERNION, -1)) * Rotation.from_rotvec(z)
    assert (Rotation.from_quat(mine) * theirs.inv()).magnitude() < 1e-6


@pytest.mark.parametrize(
    ("constraint", "value", "word"),
    [
        (tr.positive, [1.0, 0.0], "above 0"),
        (tr.positive, np.nan, "finite"),
        (tr.nonpositive, [0.0, 0.0], "not all 0"),
        (tr.nonpositive, [1.0, -1.0], "0 and below"),
        (tr.interval(0, 1), 1.0, "strictly between"),
        (tr.simplex, [0.5, 0.6], "sum to 1"),
        (tr.bingham, [1.0, -2.0], "largest is 0"),
        (tr.bingham, [0.0, 0.0], "not all 0"),
        (tr.unit_vector, [1.0, 1.0], "length 1"),
        (tr.rotation, [1.0, 1.0, 0.0, 0.0], "unit quaternion"),
        (tr.rotation, np.diag([1.0, 1.0, -1.0]), "rotation matrix"),
        (tr.rotation, [1.0, 0.0], "shape"),
        (tr.covariance, [[1.0, 2.0], [2.0, 1.0]], "positive definite"),
        (tr.covariance, [[1.0, 0.5], [0.1, 1.0]], "symmetric"),
        (tr.equal(tr.positive), [1.0, 2.0], "equal entries"),
    ],
)
def test_outside_is_refused(constraint, value, word):
    with pytest.raises(ValueError, match=word):
        constraint(value)


def test_names():
    with pytest.raises(ValueError, match="did you mean 'positive'"):
        tr.named("positiv")
    with pytest.raises(ValueError, match="in order"):
        tr.interval(1.0, 1.0)
    assert tr.named("equal-positive")(np.full(3, 2.0)).size == 1


@pytest.mark.parametrize(
    ("path", "value", "name"),
    [
        ("sensors.a.lam", [0.0, -1.0], "bingham"),
        ("sensors.a.mounting", QUATERNION, "rotation"),
        ("forgetting_rotation", 0.99, "share"),
        ("walk", 5.0, "positive"),
        ("noise", COVARIANCE, "covariance"),
        ("noise", [[2.0, 1.0], [1.0, 2.0]], "covariance"),
        ("noise", [[2.0]], "positive"),
        ("gain", [[1.0, 0.0], [0.5, 1.0]], "real"),
        ("gain", [[1.0, 2.0], [2.0, 1.0]], "positive"),
        ("gain", [[1.0, 0.5, 2.0]], "positive"),
        ("sensors.e.offset", 1.0, "real"),
        ("x", -1.0, "real"),
    ],
)
def test_the_usual_constraint_of_a_name_and_a_value(path, value, name):
    assert tr.usual(path, value) == name
    tr.named(name)(value)
