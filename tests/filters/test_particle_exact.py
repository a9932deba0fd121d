"""Particle filters against exact answers: one angle by quadrature, a linear-Gaussian model by the Kalman filter.

An estimate of the evidence has no bias whatever the proposal and the resampling are, so the mean of its ratio to the
exact one is 1 to within its sampling error; means and covariances have a bias of the order of 1 / N, and are allowed a
tenth of the posterior's deviation on top.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from particle_models import von_mises
from quick_compile import QUICK
from reference import ref_circle_filter as reference

from jaxest.filters import kalman, particle, resampling, run
from jaxest.filters.particle import _gauss_newton as gauss_newton
from jaxest.manifolds import Euclidean, circle, quaternion
from jaxest.types import OK, Reading

SLOW = pytest.mark.slow
RUNS, COUNT, GRID = 200, 256, 400


class Seen(NamedTuple):
    value: Reading
    dt: object


def repeated(model, params, start, measurements, runs=RUNS, seed=0):
    """Histories of independent runs, leaves (runs, T, ...); `start` draws the particles of one."""

    def one(key):
        first, rest = jax.random.split(key)
        return run(particle.filter_step(model), params, start(first), measurements, key=rest)[1]

    return jax.jit(jax.vmap(one), compiler_options=QUICK)(jax.random.split(jax.random.key(seed), runs))


def assert_evidence(history, exact):
    """The evidence of the whole series and of its first half."""
    for steps in (len(exact) // 2, len(exact)):
        ratio = np.exp(np.asarray(history.log_likelihood, float)[:, :steps].sum(axis=1) - exact[:steps].sum())
        error = ratio.std() / np.sqrt(len(ratio))
        assert error < 0.1  # a test that could not fail otherwise
        assert abs(ratio.mean() - 1) < 4.5 * error


# A linear-Gaussian model: position and velocity, the position seen at most steps.
PLANE = Euclidean((2,))
F = np.array([[1.0, 0.3], [0.0, 0.9]])
PARAMS = {"walk": jnp.array([0.3, 0.4]), "seen": jnp.array(0.25)}
VALUES = np.array([0.3, 0.9, 0.0, 1.6, 1.4, 1.9, 0.0, 1.2])
VALID = VALUES != 0.0
LINE = Seen(Reading(jnp.asarray(np.where(VALID, VALUES, np.nan)), jnp.asarray(VALID)), jnp.ones(len(VALUES)))


def line_mean(params, x, measurement):
    return jnp.asarray(F, x.dtype) @ x


def line_residual(params, x, measurement):
    reading = measurement.value
    return jnp.where(reading.valid, reading.value - x[0], 0)[None] / params["seen"]


def line_log_likelihood(params, x, measurement):
    square = jnp.sum(line_residual(params, x, measurement) ** 2)
    return jnp.where(measurement.value.valid, -(square + jnp.log(2 * jnp.pi * params["seen"] ** 2)) / 2, 0)


LINE_NOISE = particle.gaussian(line_mean, lambda params, measurement: params["walk"])
BOOTSTRAP = particle.bootstrap(PLANE, LINE_NOISE, line_log_likelihood)
GUIDED = particle.guided(
    PLANE, LINE_NOISE, line_log_likelihood, particle.differentiated(PLANE, line_residual), iterations=1
)
KALMAN = kalman.Model(
    PLANE,
    line_mean,
    lambda params, x, measurement: jnp.diag(params["walk"] ** 2),
    (kalman.sensor("value", lambda params, x, z: x[0], lambda params, z: params["seen"][None] ** 2),),
)


def line_start(key, count=COUNT):
    return particle.init(jax.random.normal(key, (count, 2)))


@pytest.mark.parametrize(
    ("propose", "resample"),
    [
        (BOOTSTRAP, resampling.systematic),
        (BOOTSTRAP, resampling.stratified),
        pytest.param(BOOTSTRAP, resampling.multinomial, marks=SLOW),
        (BOOTSTRAP, resampling.residual),
        (BOOTSTRAP, resampling.adaptive(resampling.systematic, 0.5)),
        (GUIDED, resampling.systematic),
        pytest.param(GUIDED, resampling.adaptive(resampling.stratified, 0.7), marks=SLOW),
    ],
)
def test_linear_gaussian_model_is_the_kalman_filter(propose, resample):
    start = kalman.init(jnp.zeros(2), jnp.eye(2))
    _, exact = run(kalman.filter_step(KALMAN), PARAMS, start, LINE)
    history = repeated(particle.Model(PLANE, propose, resample), PARAMS, line_start, LINE)
    assert np.all(np.asarray(history.status) == OK)
    assert_evidence(history, np.asarray(exact.log_likelihood))
    deviation = np.sqrt(np.diagonal(exact.covariance, axis1=1, axis2=2))
    error = np.asarray(history.mean).std(axis=0) / np.sqrt(RUNS)
    assert np.all(error < 0.05 * deviation)
    off = np.abs(np.asarray(history.mean).mean(axis=0) - exact.mean)
    assert np.all(off < 4.5 * error + 0.1 * deviation)
    spread = np.asarray(history.covariance)
    error = spread.std(axis=0) / np.sqrt(RUNS)
    scale = deviation[:, :, None] * deviation[:, None, :]
    assert np.all(np.abs(spread.mean(axis=0) - exact.covariance) < 4.5 * error + 0.1 * scale)


def test_guided_is_the_optimal_proposal_of_a_linear_model():
    """The weight then depends on where a particle comes from only, and not on what was drawn for it."""
    before = jnp.asarray(np.random.default_rng(0).normal(size=(50, 2)), jnp.float32)
    measurement = jax.tree.map(lambda x: x[0], LINE)
    first, second = (GUIDED(PARAMS, before, measurement, jax.random.key(i)) for i in (0, 1))
    assert np.abs(np.asarray(first[0] - second[0])).max() > 0.5
    np.testing.assert_allclose(first[1], second[1], rtol=0, atol=2e-5)
    predicted = np.asarray(before) @ F.T
    variance = PARAMS["walk"][0] ** 2 + PARAMS["seen"] ** 2
    expected = -((VALUES[0] - predicted[:, 0]) ** 2 / variance + np.log(2 * np.pi * variance)) / 2
    np.testing.assert_allclose(first[1], expected, rtol=0, atol=2e-5)


# One angle: an encoder and a marker of a lever, with noise that takes it round the circle.
ANGLES = np.array([2.6, 3.0, -2.9, -2.4, 2.9, 3.1])


class Lever(NamedTuple):
    encoder: Reading
    marker: Reading
    dt: object


class LeverParams(NamedTuple):
    walk: object
    """concentration, or rad where Gaussian"""
    encoder: object = 8.0
    marker: object = 0.08


def lever(dtype):
    random = np.random.default_rng(1)
    encoder = ANGLES + 0.3 * random.normal(size=len(ANGLES))
    marker = np.sin(ANGLES) + 0.08 * random.normal(size=len(ANGLES))
    seen = [Reading(encoder, np.arange(6) != 2), Reading(marker, np.arange(6) != 4)]
    readings = (Reading(jnp.asarray(r.value, dtype), jnp.asarray(r.valid)) for r in seen)
    return Lever(*readings, jnp.ones(len(ANGLES), dtype))


def lever_log_likelihood(params, x, measurement):
    encoder, marker = measurement
    one = von_mises(jnp.where(encoder.valid, encoder.value - x, 0), jnp.asarray(params.encoder))
    way = jnp.where(marker.valid, marker.value - jnp.sin(x), 0) / params.marker
    two = -(way**2) / 2 - jnp.log(params.marker * jnp.sqrt(2 * jnp.pi))
    return jnp.where(encoder.valid, one, 0) + jnp.where(marker.valid, two, 0)


def lever_residual(params, x, measurement):
    encoder, marker = measurement
    one = 2 * jnp.sin(jnp.where(encoder.valid, encoder.value - x, 0) / 2) * jnp.sqrt(params.encoder)
    return jnp.stack([one, jnp.where(marker.valid, marker.value - jnp.sin(x), 0) / params.marker])


def readings_only(function):
    return lambda params, x, measurement: function(params, x, measurement[:2])


def draw_von_mises(params, measurement, key, count):
    """By the inverse of a distribution function summed on a fine grid."""
    angles = jnp.linspace(-jnp.pi, jnp.pi, 401)
    density = jnp.exp(von_mises(angles, params.walk))
    share = jnp.cumsum(density) - density / 2  # the ends count half
    share = (share - share[0]) / (share[-1] - share[0])
    return jnp.interp(jax.random.uniform(key, (count, 1)), share, angles)


VON_MISES = particle.Transition(
    lambda params, x, measurement: x,
    draw_von_mises,
    lambda params, v, measurement: jnp.sum(von_mises(v, jnp.asarray(params.walk, v.dtype))),
    lambda params, measurement: 0.8 * jnp.reshape(params.walk, (1,)),
)
WRAPPED = particle.gaussian(lambda params, x, measurement: x, lambda params, measurement: params.walk[None])


def lever_model(transition, guided, **options):
    likelihood = readings_only(lever_log_likelihood)
    if not guided:
        return particle.Model(circle, particle.bootstrap(circle, transition, likelihood))
    rows = particle.differentiated(circle, readings_only(lever_residual))
    return particle.Model(circle, particle.guided(circle, transition, likelihood, rows, **options))


def lever_exact(params, density):
    angles = reference.grid(GRID)
    with jax.enable_x64(True):
        data = lever(np.float64)
        table = jax.vmap(jax.vmap(partial(lever_log_likelihood, params), (0, None)), (None, 0))(angles, data[:2])
    flat = np.full(GRID, 1 / (2 * np.pi))
    return reference.filter_angle(flat, density, np.exp(np.asarray(table)))


def flat_start(key):
    return particle.init(jax.random.uniform(key, (COUNT,), minval=-jnp.pi, maxval=jnp.pi))


@pytest.mark.parametrize(
    ("noise", "walk", "guided"),
    [
        ("mises", 5.0, False),
        ("mises", 5.0, True),
        ("wrapped", 2.0, False),
        pytest.param("wrapped", 2.0, True, marks=SLOW),
        pytest.param("mises", 0.7, False, marks=SLOW),
        pytest.param("mises", 0.7, True, marks=SLOW),
        pytest.param("wrapped", 0.4, False, marks=SLOW),
        pytest.param("wrapped", 0.4, True, marks=SLOW),
    ],
)
def test_one_angle_is_the_quadrature(noise, walk, guided):
    """Also where noise reaches round the circle: von Mises noise ends at half a turn, Gaussian noise goes on.

    A sine seen alone fits two angles, both within reach of the wide noises: those need the defensive share.
    """
    transition = {"mises": VON_MISES, "wrapped": WRAPPED}[noise]
    if transition is VON_MISES:

        def density(angle):
            return np.exp(walk * np.cos(angle)) / (2 * np.pi * np.i0(walk))
    else:
        density = reference.wrapped_normal(walk)
    params = LeverParams(jnp.float32(walk))
    densities, increments = lever_exact(params, density)
    # What only the defensive share finds weighs up to 1 / share^2 and scatters: a small share, as 0.02, is right on
    # average, but not within so few runs where noise reaches both angles.
    model = lever_model(transition, guided, defensive=0.02 if walk == 0.4 else 0.2)
    history = repeated(model, params, flat_start, lever(np.float32), runs=RUNS * (3 if guided and walk != 0.4 else 1))
    assert np.all(np.asarray(history.status) == OK)
    assert_evidence(history, increments)
    # The posterior mean direction and its length, after the last step; only one mode is left there.
    moment = np.sum(densities[-1] * np.exp(1j * reference.grid(GRID))) * 2 * np.pi / GRID
    assert abs(moment) > 0.95
    off = np.angle(np.exp(1j * (np.asarray(history.mean)[:, -1] - np.angle(moment))))
    deviation = np.sqrt(2 * (1 - abs(moment)))
    assert abs(off.mean()) < 4.5 * off.std() / np.sqrt(RUNS) + 0.1 * deviation


def test_noise_ends_at_half_a_turn():
    """Without a measurement the mean weight is 1, though a tenth of the proposal's Gaussian lies beyond the circle."""
    params, count = LeverParams(jnp.float32(0.5)), 20_000
    nothing = Reading(jnp.float32(0), jnp.bool_(False))
    measurement = Lever(nothing, nothing, jnp.float32(1))
    propose = jax.jit(partial(lever_model(VON_MISES, True).propose, params), compiler_options=QUICK)
    particles = jnp.full(count, 2.0)
    moved, weights = propose(particles, measurement, jax.random.key(0))
    weights = np.exp(np.asarray(weights, float))
    away = np.angle(np.exp(1j * (np.asarray(moved, float) - 2)))
    assert 0.02 < np.mean(weights == 0) < 0.1
    for value, exact in ((1 + 0 * away, 1.0), (np.cos(away), 0.24249961258080)):  # I1/I0 of a half
        estimate = weights * value
        assert abs(estimate.mean() - exact) < 4.5 * estimate.std() / np.sqrt(count)


