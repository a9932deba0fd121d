"""Rotations and motions against Gauss-Newton on all equations at once, written in NumPy with SciPy's rotations."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import kalman_models as body
import numpy as np
import pytest
from quick_compile import QUICK
from reference import ref_kalman as reference
from scipy.spatial.transform import Rotation

from jaxest.filters import kalman
from jaxest.manifolds import Euclidean, Pose, product, quaternion, se3
from jaxest.metrics import nees_bounds
from jaxest.types import NOT_CONVERGED, OK, Reading

T = 6


def blocks(jacobian, n=6):
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    return np.array([inverse[i : i + n, i : i + n] for i in range(0, len(inverse), n)])


def body_residuals(look, params, anchors):
    """Whitened equations of the whole path of `kalman_models`, at the path `anchors` perturbed by v."""
    root = np.linalg.inv(np.linalg.cholesky(params.landmark**2 * (np.eye(3) + 0.3)))

    def residuals(v):
        steps = v.reshape(-1, 6)
        turns = [reference.rotation(q) * Rotation.from_rotvec(s[:3]) for (q, _), s in zip(anchors, steps, strict=True)]
        places = [p + s[3:] for (_, p), s in zip(anchors, steps, strict=True)]
        out = [turns[0].as_rotvec() / params.start, places[0] / params.start]
        for k in range(len(look.dt)):
            dt = look.dt[k]
            ahead = turns[k] * Rotation.from_rotvec(look.gyroscope.value[k] * dt)
            out.append((ahead.inv() * turns[k + 1]).as_rotvec() / (params.turn * np.sqrt(dt)))
            out.append((places[k + 1] - places[k]) / (params.move * np.sqrt(dt)))
            for mark, value, there in zip(
                body.LANDMARKS, look.landmarks.value[k], look.landmarks.valid[k], strict=True
            ):
                error = value - turns[k + 1].inv().apply(mark - places[k + 1])
                out.append(root @ error if there else np.zeros(3))
            if look.compass.valid[k]:
                error = turns[k + 1].inv() * reference.rotation(look.compass.value[k])
                out.append(error.as_rotvec() / params.compass)
        return np.concatenate(out)

    return residuals


def test_smoother_is_gauss_newton_on_the_whole_path(x64):
    params = jax.tree.map(jnp.float64, body.Params(start=1.0, landmark=0.2))
    look, truth = jax.jit(partial(body.simulate, params, steps=T), compiler_options=QUICK)(key=jax.random.key(4))
    smooth = jax.jit(partial(kalman.smooth, body.model(), tolerance=1e-10, iterations=30), compiler_options=QUICK)
    history = smooth(params, body.start(params), look)
    assert np.all(np.asarray(history.status) == OK)

    look, truth, params = jax.tree.map(np.asarray, (look, truth, params))
    anchors = [(q, p) for q, p in zip(truth.orientation[[0, *range(T)]], truth.position[[0, *range(T)]], strict=True)]
    v = reference.gauss_newton(body_residuals(look, params, anchors), 6 * (T + 1)).reshape(-1, 6)
    best = [
        (np.roll((reference.rotation(q) * Rotation.from_rotvec(s[:3])).as_quat(), 1), p + s[3:])
        for (q, p), s in zip(anchors, v, strict=True)
    ]
    ours = [(history.start.orientation, history.start.position), *zip(*history.mean, strict=True)]
    for (q, p), (expected_q, expected_p) in zip(ours, best, strict=True):
        assert np.abs((reference.rotation(q).inv() * reference.rotation(expected_q)).as_rotvec()).max() < 1e-7
        np.testing.assert_allclose(p, expected_p, atol=1e-7)
    jacobian = reference.differences(body_residuals(look, params, best), np.zeros(6 * (T + 1)))
    expected = blocks(jacobian)
    found = np.concatenate([history.start_covariance[None], history.covariance])
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


class Turn(NamedTuple):
    twist: Reading
    points: Reading
    dt: object


POINTS = np.array([[1.0, 0, 0.5], [0, 2.0, -0.5]])


@pytest.mark.slow
def test_smoother_on_rigid_motions(x64):
    """SE(3): the body moves by measured twists and sees points; every residual is on the group."""
    model = kalman.Model(
        se3,
        lambda p, x, z: se3.compose(x, se3.exp(z.twist.value * z.dt)),
        lambda p, x, z: 0.01 * jnp.eye(6),
        (
            kalman.sensor(
                "points",
                lambda p, x, z: jax.vmap(partial(se3.apply, se3.inverse(x)))(jnp.asarray(POINTS)),
                lambda p, z: 0.01 * jnp.ones(6),
            ),
        ),
    )
    random = np.random.default_rng(5)
    twists, values = random.normal(size=(4, 6)), POINTS + 0.3 * random.normal(size=(4, 2, 3))
    look = Turn(Reading(twists, np.ones(4, bool)), Reading(values, np.ones((4, 2), bool)), np.full(4, 0.3))
    smooth = jax.jit(partial(kalman.smooth, model, None, tolerance=1e-10, iterations=40), compiler_options=QUICK)
    history = smooth(kalman.init(se3.identity(jnp.float64), 0.2 * jnp.eye(6)), look)
    assert np.all(np.asarray(history.status) == OK)
    poses = [history.start, *(Pose(*pose) for pose in zip(*history.mean, strict=True))]
    poses = [(reference.rotation(q), np.asarray(p)) for q, p in poses]

    def times(a, b):
        return a[0] * b[0], a[1] + a[0].apply(b[1])

    def back(a):
        return a[0].inv(), -a[0].inv().apply(a[1])

    def residuals(v):
        path = [times(x, reference.se3_exp(s)) for x, s in zip(poses, v.reshape(-1, 6), strict=True)]
        out = [reference.se3_log(*path[0]) / np.sqrt(0.2)]
        for k in range(4):
            ahead = times(path[k], reference.se3_exp(twists[k] * 0.3))
            out.append(reference.se3_log(*times(back(ahead), path[k + 1])) / 0.1)
            turn, shift = back(path[k + 1])
            out.append((values[k] - (turn.apply(POINTS) + shift)).reshape(-1) / 0.1)
        return np.concatenate(out)

    jacobian = reference.differences(residuals, np.zeros(30))
    expected = blocks(jacobian)
    move = np.linalg.lstsq(jacobian, -residuals(np.zeros(30)), rcond=None)[0]
    np.testing.assert_allclose(move, 0, atol=1e-7)
    found = np.concatenate([history.start_covariance[None], history.covariance])
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


BELIEF = kalman.Gaussian(
    body.Body(np.array([1.0, 0, 0, 0]), np.zeros(3)),
    np.diag([0.5, 0.4, 0.3, 1.0, 2, 0.0]) + 0.02 * np.diag([1, 1, 1, 1, 0], 1),
)


def landmark_factor(values, **options):
    turn = lambda x: body.seen(None, x, None)  # noqa: E731
    noise = np.tile(0.01 * (np.eye(3) + 0.3), (3, 1, 1))
    return kalman.Factor(lambda x: (values - turn(x)).reshape(-1), noise, **options)


def landmark_values():
    pose = Rotation.from_rotvec([0.6, -0.4, 0.5]), np.array([0.7, -1.0, 0])
    values = pose[0].inv().apply(body.LANDMARKS - pose[1])
    return values + 0.1 * np.random.default_rng(6).normal(size=(3, 3))


@pytest.mark.parametrize(
    "loss", [None, *(pytest.param(loss, marks=pytest.mark.slow) for loss in (kalman.huber, kalman.cauchy))]
)
def test_iterated_update_is_the_most_probable_state(loss, x64):
    """A prior that is singular in one direction; an outlier; the gains in both dimensions."""
    values = landmark_values() + (0 if loss is None else np.array([[0, 0, 0], [0.6, 0, 0], [0, 0, 0]]))
    symmetric = BELIEF._replace(covariance=(BELIEF.covariance + BELIEF.covariance.T) / 2)
    prior = np.linalg.inv(symmetric.covariance[:5, :5])
    whiten = np.linalg.inv(np.linalg.cholesky(0.01 * (np.eye(3) + 0.3)))
    rho = {
        None: lambda s: s / 2,
        kalman.huber: lambda s: np.where(s > 1.345**2, 1.345 * (np.sqrt(s) - 1.345 / 2), s / 2),
        kalman.cauchy: lambda s: 2.385**2 / 2 * np.log1p(s / 2.385**2),
    }[loss]

    def cost(v):
        turn = Rotation.from_rotvec(v[:3]).inv()
        errors = values - turn.apply(body.LANDMARKS - np.array([v[3], v[4], 0]))
        return v @ prior @ v / 2 + np.sum(rho(np.sum((errors @ whiten.T) ** 2, axis=1)))

    results = []
    for gain in (kalman.measurement_gain, kalman.state_gain):
        update = jax.jit(
            lambda belief, gain=gain: kalman.update(
                body.BODY, belief, landmark_factor(values, loss=loss), iterations=200, tolerance=1e-11, gain=gain
            )
        )
        after, info = update(jax.tree.map(jnp.asarray, symmetric))
        results.append((after, info._replace(iterations=0)))
        assert info.status == OK
        v = np.array(body.BODY.local(symmetric.mean, after.mean))
        assert v[5] == 0
        slope = reference.differences(lambda v: cost(v)[None], v[:5])[0]
        np.testing.assert_allclose(slope, 0, atol=1e-6)
        assert cost(v[:5]) < cost(np.zeros(5))
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-8, atol=1e-9), *results)


def test_the_new_covariance_lives_at_the_new_mean(x64):
    belief = jax.tree.map(jnp.asarray, BELIEF._replace(covariance=np.diag([0.5, 0.4, 0.3, 1.0, 2, 0.7])))
    factor = landmark_factor(landmark_values())
    update = partial(kalman.update, body.BODY, factors=factor, iterations=30, tolerance=1e-10)
    after, info = jax.jit(update, compiler_options=QUICK)(belief)

    def residuals(v):
        x = body.BODY.retract(after.mean, v)
        error = body.BODY.local(belief.mean, x) / jnp.sqrt(jnp.diagonal(belief.covariance))
        root = jnp.linalg.inv(jnp.linalg.cholesky(jnp.asarray(factor.noise[0])))
        return jnp.concatenate([error, (factor.residual(x).reshape(3, 3) @ root.T).reshape(-1)])

    jacobian = jax.jit(jax.jacfwd(residuals), compiler_options=QUICK)(jnp.zeros(6))
    np.testing.assert_allclose(after.covariance, jnp.linalg.inv(jacobian.T @ jacobian), rtol=1e-7, atol=1e-12)
    information = jacobian[6:].T @ jacobian[6:]
    np.testing.assert_allclose(info.information, information, rtol=1e-6, atol=1e-6)


def test_gate_mask_and_status(x64):
    belief = jax.tree.map(jnp.asarray, BELIEF._replace(covariance=0.01 * np.eye(6)))
    values = body.LANDMARKS.copy()
    values[1, 0] += 1.0
    some = kalman.Factor(
        lambda x: landmark_factor(values).residual(x)[np.array([0, 1, 2, 6, 7, 8])],
        np.tile(0.01 * (np.eye(3) + 0.3), (2, 1, 1)),
    )

    @partial(jax.jit, compiler_options=QUICK)
    def updates(belief):
        plain = partial(kalman.update, body.BODY, belief)
        return (
            plain(landmark_factor(values, gate=11.34)),
            plain(landmark_factor(values, valid=np.repeat([True, False, True], 3))),
            plain(some),
            plain(landmark_factor(values, valid=np.zeros(9, bool)), iterations=5),
            plain(landmark_factor(values, loss=kalman.cauchy), iterations=2),
        )

    (gated, info), (masked, masked_info), (absent, absent_info), (nothing, none), (_, short) = updates(belief)
    np.testing.assert_array_equal(info.used, np.repeat([True, False, True], 3))
    assert info.dof == 6
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-13, atol=1e-16), gated, masked)
    assert masked_info.log_likelihood == pytest.approx(float(info.log_likelihood), rel=1e-13)
    np.testing.assert_allclose(absent.covariance, masked.covariance, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(absent_info.log_likelihood, masked_info.log_likelihood, rtol=1e-12)
    assert none.log_likelihood == 0
    assert none.nis == 0
    jax.tree.map(partial(np.testing.assert_allclose, atol=1e-15), nothing, belief)
    assert short.status == NOT_CONVERGED


@pytest.mark.slow
def test_given_jacobians_and_several_factors_are_the_same(x64):
    belief = jax.tree.map(jnp.asarray, BELIEF._replace(covariance=0.1 * np.eye(6)))
    factor = landmark_factor(landmark_values())

    def slope(x):
        return jax.jacrev(lambda v: factor.residual(body.BODY.retract(x, v)))(jnp.zeros(6))

    parts = [kalman.Factor(lambda x, i=i: factor.residual(x)[3 * i : 3 * i + 3], factor.noise[i]) for i in range(3)]

    @partial(jax.jit, compiler_options=QUICK)
    def updates(belief):
        options = {"iterations": 20, "tolerance": 1e-10}
        every = factor, factor._replace(jacobian=slope), parts
        return [kalman.update(body.BODY, belief, factors, **options)[0] for factors in every]

    expected, given, split = updates(belief)
    for found in (given, split):
        jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-10), found, expected)


def test_a_link_from_its_parent_and_its_own_past(x64):
    """Another manifold, and noise that enters through the joint: Monte Carlo of the exact motion."""
    link = product.of((quaternion, Euclidean((1,))))
    source = product.of((quaternion, Euclidean((1,)), Euclidean((1,))))
    axis = jnp.array([0.0, 0.6, 0.8])

    def motion(x):
        parent, bias, noise = x
        return quaternion.retract(parent, (0.9 - bias[0] + noise[0]) * axis), bias

    parent = kalman.Gaussian(quaternion.exp(jnp.array([0.2, -0.4, 0.1])), 1e-4 * jnp.diag(jnp.array([1.0, 2, 3])))
    bias, noise = (kalman.Gaussian(jnp.array([m]), jnp.array([[s]])) for m, s in ((0.05, 4e-4), (0.0, 1e-4)))
    before = kalman.independent(parent, bias, noise)
    predict = partial(kalman.predict, source, dynamics=motion, target=link, noise=1e-6 * jnp.eye(4))
    after = jax.jit(predict, compiler_options=QUICK)(before)
    draws = np.random.default_rng(7).multivariate_normal(np.zeros(5), before.covariance, size=40000)
    drawn = jax.vmap(lambda v: link.local(after.mean, motion(source.retract(before.mean, v))))
    moved = jax.jit(drawn, compiler_options=QUICK)(draws)
    expected = np.cov(moved.T) + 1e-6 * np.eye(4)
    # A sample variance of 40000 draws has a standard error of 0.7 %.
    np.testing.assert_allclose(after.covariance, expected, atol=0.03 * np.abs(expected).max())


def test_shapes_are_checked(x64):
    belief = jax.tree.map(jnp.asarray, BELIEF)
    factor = landmark_factor(landmark_values())
    for wrong, message in (
        ((belief, factor._replace(noise=np.ones(8))), "noise: has shape"),
        ((belief, factor._replace(valid=np.ones(3, bool))), "valid: has shape"),
        ((belief._replace(covariance=jnp.eye(5)), factor), "covariance: has shape"),
    ):
        with pytest.raises(ValueError, match=message):
            kalman.update(body.BODY, *wrong)
    with pytest.raises(ValueError, match="iterations: got 0"):
        kalman.update(body.BODY, belief, factor, iterations=0)


@pytest.mark.slow
def test_consistency(x64):
    """500 runs; the sampling error of their mean NEES over 6 is sqrt(2 / 3000) = 0.026 at one step."""
    params = jax.tree.map(jnp.float64, body.Params())

    def one(key):
        look, truth = body.simulate(params, key=key, steps=20)
        _, history = body.filtered(body.model(), params, look)
        smoothed = kalman.smooth(body.model(), params, body.start(params), look, iterations=1)
        rows = jnp.array([0, 10, 19])
        return [
            jax.vmap(lambda x, p, y: jnp.vdot(e := body.BODY.local(x, y), jnp.linalg.solve(p, e)))(
                *jax.tree.map(lambda leaf: leaf[rows], (found.mean, found.covariance, truth))
            )
            for found in (history, smoothed)
        ] + [jnp.sum(history.nis), jnp.sum(history.dof)]

    filtered, smoothed, nis, dof = jax.jit(jax.vmap(one), compiler_options=QUICK)(
        jax.random.split(jax.random.key(3), 500)
    )
    low, high = nees_bounds(6, 500, 0.999)
    for found in (filtered, smoothed):
        ratio = np.mean(found, axis=0) / 6
        assert np.all((ratio > max(0.9, low / 6)) & (ratio < min(1.1, high / 6))), ratio
    assert abs(np.sum(nis) / np.sum(dof) - 1) < 0.02
