"""What every smoother keeps: `smooth(params, state0, measurements)` with leaves (T, ...) in and out; a row each.

In float64, two programs a row: a batch of smoothings and a batch of gradients.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_contract import QUICK, at, close, masked, same, scalar, sensors, stacked, unreported

from jaxest.filters import attitude
from jaxest.systems import orientation
from jaxest.types import NON_FINITE, OK

STEPS = 14
BATCH = 8


class Row(NamedTuple):
    name: str
    smooth: Callable
    """(params, state0, measurements) -> infos"""
    init: Callable
    params: Any
    draw: Callable
    """key -> measurements"""


def simulated(key):
    params = jax.tree.map(jnp.asarray, orientation.build().default_params)
    return orientation.simulate(params, key=key, steps=STEPS)[0]


ROWS = [
    Row(
        "attitude",
        partial(attitude.smooth, block=4),  # the last block is not full
        attitude.ekf.init,
        attitude.ekf.Params(),
        simulated,
    )
]


class Case(NamedTuple):
    row: Row
    params: Any
    measurements: Any
    others: Any
    whole: Callable
    """A batch of smoothings."""
    slopes: Callable
    """A batch of gradients of `scalar`, in parameters and in the sensors' values."""

    def runs(self, *cases):
        padded = [*cases, *[cases[0]] * (BATCH - len(cases))]
        out = self.whole(*stacked(padded))
        return [at(out, i) for i in range(len(cases))]


@pytest.fixture(params=ROWS, ids=[row.name for row in ROWS])
def case(request, x64):
    return case_of(request.param.name)


@cache
def case_of(name):
    row = next(row for row in ROWS if row.name == name)
    params = jax.tree.map(partial(jnp.asarray, dtype=jnp.float64), row.params)

    def one(params, measurements):
        return row.smooth(params, row.init(params), measurements)

    def slope(params, measurements):
        values = {name: getattr(measurements, name).value for name in sensors(measurements)}

        def loss(params, values):
            full = {name: getattr(measurements, name)._replace(value=value) for name, value in values.items()}
            return scalar(one(params, measurements._replace(**full)))

        return jax.grad(loss, (0, 1))(params, values)

    programs = (jax.jit(jax.vmap(fn), compiler_options=QUICK) for fn in (one, slope))
    return Case(row, params, row.draw(jax.random.key(1)), row.draw(jax.random.key(2)), *programs)


def test_a_batch_is_a_loop_and_gives_a_row_for_each_measurement(case):
    louder = jax.tree.map(lambda x: 1.2 * x, case.params)
    settings = [(case.params, case.measurements), (louder, case.measurements), (case.params, case.others)]
    for (params, measurements), infos in zip(settings, case.runs(*settings), strict=True):
        assert {np.shape(x)[0] for x in jax.tree.leaves(infos)} == {STEPS}
        assert np.all(np.asarray(infos.status) == OK)
        close(case.row.smooth(params, case.row.init(params), measurements), infos, factor=4096.0)


def test_what_is_masked_does_not_exist(case):
    rows = [0, 3, 4, 8]
    for name in sensors(case.measurements):
        hidden = [masked(case.measurements, name, rows, value) for value in (0.0, np.nan, np.inf, 1e30, -3.0)]
        reference, *results = case.runs(*((case.params, each) for each in hidden))
        for result in results:
            same(result, reference)


def test_a_valid_value_that_is_not_finite_is_left_out_and_reported(case):
    for name in sensors(case.measurements):
        hidden = masked(case.measurements, name, [6], np.nan)
        valid = getattr(case.measurements, name).valid
        visible = hidden._replace(**{name: getattr(hidden, name)._replace(valid=valid)})
        found, expected = case.runs((case.params, visible), (case.params, hidden))
        assert np.flatnonzero(np.asarray(found.status)).tolist() == [6]
        assert int(found.status[6]) == NON_FINITE
        same(unreported(found), unreported(expected))


@pytest.mark.slow  # compiles for half a minute
def test_gradient_is_the_finite_difference_and_none_leads_to_what_is_masked(case):
    rows, names = [0, 3, 4, 8], sensors(case.measurements)
    hidden = [(case.params, masked(case.measurements, name, rows, np.nan)) for name in names[:2]]
    gradients = case.slopes(*stacked(hidden))
    for k, name in enumerate(names[:2]):
        gradient = at(gradients, k)
        assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(gradient))
        assert np.all(np.asarray(gradient[1][name])[rows] == 0)
        assert np.any(np.asarray(gradient[1][name])[5] != 0)
    gradient = at(case.slopes(*stacked([(case.params, case.measurements)] * 2)), 0)
    random, h = np.random.default_rng(2), 1e-5
    base = case.params, {name: getattr(case.measurements, name).value for name in names}
    directions = [jax.tree.map(lambda x: np.asarray(x) * random.normal(size=np.shape(x)), base) for _ in range(4)]

    def moved(direction, by):
        params, values = jax.tree.map(lambda x, d: x + by * d, base, direction)
        full = {name: getattr(case.measurements, name)._replace(value=values[name]) for name in names}
        return params, case.measurements._replace(**full)

    def differences(h):
        totals = [scalar(result, np) for result in case.runs(*(moved(d, by) for d in directions for by in (h, -h)))]
        return [(totals[2 * i] - totals[2 * i + 1]) / (2 * h) for i in range(len(directions))]

    for direction, near, far in zip(directions, differences(h), differences(2 * h), strict=True):
        products = jax.tree.map(lambda g, d: np.sum(np.asarray(g) * d), gradient, direction)
        np.testing.assert_allclose(sum(jax.tree.leaves(products)), (4 * near - far) / 3, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", ["float32", "float64"])
def test_the_dtype_of_the_input_stays(case, name):
    def cast(tree):
        return jax.tree.map(lambda x: np.asarray(x, name if np.issubdtype(x.dtype, np.floating) else x.dtype), tree)

    params, measurements = cast(case.params), cast(case.measurements)
    out = jax.eval_shape(lambda p, m: case.row.smooth(p, case.row.init(p), m), params, measurements)
    assert {str(x.dtype) for x in jax.tree.leaves(out) if jnp.issubdtype(x.dtype, jnp.floating)} == {name}
