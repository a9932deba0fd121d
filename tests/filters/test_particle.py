"""Particle filters: masks, recovery, proposals that waste few particles, summaries, small solves, bad arguments."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from particle_models import (
    BOOTSTRAP,
    GUIDED,
    JOINTS,
    WALK,
    Params,
    Seen,
    build,
    log_likelihood,
    residual,
    simulate,
    start,
    von_mises,
)
from quick_compile import QUICK

from jaxest.filters import particle, resampling, run
from jaxest.filters.particle import _cholesky
from jaxest.manifolds import Euclidean, Power, circle, product, quaternion
from jaxest.types import NON_FINITE, OK, WEIGHTS_VANISHED, Reading, status_message

quick = partial(jax.jit, compiler_options=QUICK)
PROPOSALS = [BOOTSTRAP, GUIDED, particle.guided(JOINTS, WALK, log_likelihood, GUIDED.rows, defensive=0.3)]
IDS = ["bootstrap", "guided", "defensive"]


def at(tree, index):
    return jax.tree.map(lambda x: x[index], tree)


@pytest.fixture(scope="module")
def series():
    measurements, truth = simulate(Params(), key=jax.random.key(4), steps=12)
    return measurements, truth


@pytest.mark.parametrize("propose", PROPOSALS, ids=IDS)
def test_a_masked_sensor_is_no_sensor(propose, x64):
    """Weights and their gradients are those of a model that has never heard of the sensor, bit for bit of the mask."""
    params = jax.tree.map(jnp.asarray, Params())
    particles = start(params, key=jax.random.key(0)).particles
    encoder = Reading(jnp.array([0.3, 0.9]), jnp.array([True, True]))

    def without(params, x, measurement):
        return jnp.sum(von_mises(measurement.encoder.value - x, params.encoder))

    def rows_without(params, x, measurement):
        return 2 * jnp.sin((measurement.encoder.value - x) / 2) * jnp.sqrt(params.encoder)

    if propose is BOOTSTRAP:
        other = particle.bootstrap(JOINTS, WALK, without)
    else:
        rows = particle.differentiated(JOINTS, rows_without)
        other = particle.guided(JOINTS, WALK, without, rows, defensive=propose.defensive)

    def weights(propose, params, value, valid):
        measurement = Seen(encoder, Reading(value, valid), jnp.asarray(0.01))
        return propose(params, particles, measurement, jax.random.key(1))

    def everything(propose, params, value, valid):
        def total(params, value):
            return jnp.sum(jnp.sin(weights(propose, params, value, valid)[1]))

        return weights(propose, params, value, valid), jax.grad(total, (0, 1))(params, value)

    value = jnp.array([1.2, 0.4])
    (expected_moved, expected), (slope, _) = quick(partial(everything, other))(params, value, jnp.bool_(False))
    ours = quick(partial(everything, propose))
    hidden = [value, 0 * value, jnp.array([1e30, -3.0])]
    results = [ours(params, each, jnp.bool_(False)) for each in hidden]
    for (moved, found), (slopes, to_value) in results:
        np.testing.assert_array_equal(found, results[0][0][1])
        np.testing.assert_allclose(moved, expected_moved, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)
        np.testing.assert_array_equal(to_value, 0)
        assert slopes.marker == 0
        np.testing.assert_allclose(slopes.encoder, slope.encoder, rtol=1e-9)
        np.testing.assert_allclose(slopes.walk, slope.walk, rtol=1e-9)
    assert abs(slope.encoder) > 1e-3
    (_, seen), (_, to_value) = ours(params, value, jnp.bool_(True))
    assert np.any(np.asarray(to_value) != 0)
    assert np.abs(np.asarray(seen - expected)).max() > 1


def cut_off(params, x, measurement):
    return jnp.where(measurement.dt > 1, -jnp.inf, log_likelihood(params, x, measurement))


@pytest.mark.parametrize("guided", [False, True], ids=["bootstrap", "guided"])
def test_vanished_weights_recover_and_say_so(series, guided):
    rows = particle.differentiated(JOINTS, residual)
    propose = particle.guided(JOINTS, WALK, cut_off, rows) if guided else particle.bootstrap(JOINTS, WALK, cut_off)
    step = jax.jit(particle.filter_step(particle.Model(JOINTS, propose, ancestors=True)), compiler_options=QUICK)
    measurements, _ = series
    key, params, state = jax.random.key(0), Params(), start(Params(), key=jax.random.key(1))
    dt = jnp.where(jnp.arange(12) == 5, 2.0, 0.01)
    measurements = measurements._replace(dt=dt)
    for i in range(12):
        before = state
        state, info = step(params, state, at(measurements, i), key=key)
        assert int(info.status) == (WEIGHTS_VANISHED if i == 5 else OK)
        assert np.all(np.isfinite(np.asarray(state.particles)))
        np.testing.assert_allclose(np.exp(np.asarray(state.log_weights, float)).sum(), 1, rtol=1e-5)
        assert np.all(np.isfinite(np.asarray(info.mean)))
        if i == 5:
            assert info.log_likelihood == -np.inf
            np.testing.assert_allclose(state.log_weights, -np.log(48), rtol=1e-6)
            np.testing.assert_allclose(info.ess, 48, rtol=1e-5)
            moved = np.asarray(state.particles) - np.asarray(before.particles)[np.asarray(info.ancestors)]
            assert np.all(moved != 0)  # where they were proposed
        else:
            assert np.isfinite(info.log_likelihood)
    assert "reset to uniform" in status_message(WEIGHTS_VANISHED)


def torn(params, x, measurement):
    return jnp.where(x[0] > 0.9, jnp.nan, x)


@pytest.mark.parametrize("guided", [False, True], ids=["bootstrap", "guided"])
def test_particles_that_are_not_finite_are_dropped(series, guided):
    """Those that the transition loses stay where they were, without weight, and do not spoil the others."""
    lossy = WALK._replace(mean=torn)
    propose = (
        particle.guided(JOINTS, lossy, log_likelihood, GUIDED.rows, defensive=0.3)
        if guided
        else particle.bootstrap(JOINTS, lossy, log_likelihood)
    )
    measurement, state = at(series[0], 5), start(Params(), key=jax.random.key(1))
    step = particle.filter_step(particle.Model(JOINTS, propose, ancestors=True))
    after, info = quick(step)(Params(), state, measurement, key=jax.random.key(2))
    origin = np.asarray(state.particles)[np.asarray(info.ancestors)]
    lost = origin[:, 0] > 0.9
    assert (0 < lost.sum() < 15) if guided else (5 < lost.sum() < 40)  # a look ahead chooses few of them
    np.testing.assert_array_equal(np.asarray(after.particles)[lost], origin[lost])
    assert np.all(np.asarray(after.log_weights)[lost] == -np.inf)
    assert np.all(np.isfinite(np.asarray(after.log_weights)[~lost]))
    for number in (info.mean, info.covariance, info.log_likelihood, info.ess):
        assert np.all(np.isfinite(np.asarray(number)))
    assert int(info.status) == OK


def wild_rows(params, x, measurement):
    value, jacobian = particle.differentiated(JOINTS, residual)(params, x, measurement)
    return jnp.where(x[0] > 0.5, jnp.nan, value), jacobian


def test_a_residual_that_is_not_finite_leaves_the_transition(series):
    propose = particle.guided(JOINTS, WALK, log_likelihood, wild_rows, iterations=1)
    particles = jnp.array([[0.2, 0.7], [0.8, 0.7]])
    measurement = at(series[0], 5)
    key = jax.random.key(0)
    once = particle.guided(*GUIDED[:4], iterations=1)
    (moved, weights), (plain, _) = quick(
        lambda measurement: [each(Params(), particles, measurement, key) for each in (propose, once)]
    )(measurement)
    np.testing.assert_allclose(moved[0], plain[0], rtol=1e-6)
    z = -jax.random.normal(key, (2, 1), moved.dtype)[:, 0]  # draws come in pairs of opposite signs
    np.testing.assert_allclose(moved[1], particles[1] + Params().walk * z, rtol=1e-5)
    np.testing.assert_allclose(weights[1], log_likelihood(Params(), moved[1], measurement), rtol=1e-5)


@pytest.mark.parametrize("propose", PROPOSALS, ids=IDS)
def test_without_a_measurement_nothing_happens_to_the_weights(series, propose):
    hidden = at(series[0], 5)
    nothing = Reading(hidden.encoder.value, np.zeros(2, bool)), Reading(hidden.marker.value, np.bool_(False))
    step = quick(particle.filter_step(particle.Model(JOINTS, propose)))
    state = start(Params(), key=jax.random.key(1))
    _, info = step(Params(), state, Seen(*nothing, hidden.dt), key=jax.random.key(0))
    np.testing.assert_allclose(info.log_likelihood, 0, atol=1e-5)
    np.testing.assert_allclose(info.ess, 48, rtol=1e-4)


class SeenOnce(NamedTuple):
    value: Reading


# A chain of four joints about three axes; what is seen is nonlinear in all of them.
CHAIN = Power(circle, 4)
AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0]], np.float32)


def links(q):
    """Directions (8, 3): two edges of each of four links."""
    turn, out = quaternion.identity(q.dtype), []
    for axis, angle in zip(AXES, q, strict=True):
        turn = quaternion.compose(turn, quaternion.exp(angle * axis))
        out += [quaternion.rotate(turn, jnp.asarray(edge, q.dtype)) for edge in ([1, 0, 0], [0, 0, 1])]
    return jnp.stack(out)


def chain_residual(params, x, measurement):
    return jnp.where(measurement.value.valid, (measurement.value.value - links(x)).reshape(-1), 0) / 0.05


def chain_log_likelihood(params, x, measurement):
    return -jnp.sum(chain_residual(params, x, measurement) ** 2) / 2


def chain_draw(params, measurement, key, count):
    return jax.random.normal(key, (count, 4)) / jnp.sqrt(5.0)  # only guided is used


CHAIN_WALK = particle.Transition(
    lambda params, x, measurement: x,
    chain_draw,
    lambda params, v, measurement: jnp.sum(von_mises(v, jnp.float32(5))),
    lambda params, measurement: jnp.full(4, 5.0),
)


def test_guided_particles_are_hardly_wasted():
    """Steps of 0.45 rad, seen to 0.05: a fresh posture each time, so every step is a long one."""
    count, steps = 256, 20
    random = np.random.default_rng(7)
    truth = jnp.asarray(0.6 * random.normal(size=(steps, 4)), jnp.float32)
    rows = particle.differentiated(CHAIN, chain_residual)
    step = particle.filter_step(particle.Model(CHAIN, particle.guided(CHAIN, CHAIN_WALK, chain_log_likelihood, rows)))

    def one(key, q):
        first, second, third = jax.random.split(key, 3)
        # Particles of the step before lie within its posterior, this one's truth a step of the walk from them.
        before = q[None] + 0.05 * jax.random.normal(first, (count, 4))
        moved = q + jax.random.normal(second, (4,)) / jnp.sqrt(5.0)
        seen = links(moved) + 0.05 * jax.random.normal(third, (8, 3))
        measurement = SeenOnce(Reading(seen, jnp.asarray(True)))
        return step(None, particle.init(before), measurement, key=key)[1].ess

    keys = jax.random.split(jax.random.key(1), steps)
    ess = jax.jit(jax.vmap(one), compiler_options=QUICK)(keys, truth)
    assert np.median(np.asarray(ess)) >= 0.9 * count


@pytest.mark.parametrize("dtype", ["float32", pytest.param("float64", marks=pytest.mark.slow)], indirect=True)
def test_summary_of_particles_is_mean_and_covariance(dtype):
    random = np.random.default_rng(0)
    space = product.of({"angle": circle, "turn": quaternion, "point": Euclidean((2,))})
    offsets = jnp.asarray(0.4 * random.normal(size=(300, 6)), dtype)
    log_weights = jnp.asarray(random.normal(size=300), dtype)

    def everything(offsets, log_weights):
        turn = quaternion.exp(jnp.asarray([0.3, -1.0, 0.5], dtype))
        centre = {"angle": jnp.asarray(3.0, dtype), "turn": turn, "point": jnp.asarray([5.0, -4.0], dtype)}
        particles = jax.vmap(space.retract, (None, 0))(centre, offsets)
        exact = space.mean(particles, jnp.exp(log_weights))
        rest = jax.vmap(space.local, (None, 0))(exact, particles)
        mean, covariance = particle.mean_and_covariance(space, particles, log_weights)
        closer, _ = particle.mean_and_covariance(space, particles, log_weights, passes=12)
        return space.local(exact, mean), space.local(exact, closer), covariance, rest

    off, still, covariance, rest = quick(everything)(offsets, log_weights)
    eps = np.finfo(dtype).eps
    np.testing.assert_allclose(off, 0, atol=100 * eps + 1e-6)
    np.testing.assert_allclose(still, 0, atol=100 * eps)
    weights = np.exp(np.asarray(log_weights, float))
    weights /= weights.sum()
    rest = np.asarray(rest, float)
    np.testing.assert_allclose(covariance, (weights[:, None] * rest).T @ rest, atol=100 * eps + 1e-6)
    assert covariance.dtype == dtype


def test_interval_goes_across_half_a_turn():
    quantiles = np.linspace(-1, 1, 2001)
    angles = circle.wrap(jnp.asarray(np.pi - 0.1 + quantiles, jnp.float32))
    find = quick(partial(particle.interval, Power(circle, 1)), static_argnums=2)
    found = find(angles[:, None], jnp.zeros(2001), 0.9)
    np.testing.assert_allclose(circle.wrap(found.centre - (np.pi - 0.1)), 0, atol=1e-5)
    np.testing.assert_allclose(found.lower, -0.9, atol=2e-3)
    np.testing.assert_allclose(found.upper, 0.9, atol=2e-3)
    heavy = jnp.where(quantiles > 0.5, 0.0, -30.0)
    found = find(angles[:, None], heavy, 0.5, centre=angles[1000][None])
    np.testing.assert_allclose([found.lower[0], found.upper[0]], [0.625, 0.875], atol=2e-3)


@pytest.mark.parametrize("size", [1, 4, 16])
def test_small_solves(size, dtype):
    random = np.random.default_rng(size)
    residuals, jacobian = random.normal(size=(size + 2, 5)), random.normal(size=(size + 2, size, 5))
    start, prior = random.normal(size=(size, 5)), np.diag(1 + random.random(size))
    pull, basis = random.normal(size=(size, 5)), np.linalg.qr(random.normal(size=(size, size)))[0]
    given = [jnp.asarray(x, dtype) for x in (residuals, jacobian, start, prior)]
    z = jnp.asarray(random.normal(size=(size, 5)), dtype)

    def everything(residuals, jacobian, start, prior, z):
        equations = _cholesky.normal_equations(residuals, jacobian, start, prior, pull)
        energy = _cholesky.misfit(residuals, jacobian, -start)
        factor = _cholesky.factorize(equations, jnp.diagonal(prior))
        solved = _cholesky.solve(factor, factor[:, -1] + z)
        known = jnp.arange(size) >= size // 2
        found = _cholesky.conditional(factor, z, solved, known), _cholesky.turned(equations, jnp.asarray(basis, dtype))
        return factor, solved, _cholesky.whiten(factor, solved) - factor[:, -1], energy, *found

    factor, solved, white, energy, again, turned = quick(everything)(*given, z)
    np.testing.assert_allclose(again, solved, atol=1e4 * np.finfo(dtype).eps)
    tolerance = 1e4 * np.finfo(dtype).eps
    for n in range(5):
        j, r, v = jacobian[:, :, n], residuals[:, n], start[:, n]
        information = prior + j.T @ j
        root = np.linalg.cholesky(information)
        right = pull[:, n] + j.T @ (j @ v - r)
        best = np.linalg.solve(information, right)
        np.testing.assert_allclose(energy[n], np.sum((r - j @ v) ** 2), rtol=tolerance)
        np.testing.assert_allclose(turned[:, :-1, n], basis.T @ information @ basis, atol=tolerance)
        np.testing.assert_allclose(turned[:, -1, n], basis.T @ right, atol=tolerance)
        np.testing.assert_allclose(factor[:, :-1, n], root.T, atol=tolerance)
        expected = best + np.linalg.solve(root.T, np.asarray(z[:, n], float))
        np.testing.assert_allclose(solved[:, n], expected, atol=tolerance)
        np.testing.assert_allclose(white[:, n], z[:, n], atol=tolerance)


@pytest.mark.parametrize(("sharpness", "tolerance"), [(30.0, 1e-3), (1e3, 0.1), (1e5, None)])
def test_a_sharp_sensor_of_one_direction_leaves_float32_whole(sharpness, tolerance):
    """Up to 1e10 of information about one direction of six, where what is left of the other pivots is rounding."""
    random = np.random.default_rng(0)
    jacobian = np.float32(sharpness * random.normal(size=(1, 6, 20)))
    z = np.float32(random.normal(size=(6, 20)))

    def draw(jacobian, z):
        none = jnp.zeros((6, 20))
        equations = _cholesky.normal_equations(jnp.zeros((1, 20)), jacobian, none, 5 * jnp.eye(6), none)
        return _cholesky.solve(_cholesky.factorize(equations, jnp.full(6, 5.0)), z)

    drawn = np.asarray(quick(draw)(jacobian, z))
    assert np.abs(drawn).max() < 4.5 / np.sqrt(5)
    if tolerance is not None:
        for n in range(20):
            j = jacobian[0, :, n].astype(float)
            root = np.linalg.cholesky(5 * np.eye(6) + np.outer(j, j))
            np.testing.assert_allclose(drawn[:, n], np.linalg.solve(root.T, z[:, n]), rtol=0, atol=tolerance)


def test_every_step_draws_anew_and_every_index_the_same(series):
    step = quick(particle.filter_step(particle.Model(JOINTS, BOOTSTRAP)))
    state, measurement = start(Params(), key=jax.random.key(1)), at(series[0], 5)
    key = jax.random.key(0)
    first, again = (step(Params(), state, measurement, key=key)[0].particles for _ in range(2))
    later, _ = step(Params(), state._replace(index=state.index + 1), measurement, key=key)
    other, _ = step(Params(), state, measurement, key=jax.random.key(1))
    np.testing.assert_array_equal(first, again)
    assert np.all(np.asarray(first) != np.asarray(later.particles))
    assert np.all(np.asarray(first) != np.asarray(other.particles))


def test_the_same_model_compiles_once():
    model = particle.Model(JOINTS, GUIDED)
    assert particle.filter_step(model) is particle.filter_step(particle.Model(JOINTS, GUIDED))
    assert build() is build()


def test_not_finite_and_missing_are_told_apart(series):
    measurement = at(series[0], 5)
    value = measurement.marker.value.at[0].set(jnp.nan)
    measurement = measurement._replace(marker=Reading(value, jnp.asarray(True)))
    step = quick(particle.filter_step(particle.Model(JOINTS, GUIDED)))
    _, info = step(Params(), start(Params(), key=jax.random.key(1)), measurement, key=jax.random.key(0))
    assert int(info.status) == NON_FINITE
    assert info.ancestors is None


def test_bad_arguments_are_named(series):
    step = particle.filter_step(particle.Model(JOINTS, GUIDED))
    state, measurement = start(Params(), key=jax.random.key(1)), at(series[0], 5)
    with pytest.raises(ValueError, match="key: got None, expected the key of the run"):
        step(Params(), state, measurement)
    with pytest.raises(ValueError, match="particles: leaves have shapes"):
        particle.init((jnp.zeros((3, 2)), jnp.zeros(4)))
    with pytest.raises(ValueError, match="particles: leaves have shapes"):
        particle.init(jnp.zeros(()))
    with pytest.raises(ValueError, match=r"log_weights: has shape \(4,\), expected \(3,\)"):
        particle.init(jnp.zeros((3, 2)), jnp.zeros(4))
    with pytest.raises(ValueError, match="iterations: got 0, expected at least 1"):
        particle.guided(JOINTS, WALK, log_likelihood, GUIDED.rows, iterations=0)
    with pytest.raises(ValueError, match=r"defensive: got 1.0, expected a share"):
        particle.guided(JOINTS, WALK, log_likelihood, GUIDED.rows, defensive=1.0)
    with pytest.raises(ValueError, match="probability: got 1, expected a share"):
        particle.interval(JOINTS, state.particles, state.log_weights, 1)
    flat = particle.guided(JOINTS, WALK._replace(precision=lambda p, z: jnp.ones(3)), log_likelihood, GUIDED.rows)
    with pytest.raises(ValueError, match=r"precision: has shape \(3,\), expected \(2,\) or \(2, 2\)"):
        flat(Params(), state.particles, measurement, jax.random.key(0))
    wrong = particle.guided(JOINTS, WALK, log_likelihood, lambda p, x, z: (jnp.ones(3), jnp.ones((2, 2))))
    with pytest.raises(ValueError, match=r"rows: got shapes \(3,\) and \(2, 2\), expected \(m,\) and \(m, d\)"):
        wrong(Params(), state.particles, measurement, jax.random.key(0))


def test_float32_run_follows_the_truth():
    """The mean stays as far from the truth as its covariance says."""
    measurements, truth = jax.vmap(lambda key: simulate(Params(walk=0.2), key=key))(
        jax.random.split(jax.random.key(6), 60)
    )
    params = Params(walk=0.2)
    system = build(GUIDED, resampling.stratified, 128)

    def one(measurements, truth, key):
        _, history = run(system.step, params, system.init(params, key=key), measurements, key=key)
        return jax.vmap(JOINTS.local)(history.mean, truth), history.covariance

    away, covariance = quick(jax.vmap(one))(measurements, truth, jax.random.split(jax.random.key(0), 60))
    assert away.dtype == covariance.dtype == jnp.float32
    away, covariance = np.asarray(away, float)[:, 4:], np.asarray(covariance, float)[:, 4:]
    distance = np.einsum("rti,rtij,rtj->rt", away, np.linalg.inv(covariance), away).mean(axis=1)
    # Two degrees of freedom, from 60 independent runs; 128 particles leave the covariance 2 / 128 short.
    assert abs(distance.mean() - 2) < 4.5 * distance.std() / np.sqrt(60) + 0.1
