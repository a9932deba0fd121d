"""The driver on a step whose numbers can be written down."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxest.filters import every, full, last, run


class State(NamedTuple):
    total: jax.Array
    index: jax.Array


class Info(NamedTuple):
    total: jax.Array
    seen: jax.Array


def step(params, state, measurement, *, key=None):
    total = params * state.total + measurement
    if key is not None:
        total = total + jax.random.normal(jax.random.fold_in(key, state.index))
    index = state.index + 1
    return State(total, index), Info(total, index)


START = partial(State, np.float32(0), np.int32(0))
MEASUREMENTS = np.arange(11, dtype=np.float32)
go = partial(run, step, np.float32(0.5))


def test_full_gives_a_row_for_each_measurement():
    state, history = go(START(), MEASUREMENTS)
    expected, rows = 0.0, []
    for value in MEASUREMENTS:
        expected = 0.5 * expected + value
        rows.append(expected)
    np.testing.assert_array_equal(history.total, rows)
    np.testing.assert_array_equal(history.seen, np.arange(1, 12))
    assert float(state.total) == rows[-1]
    assert go(START(), MEASUREMENTS[:0])[1].total.shape == (0,)


def test_last_and_a_reducer_of_ones_own():
    state, history = go(START(), MEASUREMENTS)
    end, kept = go(START(), MEASUREMENTS, history=last)
    assert jax.tree.map(float, (end, kept)) == (jax.tree.map(float, state), Info(float(state.total), 11.0))
    _, own = go(START(), MEASUREMENTS, history=lambda state, info: (state.index, info.total**2))
    np.testing.assert_array_equal(own[0], history.seen)
    np.testing.assert_array_equal(own[1], np.asarray(history.total) ** 2)


@pytest.mark.parametrize("period", [1, 4, 11, 20])
def test_every_keeps_each_kth_step(period):
    state, history = go(START(), MEASUREMENTS)
    end, (kept, valid) = go(START(), MEASUREMENTS, history=every(period))
    assert float(end.total) == float(state.total)
    assert len(valid) == -(-11 // period)
    np.testing.assert_array_equal(kept.seen[valid], np.arange(period, 12, period))
    np.testing.assert_array_equal(kept.total[valid], history.total[period - 1 :: period])


def test_every_counts_from_the_state_and_not_from_the_chunk():
    whole = go(START(), MEASUREMENTS, history=every(4))[1]
    state, pieces = START(), []
    for rows in (slice(0, 3), slice(3, 9), slice(9, 11)):
        state, piece = go(state, MEASUREMENTS[rows], history=every(4))
        pieces.append(np.asarray(piece.value.total)[np.asarray(piece.valid)])
    np.testing.assert_array_equal(np.concatenate(pieces), whole.value.total[whole.valid])


def test_memory_is_that_of_what_is_kept():
    def wide(state, info):
        return info.total * jnp.ones(100, jnp.float32)

    def bytes_needed(history):
        used = jax.jit(lambda m: go(START(), m, history=history)).lower(np.zeros(1000, np.float32)).compile()
        analysis = used.memory_analysis()
        return analysis.temp_size_in_bytes + analysis.output_size_in_bytes

    row, measurements = 400, 4000
    assert bytes_needed(wide) >= 1000 * row
    assert bytes_needed(last._replace(keep=wide)) < 5 * row + measurements
    assert bytes_needed(every(100, wide)) < 15 * row + 2 * measurements


def test_every_in_a_batch_whose_chunks_start_elsewhere():
    starts = State(np.zeros(3, np.float32), np.array([0, 1, 6], np.int32))
    _, (kept, valid) = jax.vmap(lambda s: go(s, MEASUREMENTS, history=every(4)))(starts)
    assert [np.asarray(kept.seen[i][valid[i]]).tolist() for i in range(3)] == [[4, 8], [4, 8, 12], [8, 12, 16]]


def test_the_key_is_that_of_the_whole_run():
    key = jax.random.key(3)
    state, whole = go(START(), MEASUREMENTS, key=key)
    middle, first = go(START(), MEASUREMENTS[:5], key=key)
    end, second = go(middle, MEASUREMENTS[5:], key=key)
    np.testing.assert_array_equal(np.concatenate([first.total, second.total]), whole.total)
    assert float(end.total) == float(state.total)
    assert float(state.total) != float(go(START(), MEASUREMENTS)[0].total)


def test_the_same_step_compiles_once():
    traces = []

    def counted(params, state, measurement, *, key=None):
        traces.append(1)
        return step(params, state, measurement)

    for scale in (0.1, 0.2, 0.3):
        run(counted, np.float32(scale), START(), MEASUREMENTS, history=full)
    assert len(traces) == 1


def test_wrong_arguments_are_named():
    for wrong, message in (
        ((np.zeros(3), np.zeros(4)), r"measurements\[1\]: got 4 rows, expected 3 as measurements\[0\] has"),
        ({"a": np.zeros(3), "dt": 0.1}, r"measurements\['dt'\]: got a scalar"),
        (None, "measurements: got no arrays"),
    ):
        with pytest.raises(ValueError, match=message):
            go(START(), wrong)
    with pytest.raises(ValueError, match="'index'"):
        go((np.zeros(2), np.zeros(2)), MEASUREMENTS)
    with pytest.raises(ValueError, match="got 0 steps"):
        go(START(), MEASUREMENTS[:0], history=last)
    with pytest.raises(ValueError, match="period: got 0"):
        every(0)
