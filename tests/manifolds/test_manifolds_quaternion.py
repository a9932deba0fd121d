"""Conversions and corner cases of the quaternion and the angle, and outside references for rotations and motions."""

import jax
import jax.numpy as jnp
import jaxlie
import manifold_cases
import numpy as np
import pytest
from manifold_cases import apart
from reference import ref_manifolds as reference
from scipy.spatial.transform import Rotation

from jaxest.manifolds import circle, quaternion, se3, so3


def test_hamilton_wxyz_destination_first():
    quarter = quaternion.from_axis_angle(jnp.array([0.0, 0, 1]), jnp.pi / 2)
    assert apart(quarter, np.sqrt([0.5, 0, 0, 0.5])) <= 1e-6
    assert apart(quaternion.rotate(quarter, jnp.array([1.0, 0, 0])), np.array([0, 1, 0])) <= 1e-6
    i, j = jnp.eye(4)[1], jnp.eye(4)[2]
    assert np.asarray(quaternion.compose(i, j)).tolist() == [0, 0, 0, 1]
    first = quaternion.from_axis_angle(jnp.array([1.0, 0, 0]), 0.7)
    both = quaternion.rotate(quaternion.compose(quarter, first), jnp.array([0.1, 0.2, 0.3]))
    one_by_one = quaternion.rotate(quarter, quaternion.rotate(first, jnp.array([0.1, 0.2, 0.3])))
    assert apart(both, one_by_one) <= 1e-6


def test_against_scipy(x64):
    v = manifold_cases.rotation_vectors()
    p = np.random.default_rng(0).normal(size=v.shape)
    scipy = Rotation.from_rotvec(v)

    def ours(v, p, matrix):
        q = quaternion.exp(v)
        return quaternion.to_matrix(q), quaternion.rotate(q, p), quaternion.log(q), so3.log(matrix)

    matrix, rotated, back, back_matrix = jax.jit(jax.vmap(ours))(v, p, scipy.as_matrix())
    assert apart(matrix, scipy.as_matrix()) <= 1e-15
    assert apart(rotated, scipy.apply(p)) <= 4e-15
    below = np.linalg.norm(v, axis=1) < 3.1415
    assert apart(np.asarray(back)[below], scipy.as_rotvec()[below]) <= 4e-15
    assert apart(np.asarray(back_matrix)[below], scipy.as_rotvec()[below]) <= 4e-15


def test_against_jaxlie_which_puts_translation_first(x64):
    v = manifold_cases.twists()
    v = v[(np.linalg.norm(v[:, :3], axis=1) > 0.05) & (np.linalg.norm(v[:, :3], axis=1) < 3.1)]
    swap = np.r_[3:6, 0:3]

    def ours(v):
        x = se3.exp(v)
        return jnp.concatenate(x), se3.log(x), se3.adjoint(x)

    def theirs(v):
        x = jaxlie.SE3.exp(v)
        return x.wxyz_xyz, x.log(), x.adjoint()

    numbers, back, adjoint = (np.asarray(x) for x in jax.jit(jax.vmap(ours))(v))
    their_numbers, their_back, their_adjoint = (np.asarray(x) for x in jax.jit(jax.vmap(theirs))(v[:, swap]))
    # jaxlie's closed forms cancel: (t - sin t) / t^3 at 0.05 rad keeps 12 digits.
    assert apart(numbers, their_numbers) <= 1e-11
    assert apart(back, their_back[:, swap]) <= 1e-11
    assert apart(adjoint, their_adjoint[:, swap][:, :, swap]) <= 1e-11