def test_interval_is_that_of_the_exact_posterior():
    """Quantiles across the cut at half a turn, from one run of many particles."""
    params = LeverParams(jnp.float32(5.0))
    densities, _ = lever_exact(params, lambda a: np.exp(5 * np.cos(a)) / (2 * np.pi * np.i0(5.0)))
    model = lever_model(VON_MISES, True)
    count = 40_000
    angles = jax.random.uniform(jax.random.key(8), (count,), minval=-jnp.pi, maxval=jnp.pi)
    state, history = run(
        particle.filter_step(model), params, particle.init(angles), lever(np.float32), key=jax.random.key(9)
    )
    found = particle.interval(circle, state.particles, state.log_weights, 0.95)
    moment = np.sum(np.exp(np.asarray(state.log_weights, float) + 1j * np.asarray(state.particles, float)))
    np.testing.assert_allclose(found.centre, np.angle(moment), atol=1e-5)
    np.testing.assert_allclose(found.centre, history.mean[-1], atol=1e-3)  # which is corrected by what was foreseen
    for end, level in ((found.lower, 0.025), (found.upper, 0.975)):
        exact = reference.quantile(densities[-1], float(found.centre), level)
        step = 1e-3
        lower, upper = (reference.quantile(densities[-1], float(found.centre), level + s) for s in (-step, step))
        slope = (upper - lower) / (2 * step)
        # sqrt(p (1 - p) / N) in the level, a few times more for weights and shared ancestors
        assert abs(float(end[0]) - exact) < 4.5 * slope * 1.5 * np.sqrt(level * (1 - level) / count)


