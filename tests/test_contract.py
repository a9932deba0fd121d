"""What every estimator keeps, whatever it estimates: a new one adds a row to `ROWS`.

A row's system is driven on what its own `simulate` draws, in float64. Four programs are compiled a row and shared by
the tests: the live step, a run of half the length, a batch of whole runs and a batch of gradients. Equality is to
rounding: two programs that compute the same formula may fuse it differently.
"""

import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from deflection_models import FEW, hanging
from deflection_models import build as bent_arm
from kalman_models import build as kalman_body
from onsite_models import chain, pose, position, rotation, window
from particle_models import GUIDED
from particle_models import build as particle_arm
from posture_models import fused, paired, pairs
from quick_compile import FULL, QUICK
from slam_models import aligned, shaken, tiny

from jaxest import kinematics
from jaxest.filters import attitude, bingham_linear, complementary, kalman, resampling, rls, run
from jaxest.io.checkpoint import load_state, save_state
from jaxest.systems import deflection, orientation, slam_chain, torque
from jaxest.types import NON_FINITE, OK, Reading, System

PENDULUM = """<mujoco><worldbody><body><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02"
mass="1"/></body></worldbody></mujoco>"""


def pendulum():
    system = torque.build(kinematics.load(PENDULUM))
    given = system.default_params
    mean, variance = np.array([0.5, 0.1, 0.8]), np.array([1e-4, 1e-2, 1.0])
    wide = dict.fromkeys(("position", "velocity", "torque", "sensor"), np.full(1, 1e-4))
    return system._replace(default_params=given._replace(mean=mean, variance=variance, **wide))


class Row(NamedTuple):
    name: str
    build: Callable[[], System]
    simulate: Mapping[str, Any] = MappingProxyType({})
    """Options of `simulate`, beside `key` and `steps`."""
    differentiable: bool = True
    """False for an estimator whose gradient is tested by its score, or that jumps from plane to plane."""
    factor: float = 256.0
    """Eps of each leaf's largest entry to which two programs agree; more where small numbers are left of large ones."""
    slow: bool = False
    """A variant of another row, among the slow tests."""


SIX = ("gyroscope", "accelerometer")
ROWS = [
    Row("orientation_6", partial(orientation.build, None, SIX)),
    Row("orientation_9", orientation.build, slow=True),
    Row("orientation_projection", partial(orientation.build, None, SIX, update=complementary.projection), slow=True),
    Row("orientation_covariance", partial(orientation.build, covariance=True), {"shaking": 1.0}, slow=True),
    Row("attitude_ekf", partial(orientation.build, filter=attitude.ekf)),
    Row("attitude_decoupled", partial(orientation.build, filter=attitude.decoupled), slow=True),
    # Its descent is a gradient of length 1: where the gradient is small, rounding turns it.
    Row("attitude_madgwick", partial(orientation.build, filter=attitude.madgwick), factor=1024.0, slow=True),
    Row("pair", pairs, slow=True),  # posture is made of it
    Row("posture", fused),
    Row("posture_pairs", paired, slow=True),
    Row("kalman", kalman_body),
    Row("torque", pendulum, differentiable=False),  # its gradient compiles for a minute: test_system_torque has one
    Row("savitzky_golay", window),
    Row("bingham_linear", rotation),
    Row("bingham_linear_general", partial(rotation, bingham_linear.general), slow=True),
    Row("onsite", pose),
    Row("onsite_chain", chain, slow=True),
    Row("rls", position),
    Row("rls_pseudo_inverse", partial(position, rls.pseudo_inverse), slow=True),
    Row(
        "kalman_iterated",
        partial(kalman_body, iterations=40, tolerance=1e-11, loss=kalman.cauchy, gate=30.0),
        slow=True,  # its gradient compiles for half a minute
    ),
    Row("slam", partial(tiny, free=False), differentiable=False, factor=1e5),
    Row("slam_free", tiny, differentiable=False, factor=1e5, slow=True),  # looks for its root in each of a batch
    Row("slam_chain", partial(tiny, system=slam_chain), differentiable=False, factor=1e5, slow=True),
    Row("slam_align", aligned, differentiable=False, factor=1e5, slow=True),
    Row("slam_inertial", shaken, differentiable=False, factor=1e5, slow=True),
    Row("particle_bootstrap", particle_arm, differentiable=False),
    Row("deflection_guided", partial(bent_arm, deflection.guided, FEW), differentiable=False),
    Row("deflection_joints", hanging, differentiable=False, slow=True),
    Row(
        "particle_guided",
        partial(particle_arm, GUIDED, resampling.adaptive(resampling.stratified, 0.9)),
        differentiable=False,
        slow=True,
    ),
]
EAGERLY_SLOW = (
    "attitude_ekf",
    "bingham_linear",
    "deflection_guided",
    "deflection_joints",
    "kalman",
    "onsite",
    "particle_bootstrap",
    "particle_guided",
    "posture",
    "slam",
    "slam_free",
    "torque",
)
"""Their step is hundreds of small programs without `jit`, which take long to compile."""
STEEPLY_SLOW = ("attitude_ekf", "kalman", "onsite", "posture")
"""Their gradient compiles for a quarter to half a minute; others with the same filters are among the quick tests."""
STEPS = 12
BATCH = 8
# Compiles five times faster; what is compared with the live step is therefore also compiled differently.


