"""A live program gives the numbers of the step, whether it became one kernel or not; trees survive as words."""

from collections import Counter
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy import special
from test_contract import ROWS

from jaxest import live
from jaxest.live.compiled import LARGEST, is_small
from jaxest.live.words import layout


class State(NamedTuple):
    position: object
    count: object
    seen: object


class Measurement(NamedTuple):
    matrix: object
    valid: object
    dt: object


STATE = State(jnp.arange(1.0, 5.0) / 3, jnp.int32(3), jnp.array([True, False]))
TEMPLATE = Measurement(np.eye(4) + 0.1, np.array([True, False, True, True]), np.zeros(()))


def measurements(count):
    rng = np.random.default_rng(0)
    for _ in range(count):
        yield Measurement(rng.normal(size=(4, 4)) + 3 * np.eye(4), rng.random(4) < 0.5, rng.random(()))


def stepping(work):
    """A step whose state and info depend on `work(position, matrix)`."""

    def step(params, state, measurement, *, key=None):
        found = jnp.where(measurement.valid, work(state.position, measurement.matrix), params)
        position = jnp.tanh(state.position + measurement.dt * found)
        after = State(position, state.count + 1, ~state.seen)
        return after, {"found": found, "same": position, "fixed": jnp.zeros(3), "given": state.position}

    return step


def compare(step, state=STATE, template=TEMPLATE, count=5, **options):
    """Drive a program and the plain step side by side; whether it is one kernel."""
    program = live.program(step, jnp.float32(0.5), state, template, **options)
    plain = jax.jit(lambda state, measurement: step(jnp.float32(0.5), state, measurement, **options))
    carry = program.start(state)
    for measurement in measurements(count):
        carry, info = program.call(carry, measurement)
        state, expected = plain(state, measurement)
        for a, b in zip(jax.tree.leaves((program.state(carry), info)), jax.tree.leaves((state, expected)), strict=True):
            agree(a, b, factor=32)
    return program.one_kernel


def agree(a, b, factor):
    """Equal to some eps of the largest entry; what is no real number to the last bit."""
    assert (a.dtype, a.shape) == (b.dtype, b.shape)
    eps = np.finfo(b.dtype).eps if np.issubdtype(b.dtype, np.floating) else 0
    np.testing.assert_allclose(a, b, rtol=0, atol=factor * eps * max(1, np.abs(b).max(initial=0)))


def many(x, matrix):
    """Nearly all that one kernel may have."""
    i = jax.lax.bitcast_convert_type(x, jnp.int32)
    i = (jax.lax.population_count(i) ^ (i >> 3)) | (i << 1) & ~jax.lax.clz(i)
    i = jnp.remainder(jnp.abs(i) + jax.lax.shift_right_logical(i, 2), 7)
    y = (
        matrix @ x
        + jnp.sin(x) * jnp.cos(x)
        + jnp.tan(x / 4)
        + jnp.arctan2(x, 1 + x**2)
        + jnp.cbrt(x)
        + jnp.expm1(-(x**2))
    )
    y = y + jnp.log1p(x**2) + jnp.log(2 + x**2) + jnp.exp(-jnp.abs(x)) + jnp.sqrt(1 + x**2) + jax.lax.rsqrt(2 + x**2)
    y = y + special.erf(x) + special.erfinv(x / 9) + special.erfc(x) + special.gammaln(2 + x**2) + jax.nn.sigmoid(x)
    y = y + jnp.floor(x) + jnp.ceil(x) + jnp.round(x) + jnp.sign(x) + jnp.nextafter(x, x + 1) + (1 + x**2) ** 1.5
    y = (
        y.at[i % 4].add(x)
        + jnp.cumsum(x)
        + jnp.flip(x)[i % 4]
        + jnp.max(y)
        + jnp.argmin(x)
        + jnp.any(x > 1)
        + jnp.isinf(x)
    )
    y = (
        jax.lax.cond(y[0] > 0, lambda y: y + 1, lambda y: y * 2, y)
        + jnp.pad(x[1:], (0, 1))
        + jax.lax.clamp(0.0, x, 1.0)
    )
    y = jax.lax.while_loop(lambda c: c[0] < 3, lambda c: (c[0] + 1, c[1] @ matrix / 9 + jnp.outer(x, x)[c[0]]), (0, y))[
        1
    ]
    y = jax.lax.optimization_barrier(y) + jax.lax.switch(i[0] % 3, [jnp.sin, jnp.cos, jnp.negative], x)
    return jax.lax.dynamic_update_slice(y, x[:1], (i[1] % 4,)) + jax.random.normal(jax.random.key(1), (4,))


def test_a_step_of_all_that_is_able_is_one_kernel_with_its_numbers():
    assert compare(stepping(many))


@pytest.mark.parametrize(
    "work",
    [
        lambda x, m: jnp.linalg.cholesky(m @ m.T)[0],
        lambda x, m: jnp.sort(m[0]) + jax.lax.top_k(x, 4)[0],
        lambda x, m: jnp.abs(jnp.fft.fft(m[0])),
        lambda x, m: (jnp.ones((4, 300)) @ (jnp.ones((300, 300)) * 1e-4)) @ jnp.ones(300) * x,
        lambda x, m: x + jnp.sum(jnp.sin(jnp.arange(LARGEST + 1.0) * m[0, 0])) / LARGEST,
        lambda x, m: jax.pure_callback(lambda x: np.asarray(x) * 2, jax.ShapeDtypeStruct((4,), x.dtype), x),
    ],
    ids=["lapack", "sorting", "fft", "large product", "large array", "callback"],
)
def test_what_is_none_is_compiled_as_ever(work):
    assert not compare(stepping(work))


