"""One matrix of tests over all groups and both precisions, from no rotation to half a turn about axes of every kind.

Bounds are multiples of eps, elementwise, against references in extended precision; numbers here are of order one, so
they count roundings. The round trip's error is relative to the angle: a rotation by 1e-9 keeps all its digits. Every
function is compiled once a precision, over one batch size, and shared by the tests.
"""

import functools

import jax
import jax.numpy as jnp
import manifold_cases
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from manifold_cases import apart
from reference import ref_manifolds as reference

from jaxest.manifolds import Group, circle, quaternion, se3, so3

GROUPS: dict[str, Group] = {"circle": circle, "quaternion": quaternion, "so3": so3, "se3": se3}
BELOW_HALF_TURN = np.pi - 1e-5  # above, rounding may turn log's vector round to its opposite


@functools.cache
def compiled(function):
    return jax.jit(jax.vmap(function), compiler_options=manifold_cases.LIGHT)


def batched(name, function):
    """A group's function over a batch, compiled once for a shape and a dtype."""
    return compiled(getattr(GROUPS[name], function))


def with_derivatives(f, p, direction):
    """f(p), its Jacobian forward and backward, and, where it saves digits most, its second along a direction."""
    first = f(p), jax.jacfwd(f)(p), jax.jacrev(f)(p)
    if p.dtype == jnp.float64:  # float64 is what the second derivative of float32 is compared with
        return first
    return *first, jax.jvp(lambda at: jax.jvp(f, (at,), (direction,))[1], (p,), (direction,))[1]


@functools.cache
def exp_program(name):
    return jax.jit(jax.vmap(lambda v, a: with_derivatives(lambda w: ravel_pytree(GROUPS[name].exp(w))[0], v, a)))


@functools.cache
def log_program(name):
    unravel = ravel_pytree(GROUPS[name].identity())[1]
    return jax.jit(jax.vmap(lambda x, b: with_derivatives(lambda y: GROUPS[name].log(unravel(y)), x, b)))


def element(name, flat):
    """Elements from their numbers (n, m)."""
    if name == "se3":
        return se3.Pose(flat[:, :4], flat[:, 4:])
    shape = {"circle": (), "quaternion": (4,), "so3": (3, 3)}[name]
    return flat.reshape(-1, *shape)


def flatten(x):
    """Numbers (n, m) of elements, float64."""
    leaves = [np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(x)]
    return np.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1)


def steps(name, x):
    """Derivative (n, m, dim) of the numbers x (n, m) of elements in a perturbation on their right."""
    if name == "circle":
        return np.ones((len(x), 1, 1))
    if name == "so3":
        return np.stack([(x.reshape(-1, 3, 3) @ reference.hat(e)).reshape(-1, 9) for e in np.eye(3)], axis=-1)
    turn = np.stack([reference.hamilton(x[:, :4], np.array([0, *e]) / 2) for e in np.eye(3)], axis=-1)
    if name == "quaternion":
        return turn
    out = np.zeros((len(x), 7, 6))
    out[:, :4, :3], out[:, 4:, 3:] = turn, reference.quaternion_matrix(x[:, :4])
    return out


def exact_exp(name, v):
    """Numbers of exp(v), from references alone."""
    if name == "circle":
        return np.array([reference.wrap(v[0])])
    if name == "so3":
        return reference.expm(v).ravel().astype(np.float64)
    turn = reference.quaternion_exp(v[:3])
    return turn if name == "quaternion" else np.concatenate([turn, reference.expm(v)[:3, 3]]).astype(np.float64)


def exact_jacobians(v):
    """Left Jacobians (n, dim, dim) at the tangent vectors v (n, dim)."""
    if v.shape[1] == 1:
        return np.ones((len(v), 1, 1))
    return np.array([reference.left_jacobian(w) for w in v]).astype(np.float64)


def tangents(name):
    return {"circle": manifold_cases.angles, "se3": manifold_cases.twists}.get(name, manifold_cases.rotation_vectors)()


@functools.cache
def directions(name):
    """Directions for the second derivatives of exp (in the tangent) and of log (in the element's numbers)."""
    rng = np.random.default_rng(2)
    v = tangents(name)
    return rng.normal(size=v.shape), rng.normal(size=(len(v), ravel_pytree(GROUPS[name].identity())[0].size))