class Case(NamedTuple):
    """A row's system with data, and its compiled programs; made and used with x64 on."""

    system: System
    params: Any
    measurements: Any
    others: Any
    """Measurements from another draw."""
    key: Any
    start: Callable
    """params -> state0"""
    live: Callable
    """One step."""
    half: Callable
    """A run of STEPS / 2."""
    whole: Callable
    """BATCH runs of STEPS from `start`."""
    slopes: Callable
    """Gradients of `scalar` of such runs, in parameters and in the sensors' values."""
    traces: list
    """One entry for each time `live` was traced."""

    def runs(self, *cases):
        """Results of up to BATCH (params, measurements), through the one compiled batch."""
        padded = [*cases, *[cases[0]] * (BATCH - len(cases))]
        out = self.whole(*stacked(padded))
        return [at(out, i) for i in range(len(cases))]

    def gradients(self, *cases):
        out = self.slopes(*stacked([*cases, *[cases[0]] * (4 - len(cases))]))
        return [at(out, i) for i in range(len(cases))]


def params(rows, slow=()):
    """Rows as parameters, those that are slow and those named among the slow tests."""
    return [
        pytest.param(row, id=row.name, marks=[pytest.mark.slow] if row.slow or row.name in slow else []) for row in rows
    ]


@pytest.fixture(params=params(ROWS))
def row(request):
    return request.param


@pytest.fixture
def case(row, x64):
    return case_of(row.name)


@cache
def case_of(name: str) -> Case:
    row = next(row for row in ROWS if row.name == name)
    system = row.build()
    params = jax.tree.map(partial(jnp.asarray, dtype=jnp.float64), system.default_params)
    draw = partial(system.simulate, params, steps=STEPS, **row.simulate)
    draw = jax.jit(lambda key, draw=draw: draw(key=key)[0], compiler_options=QUICK)
    key = jax.random.key(5)
    start = partial(system.init, key=key)

    traces: list = []

    def counted(params, state, measurement):
        traces.append(1)
        return system.step(params, state, measurement, key=key)

    def one(params, measurements):
        return run(system.step, params, start(params), measurements, key=key)

    def loss(params, values, measurements):
        full = {name: getattr(measurements, name)._replace(value=value) for name, value in values.items()}
        return scalar(one(params, measurements._replace(**full)))

    def slope(params, measurements):
        values = {name: getattr(measurements, name).value for name in sensors(measurements)}
        return jax.grad(loss, (0, 1))(params, values, measurements)

    return Case(
        system,
        params,
        draw(jax.random.key(1)),
        draw(jax.random.key(2)),
        key,
        start,
        jax.jit(counted, compiler_options=FULL),
        partial(run, system.step, key=key),
        jax.jit(jax.vmap(one), compiler_options=QUICK),
        jax.jit(jax.vmap(slope), compiler_options=QUICK),
        traces,
    )


