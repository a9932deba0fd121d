"""The search: minima of known functions, recovery of what data were drawn with, resuming, early stopping, reports."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from tuning_models import FILTER, KALMAN, Params, drawn, particles

from jaxest import tuning
from jaxest.filters import particle
from jaxest.io import checkpoint
from jaxest.tuning import descent

BATCH = tuning.padded([drawn(seed, steps=150) for seed in range(10)])
LIKELIHOOD = tuning.likelihood(KALMAN)
SPACE = tuning.space(Params(), ["walk", "seen"])
PROBLEM = tuning.Problem(LIKELIHOOD, SPACE)


def valley(z):
    return 1 + (1 - z[0]) ** 2 + 20 * (z[1] - z[0] ** 2) ** 2


def plateau(z):
    """Flat to the left, where a gain's logarithm no longer matters."""
    gain = jnp.exp(z[1])
    return 2 + jnp.tanh(z[0] / 3) ** 2 + 0.1 * (jnp.exp(-gain) + 0.2 * gain)


@pytest.mark.parametrize(
    ("function", "lowest", "at"),
    [(valley, 1.0, [1.0, 1.0]), (plateau, 2 + 0.1 * (0.2 + 0.2 * np.log(5)), [0.0, np.log(np.log(5))])],
    ids=["valley", "plateau"],
)
def test_lbfgs_finds_the_minimum_from_far(function, lowest, at):
    method = descent.lbfgs()
    starts = jax.random.normal(jax.random.key(4), (8, 2)) * jnp.array([[2.0, 2.5]])
    state = jax.vmap(lambda z: descent.init(method, z))(starts)
    step = jax.jit(jax.vmap(lambda s: descent.step(method, jax.value_and_grad(function), s)))
    for _ in range(80):
        before = state
        state, _ = step(state)
        assert (state.value <= before.value + 1e-6).all()
        if state.converged.all():
            break
    assert state.converged.all()
    np.testing.assert_allclose(state.value, lowest, rtol=1e-5)
    np.testing.assert_allclose(state.point, np.broadcast_to(at, (8, 2)), atol=0.02)


def bowl(z):
    """A root mean square's size and bend, as BROAD's is: float32 shows nothing of the last steps of a descent."""
    x, y = z[0] - 1, z[1] + 0.5
    return 0.0375 + 0.004 * (x**2 + 0.3 * x * y + 0.5 * y**2 + 0.3 * jnp.sin(z[0]) ** 4)


def shelf(z):
    """A steep wall down to a shelf, which falls slowly to a bottom far off: what the wall taught is too short there."""
    return 3 + 0.2 * jnp.logaddexp(0.0, 8 * z[0]) + 0.004 * jnp.sqrt(1 + (z[0] + 12) ** 2) + 0.05 * z[1] ** 2


def grained(function):
    """Add the rounding that a long recursion leaves, three eps, rough in where it is asked."""

    def rough(z):
        value = function(z)
        noise = 3 * jnp.finfo(z.dtype).eps * value * jnp.sin(1e5 * jnp.sum(z))
        return value + jax.lax.stop_gradient(noise)

    return rough


@pytest.mark.parametrize(
    ("function", "spare"), [(bowl, 5), (grained(bowl), 5), (plateau, 5), (grained(shelf), 8)],
    ids=["bowl", "rough bowl", "plateau", "rough shelf"],
)  # fmt: skip
def test_a_descent_ends_where_rounding_hides_the_rest_and_not_before(function, spare, dtype):
    """From 100 starts: all at the bottom, of plateaus as well, and done a few evaluations after they are there."""
    method = descent.lbfgs()
    starts = jax.random.normal(jax.random.key(7), (100, 2)) * jnp.array([[2.0, 2.5]])
    starts = jnp.clip(starts, -6, 6).astype(dtype)  # further off float32 shows no slope of the plateau
    state = jax.vmap(lambda z: descent.init(method, z))(starts)
    step = jax.jit(jax.vmap(lambda s: descent.step(method, jax.value_and_grad(function), s)))
    values, done = [], []
    for _ in range(60):
        state, _ = step(state)
        values.append(np.asarray(state.value))
        done.append(np.asarray(state.converged))
    assert done[-1].all()
    lowest = values[-1].min()
    np.testing.assert_allclose(values[-1], lowest, rtol=4e-6)
    there = np.argmax(np.array(values) <= lowest * (1 + 4e-6), axis=0)
    assert (np.argmax(done, axis=0) - there).max() <= spare


