"""Any pattern of missing sensors, any finite values, any scale: no number of an estimate is lost without a status.

`test_contract` asks this of 8 cases a row; here 128 cases a row and precision (29 rows, 2 precisions: 7424 cases of 12
steps), with values up to the largest that the precision holds.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_contract import BATCH, ROWS, STEPS, case_of, sensors, stacked

from jaxest.types import OK, Reading

CASES = 128


@cache
def data_of(name, dtype):
    """Measurements and parameters of a row in a precision, as NumPy arrays."""

    def cast(x):
        return np.asarray(x, dtype if np.issubdtype(x.dtype, np.floating) else x.dtype)

    case = case_of(name)
    return jax.tree.map(cast, (case.params, case.measurements))


def odd(measurements, seed, dtype):
    """Measurements with another scale, sign or constant in each sensor, holes, and steps of any length."""
    random = np.random.default_rng(seed)
    largest = np.log10(np.finfo(dtype).max) - 1
    changed = {}
    for name in sensors(measurements):
        value, valid = getattr(measurements, name)
        shape = (STEPS,) + (1,) * (np.ndim(value) - 1)
        reach = random.choice([0.0, 3.0, 9.0, largest])
        per_step = random.uniform(-reach, reach, shape if random.random() < 0.5 else (1,) * np.ndim(value))
        with np.errstate(over="ignore", under="ignore"):
            value = np.asarray(value * 10.0**per_step * random.choice([1, -1]), dtype)
        value = np.clip(np.nan_to_num(value), -np.finfo(dtype).max, np.finfo(dtype).max)
        if random.random() < 0.2:
            value = np.broadcast_to(value[:1] * random.choice([0, 1]), value.shape).astype(dtype)
        seen = random.random(np.shape(valid)) < random.choice([0, 0.1, 0.5, 0.9, 1])
        changed[name] = Reading(value, np.asarray(valid) & seen)
    spread = random.choice([0.0, -6.0, 3.0, 6.0])
    dt = np.asarray(measurements.dt * 10.0**spread * (random.random() > 0.1), dtype)
    return measurements._replace(**changed, dt=dt)


def lost(history):
    """Leaves that are not finite at steps whose status says nothing."""
    told = np.asarray(history.status) != OK
    found = {}
    for path, leaf in jax.tree_util.tree_leaves_with_path(history):
        if jnp.issubdtype(leaf.dtype, jnp.floating):
            bad = ~np.isfinite(np.asarray(leaf)).reshape(*told.shape, -1).all(axis=-1) & ~told
            if bad.any():
                found[jax.tree_util.keystr(path)] = int(bad.any(axis=1).sum())
    return found


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", [row.name for row in ROWS])
def test_no_number_is_lost_without_a_word_at_any_scale(name, dtype, x64):
    params, measurements = data_of(name, dtype)
    case, found = case_of(name), {}
    for first in range(0, CASES, BATCH):
        cases = stacked([odd(measurements, seed, dtype) for seed in range(first, first + BATCH)])
        _, history = case.whole(stacked([params] * BATCH), cases)
        for path, count in lost(history).items():
            found[path] = found.get(path, 0) + count
    assert not found, f"cases of {CASES} in which a number is lost: {found}"