@functools.cache
def results(name, dtype):
    """Tangent vectors, exp and log there with derivatives, float64 numbers from a computation in dtype."""
    v = tangents(name).astype(dtype)
    a, b = (direction.astype(dtype) for direction in directions(name))
    of_exp = exp_program(name)(v, a)
    of_log = log_program(name)(of_exp[0], b)
    assert all(x.dtype == dtype for x in of_exp + of_log)
    return (v.astype(np.float64), *([np.asarray(x, np.float64) for x in group] for group in (of_exp, of_log)))


@pytest.fixture(params=GROUPS)
def name(request):
    return request.param


@pytest.fixture
def case(name, dtype):
    """(tangents, exp's results, log's results, angles, eps) of one group in one precision."""
    v, of_exp, of_log = results(name, dtype)
    return v, of_exp, of_log, np.linalg.norm(v[:, :3], axis=1), float(np.finfo(dtype).eps)


def test_nothing_is_nan(case):
    _, of_exp, of_log, _, _ = case
    assert all(np.isfinite(x).all() for x in of_exp + of_log)


def test_exp(name, case):
    v, of_exp, _, _, eps = case
    exact = np.array([exact_exp(name, w) for w in v])
    error = np.abs(of_exp[0] - exact)
    if name == "circle":
        error = np.minimum(error, 2 * np.pi - error)  # pi and -pi
    # A matrix entry is a sum of three products of rounded quaternion parts, a translation of three cross products.
    assert error.max() <= 5 * eps


def test_log_undoes_exp(case):
    v, _, of_log, angle, eps = case
    below = angle < BELOW_HALF_TURN
    error = np.abs(of_log[0] - v)[below]
    # Relative in the rotation: roundings of exp's factor, of the norm and of log's factor.
    assert (error[:, :3].max(axis=1) <= 4 * eps * angle[below]).all()
    # A translation of about 3 m goes through two cross products each way.
    assert error.max() <= 8 * eps


def test_log_undoes_exp_at_half_a_turn_but_for_the_sign(case):
    v, _, of_log, angle, eps = case
    at = np.isclose(angle, np.pi, rtol=0, atol=4 * eps)
    assert at.any()
    phi, back = v[at][:, :3], of_log[0][at][:, :3]
    assert apart(back, np.sign(np.sum(phi * back, axis=1, keepdims=True)) * phi) <= 8 * eps


def test_jacobians(name, case):
    v, _, _, _, eps = case
    given = v.astype(np.float32 if eps > 1e-10 else np.float64)
    exact = exact_jacobians(v), exact_jacobians(-v)
    assert apart(batched(name, "left_jacobian")(given), exact[0]) <= 4 * eps
    assert apart(batched(name, "right_jacobian")(given), exact[1]) <= 4 * eps
    # The inverse is up to pi/2 times as large, its corner in SE(3) several times.
    assert apart(batched(name, "left_jacobian_inverse")(given), np.linalg.inv(exact[0])) <= 8 * eps
    assert apart(batched(name, "right_jacobian_inverse")(given), np.linalg.inv(exact[1])) <= 8 * eps


def test_derivative_of_exp_is_the_right_jacobian(name, case):
    v, (_, forward, reverse, *_), _, _, eps = case
    exact = steps(name, np.array([exact_exp(name, w) for w in v])) @ exact_jacobians(-v)
    assert apart(forward, exact) <= 8 * eps
    assert apart(reverse, exact) <= 8 * eps


def test_derivative_of_log_is_the_inverse_right_jacobian(name, case):
    _, (x, *_), (back, forward, reverse, *_), _, eps = case
    exact = np.linalg.inv(exact_jacobians(-back))
    basis = steps(name, x)
    assert apart(forward @ basis, exact) <= 16 * eps
    assert apart(reverse @ basis, exact) <= 16 * eps


def test_second_derivatives_in_float32(name):
    """Against difference quotients of the first derivatives (which two tests above check) in float64."""
    v, (x, *_, exp_second), (_, *_, log_second) = results(name, np.dtype(np.float32))
    a, b = (direction.astype(np.float32).astype(np.float64) for direction in directions(name))
    angle, eps, h = np.linalg.norm(v[:, :3], axis=1), float(np.finfo(np.float32).eps), 1e-5
    below = angle < 3.14  # the quotient must not straddle log's jump
    with jax.enable_x64(True):
        for program, at, along, second in ((exp_program, v, a, exp_second), (log_program, x, b, log_second)):
            high, low = (np.asarray(program(name)(at + k * h * along, along)[1]) for k in (1, -1))
            quotient = np.einsum("nij,nj->ni", high - low, along) / (2 * h)
            # The terms grow with the square of the direction; the quotient's own error is far smaller.
            size = 1 + np.linalg.norm(along, axis=1, keepdims=True) ** 2
            assert np.isfinite(second).all()
            assert (np.abs(second - quotient) <= 16 * eps * size)[below].all()