def test_values_that_are_not_finite_are_never_taken():
    method = descent.lbfgs(longest=4.0)

    def cliff(z):
        return jnp.where(z[0] > 0, z[0] - jnp.log(jnp.where(z[0] > 0, z[0], 1)), jnp.nan)

    state = descent.init(method, jnp.array([3.0]))
    step = jax.jit(lambda s: descent.step(method, jax.value_and_grad(cliff), s))
    for _ in range(40):
        state, _ = step(state)
        assert np.isfinite(state.value)
    np.testing.assert_allclose(state.point, [1.0], atol=1e-2)


@pytest.mark.parametrize(
    "transform", [optax.adam(0.2), optax.sgd(0.01), tuning.adam(0.2).transform], ids=["adam", "sgd", "own"]
)
def test_an_optimiser_of_optax_goes_down(transform):
    method = tuning.Method(transform)
    state = descent.init(method, jnp.array([-1.0, 2.0]))
    step = jax.jit(lambda s: descent.step(method, jax.value_and_grad(valley), s))
    for _ in range(50):
        state, _ = step(state)
    assert state.value < 0.2 * valley(jnp.array([-1.0, 2.0]))


@pytest.mark.parametrize("starts", [[[0.5, 0.0], [3.0, 0.0]], [[3.0, 0.0]]], ids=["one of two", "all"])
def test_a_start_that_is_not_finite_keeps_no_search_going(starts):
    def cliff(params, measurements):
        z = jnp.log(params.walk)
        return jnp.where(z > 2, jnp.nan, -1 - z**2)

    problem = tuning.Problem(tuning.density(cliff), SPACE)
    found = tuning.minimise(problem, tuning.take(BATCH, slice(0, 1)), starts=jnp.array(starts), evaluations=30)
    assert found.stopped == "converged"
    assert len(found.trace.value) < 20
    assert np.isfinite(found.values).tolist() == [start[0] < 2 for start in starts]


def test_noise_is_recovered_with_honest_errors():
    """The generating values lie within three standard errors, and starts far apart end at one optimum."""
    starts = tuning.disperse(SPACE, 4, key=jax.random.key(1), spread=1.5)
    found = tuning.minimise(PROBLEM, BATCH, starts=starts, evaluations=40)
    assert found.stopped == "converged"
    np.testing.assert_allclose(found.points, np.broadcast_to(found.point, (4, 2)), atol=0.01)
    curved = tuning.curvature(PROBLEM, found.point, BATCH)
    longer = tuning.curvature(PROBLEM, found.point, BATCH, worth=4.0 * len(BATCH.counts))
    np.testing.assert_allclose(longer.covariance, curved.covariance / 4, rtol=2e-3)  # nearer differences
    rows = tuning.estimates(PROBLEM, found.point, curved)
    for row, truth in zip(rows, (0.5, 1.0), strict=True):
        assert abs(row.value - truth) < 3 * row.sd
        assert row.sd < 0.1
        assert row.identified
        assert row.rise > 0
    np.testing.assert_allclose(curved.gradient, 0, atol=1e-2)


def test_starts_come_together_on_windows():
    starts = tuning.disperse(SPACE, 4, key=jax.random.key(1), spread=1.5)
    windows = tuning.Windows(10, 100, 20)
    optima, rough = tuning.warm_start(PROBLEM, BATCH, starts, windows=windows, key=jax.random.key(5), evaluations=40)
    assert optima.shape == (1, 2)
    np.testing.assert_allclose(rough.points, np.broadcast_to(optima, (4, 2)), atol=tuning.warm.APART)
    apart, rough = tuning.warm_start(PROBLEM, BATCH, starts, windows=windows, key=jax.random.key(5), evaluations=1)
    assert np.ptp(np.asarray(rough.points), axis=0).min() > 1  # stopped before they came together, in one valley
    assert apart.shape == (1, 2)


def test_optima_are_two_where_the_objective_rises_between():
    """And a plateau, which windows cannot tell from the bottom, is one with it: the whole says where to go on."""

    def hills(params, measurements):
        z = jnp.log(params.walk)
        weight = 0.01 if measurements.dt.shape[0] == 100 else 0.0  # windows see nothing of it
        return -1 - (z**2 - 1) ** 2 - weight * jnp.log(params.seen) ** 2

    problem = tuning.Problem(tuning.density(hills), SPACE)
    batch = tuning.padded([drawn(1, steps=100)])
    starts = jnp.array([[1.5, 3.0], [0.7, 0.1], [-1.5, 0.0]])
    windows = tuning.Windows(1, 50, 0)
    optima, _ = tuning.warm_start(problem, batch, starts, windows=windows, key=jax.random.key(0))
    found = sorted(optima.tolist())
    np.testing.assert_allclose(found, [[-1.0, 0.0], [1.0, 0.1]], atol=2e-3)