def scalar(tree, xp=jnp):
    """A smooth number in which every floating leaf takes part."""
    leaves = [x for x in jax.tree.leaves(tree) if np.issubdtype(x.dtype, np.floating)]
    return sum(xp.sum(xp.sin(1 + 3 * x)) for x in leaves)


def close(actual, desired, factor):
    """Equal leaf by leaf to some eps of the largest entry of each leaf."""
    assert jax.tree.structure(actual) == jax.tree.structure(desired)
    for (path, a), d in zip(jax.tree_util.tree_leaves_with_path(actual), jax.tree.leaves(desired), strict=True):
        a, d = np.asarray(a), np.asarray(d)
        assert a.dtype == d.dtype
        exact = not np.issubdtype(d.dtype, np.floating)
        atol = 0 if exact else factor * np.finfo(d.dtype).eps * max(1.0, np.abs(d).max(initial=0))
        np.testing.assert_allclose(a, d, rtol=0, atol=atol, err_msg=jax.tree_util.keystr(path))


def same(actual, desired):
    """Equal to the last bit."""
    jax.tree.map(np.testing.assert_array_equal, actual, desired)


def at(tree, index):
    return jax.tree.map(lambda x: x[index], tree)


def stacked(trees):
    return jax.tree.map(lambda *rows: jnp.stack(rows), *trees)


def sensors(measurements):
    """Fields of a measurement that are readings."""
    return [name for name, value in measurements._asdict().items() if isinstance(value, Reading)]


def masked(measurements, name, rows, value):
    """The measurement with a sensor's rows invalid and its values there replaced."""
    reading = getattr(measurements, name)
    hidden = np.zeros(np.shape(reading.valid), bool)
    hidden[rows] = True
    wide = hidden.reshape(hidden.shape + (1,) * (np.ndim(reading.value) - hidden.ndim))
    changed = Reading(jnp.where(wide, value, reading.value), jnp.asarray(reading.valid) & ~hidden)
    return measurements._replace(**{name: changed})


def unreported(info):
    """The info without its status, and without those of the infos within it."""
    within = {name: unreported(x) for name, x in info._asdict().items() if "status" in getattr(x, "_fields", ())}
    return info._replace(status=0, **within)


def live_loop(case, params, measurements):
    state, infos = case.start(params), []
    for i in range(STEPS):
        state, info = case.live(params, state, at(measurements, i))
        infos.append(info)
    return state, stacked(infos)


@pytest.mark.parametrize("row", params(ROWS, EAGERLY_SLOW), indirect=True)
def test_jit_is_no_jit(case, row):
    state = compiled = case.start(case.params)
    for i in range(2):
        measurement = at(case.measurements, i)
        with jax.disable_jit():
            state, info = case.system.step(case.params, state, measurement, key=case.key)
        compiled, compiled_info = case.live(case.params, compiled, measurement)
        close((compiled, compiled_info), (state, info), row.factor)


def test_a_batch_of_scans_is_a_loop_of_live_steps(case, row):
    settings = [
        (case.params, case.measurements),
        (jax.tree.map(lambda x: 1.2 * x, case.params), case.measurements),
        (case.params, case.others),
    ]
    for (params, measurements), (state, history) in zip(settings, case.runs(*settings), strict=True):
        assert int(case.start(params).index) == 0
        assert int(state.index) == STEPS
        assert np.all(np.asarray(history.status) == OK)
        close((state, history), live_loop(case, params, measurements), row.factor)