def to_matrices(name, x):
    numbers = flatten(x)
    if name == "circle":
        return np.array([[[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]] for t in numbers[:, 0]])
    if name == "so3":
        return numbers.reshape(-1, 3, 3)
    out = np.tile(np.eye(4), (len(numbers), 1, 1))
    out[:, :3, :3] = reference.quaternion_matrix(numbers[:, :4])
    out[:, :3, 3] = numbers[:, 4:] if name == "se3" else 0
    return out


def test_group_axioms(name, dtype):
    v = tangents(name)
    u, v, w = np.random.default_rng(3).normal(size=(3, *v.shape)).astype(dtype)
    f = functools.partial(batched, name)
    x, y, z = (element(name, exp_program(name)(t, t)[0]) for t in (u, v, w))
    xy, xi = f("compose")(x, y), f("inverse")(x)
    adjoint = np.asarray(f("adjoint")(x), np.float64)
    moved = np.einsum("nij,nj->ni", adjoint, v).astype(dtype)
    m = functools.partial(to_matrices, name)
    one = np.broadcast_to(np.eye(m(x).shape[1]), m(x).shape)
    identity = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (len(v), *leaf.shape)), GROUPS[name].identity(dtype))
    xv = f("retract")(x, v)
    pairs = {
        "associative": (m(f("compose")(xy, z)), m(f("compose")(x, f("compose")(y, z)))),
        "composes as matrices do": (m(xy), m(x) @ m(y)),
        "identity": (m(identity), one),
        "identity, left": (m(f("compose")(identity, x)), m(x)),
        "identity, right": (m(f("compose")(x, identity)), m(x)),
        "inverse": (m(f("compose")(x, xi)), one),
        "inverse is exp(-v)": (m(xi), m(element(name, exp_program(name)(-u, u)[0]))),
        "adjoint": (m(xy), m(f("compose")(element(name, exp_program(name)(moved, moved)[0]), x))),
        "retract is on the right": (m(xv), m(xy)),
        "local undoes retract": (m(element(name, exp_program(name)(f("local")(x, xv), v)[0])), m(y)),
    }
    for what, (got, expected) in pairs.items():
        # Translations of up to 5 m, turned and added a few times.
        assert apart(got, expected) <= 100 * float(np.finfo(dtype).eps), what
    step, whole = f("local")(x, f("interpolate")(x, y, np.full(len(v), 0.3, dtype))), f("local")(x, y)
    assert apart(step, 0.3 * np.asarray(whole)) <= 100 * float(np.finfo(dtype).eps)


def test_one_item_without_jit_is_a_row_of_the_batch(name):
    v = tangents(name).astype(np.float32)
    x = exp_program(name)(v, v)[0]
    last = jax.tree.map(lambda leaf: leaf[-1], element(name, x))
    # Compiled and eager code may fuse multiplications with additions differently.
    assert apart(ravel_pytree(GROUPS[name].exp(v[-1]))[0], np.asarray(x[-1])) <= 1e-6
    assert apart(GROUPS[name].log(last), np.asarray(log_program(name)(x, x)[0][-1])) <= 1e-6


def test_float32_stays_float32_with_x64(name, x64):
    group = GROUPS[name]

    def everything(v):
        x = group.exp(v)
        y = group.compose(group.inverse(x), group.retract(x, v))
        xs = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), x)
        jacobians = group.left_jacobian(v), group.left_jacobian_inverse(v)
        more = group.right_jacobian(v), group.right_jacobian_inverse(v), group.adjoint(x), group.identity(v.dtype)
        means = group.mean(xs), group.mean(xs, np.ones(2))
        return group.log(y), group.local(x, y), means, group.interpolate(x, y, 0.5), jacobians, more

    leaves = jax.tree.leaves(jax.eval_shape(everything, jax.ShapeDtypeStruct((group.dim,), jnp.float32)))
    assert {leaf.dtype for leaf in leaves} == {np.dtype(np.float32)}


def test_wrong_shapes_are_named(name):
    group = GROUPS[name]
    with pytest.raises(ValueError, match=r"v: has shape \(8, 8\), expected \("):
        group.exp(jnp.zeros((8, 8)))
    with pytest.raises(ValueError, match="expected"):
        group.log(jax.tree.map(lambda leaf: leaf[None], group.identity()))
    with pytest.raises(ValueError, match=r"weights: has shape \(3,\), expected \(2,\)"):
        group.mean(jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), group.identity()), jnp.ones(3))