def test_a_kept_search_resumes_to_the_same_numbers(tmp_path):
    starts = tuning.disperse(SPACE, 2, key=jax.random.key(2), spread=0.5)
    method = tuning.lbfgs()
    whole = tuning.minimise(PROBLEM, BATCH, method=method, starts=starts, evaluations=8)
    file = tmp_path / "search.npz"
    tuning.minimise(
        PROBLEM, BATCH, method=method, starts=starts, evaluations=4,
        keep=lambda search: checkpoint.save_state(file, search, overwrite=True),
    )  # fmt: skip
    kept = checkpoint.load_state(file, tuning.begin(PROBLEM, method, starts))
    rest = tuning.minimise(PROBLEM, BATCH, method=method, search=kept, evaluations=8)
    assert int(kept.index) == 4
    for a, b in zip(jax.tree.leaves(whole.search), jax.tree.leaves(rest.search), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_one_trace_serves_all_evaluations():
    traces = []

    def counted(params, one, key):
        traces.append(1)
        return LIKELIHOOD.loss(params, one, key)

    problem = tuning.Problem(tuning.Objective(counted, likelihood=True), SPACE)
    tuning.minimise(problem, BATCH, evaluations=2)
    after = len(traces)
    tuning.minimise(problem, BATCH, evaluations=6)
    assert len(traces) <= 2 * after  # a second method object compiles again; evaluations do not


def test_held_out_recordings_stop_an_overfit():
    """One recording is fitted better and better while others, drawn with other noise, get worse."""
    fitted = tuning.padded([drawn(1, steps=40, walk=2.0)])
    other = tuning.padded([drawn(2, steps=40, walk=0.7)])
    found = tuning.minimise(
        PROBLEM, fitted, held_out=other, method=tuning.adam(0.05), evaluations=120, patience=8
    )  # fmt: skip
    assert found.stopped == "held out"
    held = found.trace.held_out[:, 0]
    assert found.value == pytest.approx(np.nanmin(held))
    assert held[-1] > found.value
    assert len(held) == np.nanargmin(held) + 1 + 8


def test_a_judge_draws_the_same_for_all_points():
    """Of an objective that is drawn a point that does not move has one held-out value, so that luck keeps none."""

    def drawn_square(params, one, key):
        return (params.walk - 1.0) ** 2 + jax.random.normal(key)

    problem = tuning.Problem(tuning.Objective(drawn_square, random=True), SPACE)
    batch = tuning.take(BATCH, slice(0, 1))
    found = tuning.minimise(problem, batch, held_out=batch, method=tuning.adam(0.0), evaluations=5,
                            key=jax.random.key(0))  # fmt: skip
    assert len(set(found.trace.value[:, 0].tolist())) == 5
    assert len(set(found.trace.held_out[:, 0].tolist())) == 1


def test_recordings_that_say_nothing_are_refused():
    nothing = BATCH._replace(counts=np.zeros_like(BATCH.counts))
    for name, batch, held_out in (("batch", nothing, None), ("held_out", BATCH, nothing)):
        with pytest.raises(ValueError, match=f"{name}: no step counts"):
            tuning.minimise(PROBLEM, batch, held_out=held_out)


def test_what_is_kept_without_backtracking_is_a_mean_with_growing_weights():
    method = tuning.adam(0.1)
    state, points = descent.init(method, jnp.array([2.0, 1.0])), []
    step = jax.jit(lambda s: descent.step(method, jax.value_and_grad(valley), s))
    for _ in range(6):
        state, info = step(state)
        points.append(info.point)
    np.testing.assert_allclose(state.average, np.average(points, axis=0, weights=np.arange(6)), rtol=1e-6)


@pytest.mark.slow
def test_mini_batches_of_a_particle_filter_come_near_the_exact_optimum():
    system = particles(particle.filter_step(FILTER._replace(resample=tuning.fading(FILTER.resample, 0.9))), 64)
    problem = tuning.Problem(
        tuning.likelihood(system, random=True), SPACE, windows=tuning.Windows(recordings=5, length=50)
    )
    start = (SPACE.pack(Params()) + jnp.array([0.8, -0.6]))[None]
    found = tuning.minimise(
        problem, BATCH, method=tuning.adam(0.08), starts=start, evaluations=80, key=jax.random.key(5)
    )  # fmt: skip
    exact = tuning.minimise(PROBLEM, BATCH, evaluations=30)
    sd = np.sqrt(np.diag(tuning.curvature(PROBLEM, exact.point, BATCH).covariance))
    # Windows of 50 of 150 steps, averaged over 40 evaluations: within a few standard errors, far from the start.
    assert (np.abs(np.asarray(found.point - exact.point)) < np.maximum(4 * sd, 0.1)).all()
    with pytest.raises(ValueError, match="key"):
        tuning.minimise(problem, BATCH, evaluations=1)