def turned(dtype=np.float32):
    seen = quaternion.exp(jnp.array([0.5, -0.4, 0.3], dtype))
    return Seen(Reading(seen, jnp.asarray(True)), jnp.ones((), dtype))


def turned_residual(params, x, measurement):
    return jnp.where(measurement.value.valid, quaternion.local(x, measurement.value.value), 0) / params["seen"]


def turned_log_likelihood(params, x, measurement):
    return -jnp.sum(turned_residual(params, x, measurement) ** 2) / 2


TURN = particle.gaussian(lambda params, x, measurement: x, lambda params, measurement: params["walk"])


@pytest.mark.parametrize("iterations", [1, pytest.param(3, marks=SLOW)])
def test_rotations_have_exact_weights_too(iterations):
    """The evidence of one step from the identity: guided particles against a million from the transition."""
    params = {"walk": jnp.array([0.5, 0.4, 0.6]), "seen": jnp.float32(0.15)}
    identity = quaternion.identity(jnp.float32)
    measurement = turned()
    propose = particle.guided(
        quaternion,
        TURN,
        turned_log_likelihood,
        particle.differentiated(quaternion, turned_residual),
        iterations=iterations,
    )
    plain = particle.bootstrap(quaternion, TURN, turned_log_likelihood)

    def weights(propose, count):
        particles = jnp.broadcast_to(identity[None], (count, 4))
        calculate = jax.jit(lambda *given: propose(*given), compiler_options=QUICK)
        return np.exp(np.asarray(calculate(params, particles, measurement, jax.random.key(3))[1], float))

    many, few = weights(plain, 1_000_000), weights(propose, 20_000)
    error = np.hypot(many.std() / 1000, few.std() / np.sqrt(20_000))
    assert error < 0.02 * many.mean()
    assert abs(many.mean() - few.mean()) < 4.5 * error
    assert few.sum() ** 2 / np.sum(few**2) > 0.9 * 20_000