def test_from_matrix_is_right_at_every_angle_with_its_derivatives(dtype):
    v = manifold_cases.rotation_vectors()
    eps = float(np.finfo(dtype).eps)
    exact = np.array([reference.quaternion_exp(w) for w in v])
    exact *= np.where(exact[:, :1] < 0, -1, 1)
    matrices = reference.quaternion_matrix(exact).astype(dtype)
    turns = np.array([[(m @ reference.hat(e)) for e in np.eye(3)] for m in matrices.astype(np.float64)]).astype(dtype)

    def program(m, turns):
        along = [jax.jvp(quaternion.from_matrix, (m,), (t,))[1] for t in turns]
        return quaternion.from_matrix(m), jnp.stack(along, axis=1), jax.jacrev(quaternion.from_matrix)(m)

    q, forward, reverse = (np.asarray(x, np.float64) for x in jax.jit(jax.vmap(program))(matrices, turns))
    sign = np.sign(np.sum(q * exact, axis=1, keepdims=True))  # at half a turn both are right
    assert (sign[exact[:, 0] > 1e-5] == 1).all()
    assert apart(sign * q, exact) <= 4 * eps
    expected = np.stack([reference.hamilton(q, np.array([0, *e]) / 2) for e in np.eye(3)], axis=-1)
    assert apart(forward, expected) <= 8 * eps
    assert apart(np.einsum("nqij,nkij->nqk", reverse, turns), expected) <= 8 * eps
    # A tiny rotation keeps its digits: the vector part is right to eps of the angle.
    tiny = np.linalg.norm(v, axis=1) < 1e-3
    error = np.abs(q - exact)[tiny, 1:].max(axis=1)
    assert (error <= 2 * eps * np.linalg.norm(v[tiny], axis=1)).all()


def test_exactly_half_a_turn_and_degenerate_quaternions(dtype):
    half_turns = np.concatenate([np.zeros((len(manifold_cases.AXES), 1)), manifold_cases.AXES], axis=1)
    q = np.concatenate([half_turns, -half_turns, [[1, 0, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 0]]]).astype(dtype)

    def program(q):
        out = quaternion.log(q), quaternion.normalize(q), quaternion.to_matrix(q)
        log = quaternion.log
        second = jax.jvp(jax.jacfwd(log), (q,), (jnp.ones_like(q),))[1]
        normal = jax.jacrev(quaternion.normalize)(q)
        return out, (jax.jacfwd(log)(q), jax.jacrev(log)(q), second, normal)

    (log, unit, matrix), derivatives = jax.jit(jax.vmap(program))(q)
    assert all(np.isfinite(x).all() for x in derivatives)
    n, eps = len(half_turns), float(np.finfo(dtype).eps)
    axes = np.concatenate([manifold_cases.AXES, -manifold_cases.AXES])
    assert apart(log[: 2 * n], np.pi * axes) <= 8 * eps
    assert not np.asarray(log[2 * n :]).any()
    assert np.asarray(unit[-1]).tolist() == [1, 0, 0, 0]
    assert np.asarray(matrix[-1]).tolist() == np.eye(3).tolist()


def test_log_forgets_length_and_sign(dtype):
    v = manifold_cases.rotation_vectors()[:-15].astype(dtype)
    log = jax.jit(jax.vmap(lambda v, scale: quaternion.log(scale * quaternion.exp(v)), (0, None)))
    eps = float(np.finfo(dtype).eps)
    below = np.linalg.norm(v, axis=1) < 3.14
    for scale in (-1.0, 0.125, 7.0):
        got = np.asarray(log(v, np.asarray(scale, dtype)))
        assert apart(got[below], v[below].astype(np.float64)) <= 8 * eps


def test_what_is_no_number_stays_so(dtype):
    """A rotation that was lost must not come back as no rotation."""
    one, lost = quaternion.identity(dtype), jnp.full(3, jnp.nan, dtype)
    assert np.all(np.isnan(quaternion.normalize(jnp.full(4, jnp.nan, dtype))))
    assert np.all(np.isnan(quaternion.retract(one, lost)))
    assert np.all(np.isnan(quaternion.from_matrix(jnp.full((3, 3), jnp.nan, dtype))))
    assert np.all(np.isnan(quaternion.mean(jnp.stack([one, jnp.full(4, jnp.nan, dtype)]))))
    assert np.all(np.isnan(se3.retract(se3.identity(dtype), jnp.full(6, jnp.nan, dtype)).rotation))
    np.testing.assert_array_equal(quaternion.normalize(jnp.zeros(4, dtype)), one)