def test_a_batch_calls_no_batched_lapack(case):
    # Where two such calls run at once on two threads, each waits for the other for ever; see docs/performance.md.
    text = case.whole.lower(*stacked([(case.params, case.measurements)] * BATCH)).as_text()
    for call in re.findall(r"custom_call @lapack.*", text):
        shapes = [shape.split("x")[:-1] for shape in re.findall(r"tensor<((?:\d+x)+)[a-z]\d+>", call)]
        assert all(set(shape[:-2]) <= {"1"} for shape in shapes if len(shape) > 1), call


def test_a_first_state_may_be_given_away(case):
    # What is donated to a compiled step may be written over: a leaf that is two would be given away twice.
    leaves = jax.tree.leaves(case.system.init(case.params, key=case.key))
    places = [leaf.unsafe_buffer_pointer() for leaf in leaves if not jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)]
    assert len(set(places)) == len(places)


def test_ten_calls_trace_once(case):
    state, _ = case.live(case.params, case.start(case.params), at(case.measurements, 0))
    first = len(case.traces)
    for i in range(1, 11):
        state, _ = case.live(case.params, state, at(case.measurements, i))
    assert len(case.traces) == first


def test_chunks_through_a_checkpoint_are_the_whole(case, row, tmp_path):
    half = STEPS // 2
    state0 = case.start(case.params)
    state, first = case.half(case.params, state0, at(case.measurements, slice(0, half)))
    save_state(tmp_path / "state.npz", state)
    state, second = case.half(
        case.params, load_state(tmp_path / "state.npz", state0), at(case.measurements, slice(half, None))
    )
    pieces = state, jax.tree.map(lambda *x: jnp.concatenate(x), first, second)
    close(pieces, case.runs((case.params, case.measurements))[0], row.factor)


def test_what_is_masked_does_not_exist(case):
    """Whatever stands in a masked reading, the numbers are the same to the last bit."""
    rows = [0, 3, 4, 8]
    names = sensors(case.measurements)
    for name in names:
        hidden = [masked(case.measurements, name, rows, value) for value in (0.0, np.nan, np.inf, 1e30, -3.0)]
        reference, *results = case.runs(*((case.params, each) for each in hidden))
        for result in results:
            same(result, reference)


@pytest.mark.parametrize("row", params((row for row in ROWS if row.differentiable), STEEPLY_SLOW), indirect=True)
def test_no_gradient_leads_to_what_is_masked(case):
    rows = [0, 3, 4, 8]
    names = sensors(case.measurements)
    hidden = [(case.params, masked(case.measurements, name, rows, np.nan)) for name in names]
    for name, gradient in zip(names, case.gradients(*hidden), strict=True):
        assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(gradient))
        assert np.all(np.asarray(gradient[1][name])[rows] == 0)
        assert np.any(np.asarray(gradient[1][name])[5] != 0)


def test_a_valid_value_that_is_not_finite_is_left_out_and_reported(case):
    for name in sensors(case.measurements):
        hidden = masked(case.measurements, name, [6], np.nan)
        valid = getattr(case.measurements, name).valid
        visible = hidden._replace(**{name: getattr(hidden, name)._replace(valid=valid)})
        (state, history), (expected_state, expected) = case.runs((case.params, visible), (case.params, hidden))
        assert np.flatnonzero(np.asarray(history.status)).tolist() == [6]
        assert int(history.status[6]) == NON_FINITE
        same((state, unreported(history)), (expected_state, unreported(expected)))


def test_a_step_back_in_time_takes_no_time_and_sees_nothing_and_says_so(case):
    def at_six(dt):
        return case.measurements._replace(dt=case.measurements.dt.at[6].set(dt))

    hidden = at_six(0.0)
    for name in sensors(hidden):
        hidden = masked(hidden, name, [6], 0.0)
    odd = [(case.params, at_six(dt)) for dt in (-1e-9, -10.0, np.nan, np.inf, -np.inf)]
    (expected_state, expected), *results = case.runs((case.params, hidden), *odd)
    for state, history in results:
        assert np.flatnonzero(np.asarray(history.status)).tolist() == [6]
        assert int(history.status[6]) == NON_FINITE
        same((state, unreported(history)), (expected_state, unreported(expected)))