def test_gauss_newton_ends_at_the_most_probable_rotation(x64):
    """Where the gradient of transition times likelihood vanishes: the tangent moves along the way."""
    params = {"walk": jnp.array([0.5, 0.4, 0.6]), "seen": jnp.array(0.3)}
    seen = quaternion.exp(jnp.array([0.9, -1.2, 0.5]))
    measurement = Seen(Reading(seen, jnp.asarray(True)), jnp.asarray(1.0))
    means = jax.vmap(quaternion.exp)(jnp.array([[0.0, 0.0, 0.0], [0.4, 0.2, -0.9]]))
    rows = particle.differentiated(quaternion, turned_residual)

    def best(means):
        none, precision = jnp.zeros((3, 2)), jnp.diag(params["walk"] ** -2)
        prior = gauss_newton.Prior(none, precision, jnp.diag(params["walk"] ** 2), none, none[0])
        return gauss_newton.posterior(quaternion, rows, (params, means, measurement), prior, 12)[2].T

    def log_density(mean, v):
        x = quaternion.retract(mean, v)
        return turned_log_likelihood(params, x, measurement) - jnp.sum((v / params["walk"]) ** 2) / 2

    def slopes(means):
        found = best(means)
        return found, jax.vmap(jax.grad(log_density, 1))(means, found)

    found, slope = jax.jit(slopes, compiler_options=QUICK)(means)
    assert np.all(np.linalg.norm(found, axis=1) > 0.7)
    np.testing.assert_allclose(slope, 0, atol=1e-7)