def test_retract_keeps_unit_length():
    step = jnp.array([0.3, -0.2, 0.1])
    q = jax.lax.fori_loop(0, 20_000, lambda _, q: quaternion.retract(q, step), quaternion.identity())
    assert float(jnp.sum(q * q)) == pytest.approx(1, abs=4e-7)


def test_from_two_vectors(dtype):
    rng = np.random.default_rng(4)
    a = rng.normal(size=(300, 3))
    b = a + rng.normal(size=a.shape) * 10.0 ** rng.uniform(-9, 1, size=(300, 1))
    b[:40] = a[:40]
    b[40:80] = -a[40:80]
    a, b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a, b))
    a, b = a.astype(dtype), b.astype(dtype)

    def program(a, b):
        q = quaternion.from_two_vectors(a, b)
        return q, quaternion.rotate(q, a), jax.jacrev(quaternion.from_two_vectors)(a, b)

    q, rotated, slope = (np.asarray(x) for x in jax.jit(jax.vmap(program))(a, b))
    eps = float(np.finfo(dtype).eps)
    assert np.isfinite(slope).all()
    assert apart(np.linalg.norm(q, axis=1), 1) <= 2 * eps
    assert apart(rotated, b) <= 8 * eps
    # The shortest: no turn about the vector itself.
    assert apart(np.sum(q[:, 1:] * a, axis=1), 0) <= 4 * eps


def test_poses_as_matrices_and_points():
    v = jnp.array([0.3, -1.2, 0.8, 0.5, -0.1, 2.0])
    pose, p = se3.exp(v), jnp.array([1.0, 2, 3])
    matrix = se3.to_matrix(pose)
    assert apart(matrix, reference.expm(np.asarray(v)).astype(np.float64)) <= 1e-6
    assert apart(se3.apply(pose, p), np.asarray(matrix @ jnp.append(p, 1.0))[:3]) <= 2e-6
    again = se3.from_matrix(matrix)
    assert apart(jnp.concatenate(again), np.asarray(jnp.concatenate(pose))) <= 1e-6


def test_wrap(dtype):
    eps, pi = float(np.finfo(dtype).eps), np.asarray(np.pi, dtype)
    rng = np.random.default_rng(5)
    multiples = np.arange(-9, 10) * np.pi
    near = [np.nextafter(m, s * np.inf, dtype=dtype) for m in multiples.astype(dtype) for s in (-1, 1)]
    inside = np.concatenate([manifold_cases.ANGLES, -manifold_cases.ANGLES])
    angles = np.concatenate([multiples, near, inside, rng.uniform(-1000, 1000, 300)]).astype(dtype)
    got, slope = (np.asarray(x) for x in jax.jit(jax.vmap(jax.value_and_grad(circle.wrap)))(angles))
    assert (got >= -pi).all()
    assert (got < pi).all()
    assert (slope == 1).all()
    exact = np.array([reference.wrap(float(x)) for x in angles])
    apart = np.abs(got - exact)
    # The angle's own spacing, once for each of two products.
    assert (np.minimum(apart, 2 * np.pi - apart) <= 2 * eps * np.maximum(np.abs(angles), np.pi)).all()
    already = (np.abs(angles) < pi) & ((angles == 0) | (np.abs(angles) >= np.finfo(dtype).tiny))  # XLA has no denormals
    assert (got[already] == angles[already]).all()
    assert circle.wrap(jnp.zeros((2, 3), dtype)).shape == (2, 3)
    assert float(circle.wrap(-pi)) == -pi == float(circle.wrap(pi)) or float(circle.wrap(pi)) > -pi