def test_words_hold_64_bits_too(x64):
    state = STATE._replace(position=STATE.position.astype(jnp.float64), count=jnp.int64(2**40))

    def step(params, state, measurement, *, key=None):
        position = state.position + measurement.matrix[0] * 1e-12
        return State(position, state.count + 2**33, ~state.seen), {"position": position}

    assert compare(step, state, count=3)


def test_a_state_that_words_cannot_hold_is_carried_as_it_is():
    class Keyed(NamedTuple):
        position: object
        key: object

    def step(params, state, measurement, *, key=None):
        one, two = jax.random.split(state.key)
        position = state.position + jax.random.normal(one, (4,)) + jax.random.normal(key, (4,))
        return Keyed(position, two), {"position": position}

    state = Keyed(jnp.zeros(4), jax.random.key(3))
    program = live.program(step, None, state, TEMPLATE, key=jax.random.key(1))
    carry = program.start(state)
    for measurement in measurements(3):
        carry, info = program.call(carry, measurement)
        state, expected = step(None, state, measurement, key=jax.random.key(1))
        np.testing.assert_allclose(info["position"], expected["position"], atol=1e-6)
    assert not program.one_kernel
    assert layout({"key": state.key}) is None
    assert layout({"z": np.zeros(2, np.complex64)}) is None
    assert layout({"byte": np.zeros(2, np.int8)}) is None


def test_a_state_of_other_dtypes_is_cast():
    program = live.program(stepping(lambda x, m: m[0]), jnp.float32(0), STATE, TEMPLATE)
    given = STATE._replace(position=np.arange(4), count=3)
    state = program.state(program.start(given))
    assert (state.position.dtype, state.count.dtype) == (jnp.float32, jnp.int32)
    np.testing.assert_array_equal(state.position, np.arange(4))


def test_a_measurement_of_another_shape_is_refused():
    program = live.program(stepping(lambda x, m: m[0]), jnp.float32(0), STATE, TEMPLATE)
    with pytest.raises(ValueError, match=r"^\.matrix: got an array of shape \(1, 1\), expected \(4, 4\)"):
        program.call(program.start(STATE), TEMPLATE._replace(matrix=np.ones((1, 1))))


def test_a_large_state_is_carried_as_it_is():
    state = STATE._replace(position=jnp.ones(LARGEST))

    def step(params, state, measurement, *, key=None):
        position = state.position + measurement.dt
        return State(position, state.count + 1, ~state.seen), {"first": position[0]}

    assert not compare(step, state, count=2)


def test_it_is_traced_once():
    traces = Counter()

    def step(params, state, measurement, *, key=None):
        traces["step"] += 1
        return state + measurement.dt, {"state": state}

    program = live.program(step, None, jnp.float32(1), TEMPLATE)
    carry = program.start(jnp.float32(1))
    for measurement in measurements(10):
        carry, _ = program.call(carry, measurement)
    assert traces["step"] == 1


def test_what_was_given_out_stays_as_it_was():
    program = live.program(stepping(lambda x, m: m[0]), jnp.float32(0), STATE, TEMPLATE)
    carry, infos = program.start(STATE), []
    for measurement in measurements(3):
        carry, info = program.call(carry, measurement)
        infos.append((info, jax.tree.map(np.copy, info)))
    for found, copied in infos:
        jax.tree.map(np.testing.assert_array_equal, found, copied)
    base = infos[0][0]["found"].base
    while base.base is not None:
        base = base.base
    assert base.size == 3 * 4 + 3  # of the info alone: found, same, fixed and given


def test_a_program_is_read_for_what_it_has():
    small = "%1 = stablehlo.add %0, %0 : tensor<4xf32>\n%2 = stablehlo.sine %1 : tensor<4xf32>"
    assert is_small(small)
    assert not is_small(small + "\n%3 = stablehlo.custom_call @lapack(%2) : (tensor<4xf32>) -> tensor<4xf32>")
    assert not is_small(small + f"\n%3 = stablehlo.iota dim = 0 : tensor<{LARGEST + 1}xf32>")
    product = (
        "\n%3 = stablehlo.dot_general %2, %1, contracting_dims = [1] x [0] : (tensor<{0}xf32>, tensor<{0}xf32>) -> "
    )
    assert is_small(small + product.format("40x40") + "tensor<40x40xf32>")
    assert not is_small(small + product.format("41x41") + "tensor<41x41xf32>")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["pair", "rls", "onsite", "onsite_chain", "particle_bootstrap", "deflection_guided", "slam"]
)
def test_estimators_have_their_numbers(name):
    row = next(row for row in ROWS if row.name == name)
    system, key = row.build(), jax.random.key(5)
    params = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), system.default_params)
    drawn, _ = system.simulate(params, key=jax.random.key(1), steps=8, **row.simulate)
    drawn = jax.tree.map(np.asarray, drawn)
    state = system.init(params, key=key)
    program = live.program(system.step, params, state, jax.tree.map(lambda x: x[0], drawn), key=key)
    plain = jax.jit(lambda state, measurement: system.step(params, state, measurement, key=key))
    carry = program.start(state)
    for i in range(8):
        measurement = jax.tree.map(lambda x, i=i: x[i], drawn)
        carry, info = program.call(carry, measurement)
        state, expected = plain(state, measurement)
        for a, b in zip(jax.tree.leaves((program.state(carry), info)), jax.tree.leaves((state, expected)), strict=True):
            agree(a, b, factor=4096)
    assert program.one_kernel == (name != "slam")