def test_precision_may_be_a_matrix():
    """Correlated noise of a vector; one step's evidence against the closed form."""
    covariance = np.array([[0.5, 0.3], [0.3, 0.4]], np.float32)
    root = np.linalg.cholesky(covariance).astype(np.float32)

    def log_prob(params, v, measurement):
        white = jnp.linalg.solve(root, v)
        return -jnp.sum(white**2) / 2 - jnp.sum(jnp.log(jnp.diagonal(root))) - jnp.log(2 * jnp.pi)

    transition = particle.Transition(
        lambda params, x, measurement: x,
        lambda params, measurement, key, count: jax.random.normal(key, (count, 2)) @ root.T,
        log_prob,
        lambda params, measurement: jnp.linalg.inv(jnp.asarray(covariance)),
        bounded=False,
    )
    propose = particle.guided(
        PLANE, transition, line_log_likelihood, particle.differentiated(PLANE, line_residual), iterations=1
    )
    measurement = jax.tree.map(lambda x: x[0], LINE)
    moved, weights = propose(PARAMS, jnp.zeros((4000, 2)), measurement, jax.random.key(0))
    variance = covariance[0, 0] + float(PARAMS["seen"]) ** 2
    exact = -(VALUES[0] ** 2 / variance + np.log(2 * np.pi * variance)) / 2
    np.testing.assert_allclose(weights, exact, atol=3e-5)
    gain = covariance[:, 0] / variance
    left = covariance - np.outer(gain, covariance[0])
    found = np.asarray(moved)
    error = np.sqrt(np.diagonal(left) / 4000)
    assert np.all(np.abs(found.mean(axis=0) - gain * VALUES[0]) < 4.5 * error)
    scale = np.sqrt(np.outer(np.diagonal(left), np.diagonal(left)))
    assert np.all(np.abs(np.cov(found.T) - left) < 4.5 * scale * np.sqrt(2 / 4000))


def bent_rows(params, x, measurement):
    value = jnp.stack([8 * (x[1] - x[0] ** 2 - 0.2), 0.4 * x[0] - 0.2])
    return value, jnp.stack([jnp.stack([-16 * x[0], jnp.full((), 8.0)]), jnp.array([0.4, 0.0])])


def bent_log_likelihood(params, x, measurement):
    return -jnp.sum(bent_rows(params, x, measurement)[0] ** 2) / 2


def test_evidence_of_a_bent_valley():
    """One coordinate known well on a parabola of the other, against a grid; following the bend wastes less."""
    noise = particle.gaussian(lambda params, x, measurement: x, lambda params, measurement: jnp.array([0.5, 0.5]))
    count = 8000
    measurement = jax.tree.map(lambda x: x[0], LINE)
    axis = np.linspace(-4, 4, 1601)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    energy = (8 * (y - x**2 - 0.2)) ** 2 + (0.4 * x - 0.2) ** 2 + ((x - 0.5) ** 2 + (y - 0.3) ** 2) / 0.25
    exact = np.log(np.exp(-energy / 2).sum() * (axis[1] - axis[0]) ** 2 / (2 * np.pi * 0.25))
    shares = []
    for curved in (False, True):
        propose = particle.guided(PLANE, noise, bent_log_likelihood, bent_rows, curved=curved, iterations=4)
        start = jnp.broadcast_to(jnp.array([[0.5, 0.3]]), (count, 2))
        step = jax.jit(particle.filter_step(particle.Model(PLANE, propose)), compiler_options=QUICK)
        _, info = step(None, particle.init(start), measurement, key=jax.random.key(5))
        shares.append(float(info.ess) / count)
        assert abs(float(info.log_likelihood) - exact) < 4.5 * np.sqrt((1 / shares[-1] - 1) / count) + 1e-3
    assert 1 - shares[1] < 0.5 * (1 - shares[0])