@pytest.mark.parametrize("row", params((row for row in ROWS if row.differentiable), STEEPLY_SLOW), indirect=True)
def test_gradient_is_the_finite_difference(case):
    gradient = case.gradients((case.params, case.measurements))[0]
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(gradient))
    names = sensors(case.measurements)
    at_rest = case.params, {name: getattr(case.measurements, name).value for name in names}
    random = np.random.default_rng(2)
    # Each number is moved in proportion to itself, so that small parameters count as much as large readings.
    directions = [jax.tree.map(lambda x: np.asarray(x) * random.normal(size=x.shape), at_rest) for _ in range(4)]
    h = 1e-5

    def moved(direction, by):
        params, values = jax.tree.map(lambda x, d: x + by * d, at_rest, direction)
        full = {name: getattr(case.measurements, name)._replace(value=values[name]) for name in names}
        return params, case.measurements._replace(**full)

    def differences(h):
        totals = [scalar(result, np) for result in case.runs(*(moved(d, by) for d in directions for by in (h, -h)))]
        return [(totals[2 * i] - totals[2 * i + 1]) / (2 * h) for i in range(len(directions))]

    # Of fourth order: where little is known yet, the error of a plain difference is larger than its gradient's.
    for direction, near, far in zip(directions, differences(h), differences(2 * h), strict=True):
        slope = (4 * near - far) / 3
        products = jax.tree.map(lambda g, d: np.sum(np.asarray(g) * d), gradient, direction)
        np.testing.assert_allclose(sum(jax.tree.leaves(products)), slope, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", ["float32", "float64"])
def test_the_dtype_of_the_input_stays(case, name):
    def cast(tree):
        return jax.tree.map(lambda x: np.asarray(x, name if np.issubdtype(x.dtype, np.floating) else x.dtype), tree)

    params, measurements = cast(case.params), cast(case.measurements)
    state0 = jax.eval_shape(case.start, params)
    out = jax.eval_shape(partial(run, case.system.step, key=case.key), params, state0, measurements)
    assert {str(x.dtype) for x in jax.tree.leaves(out) if jnp.issubdtype(x.dtype, jnp.floating)} == {name}


def test_no_number_is_lost_without_a_word(case):
    """Any pattern of missing sensors, steps from microseconds to minutes, readings of any scale: what is not finite in
    an info has a status beside it. BATCH random cases a row."""

    def odd(seed):
        random = np.random.default_rng(seed)
        changed = {}
        for name in sensors(case.measurements):
            value, valid = getattr(case.measurements, name)
            scale = 10.0 ** random.uniform(-9, 9, (STEPS,) + (1,) * (np.ndim(value) - 1)) if seed % 2 else 1.0
            seen = random.random(np.shape(valid)) < random.uniform()
            changed[name] = Reading(jnp.asarray(value * scale), jnp.asarray(np.asarray(valid) & seen))
        spread = random.uniform(-4, 4) if seed % 4 > 1 else 0.0
        return case.measurements._replace(**changed, dt=case.measurements.dt * 10.0**spread)

    for _, history in case.runs(*((case.params, odd(seed)) for seed in range(BATCH))):
        told = np.asarray(history.status) != OK
        for path, leaf in jax.tree_util.tree_leaves_with_path(history):
            lost = ~np.isfinite(np.asarray(leaf, float)).reshape(STEPS, -1).all(axis=1)
            assert not np.any(lost & ~told), f"{jax.tree_util.keystr(path)} at steps {np.flatnonzero(lost & ~told)}"
