"""The many-settings form of the complementary filter is the filter."""

import jax
import numpy as np

from jaxest.filters import complementary, last, run
from jaxest.filters.complementary import Imu, Params
from jaxest.filters.complementary_sweep import sweep
from jaxest.types import Reading


def test_it_ends_where_the_filter_ends(dtype):
    """Gaps, late first samples of vectors, padding, and settings from sluggish to quick."""
    random = np.random.default_rng(4)
    trials, steps = 3, 120
    gyr, acc, mag = random.normal(size=(3, trials, steps, 3)) * 0.5
    acc, mag = acc + np.array([3, 2, 9]), 10 * mag + np.array([10, -40, 5])
    valid = random.random((3, trials, steps)) > 0.15
    valid[1, 1, :7] = valid[2, 2, :11] = False
    valid[:, 0, 90:] = False
    dt = random.uniform(0.002, 0.05, (trials, steps))
    dt[0, 90:] = 0
    readings = [Reading(x.astype(dtype), v) for x, v in zip((gyr, acc, mag), valid, strict=True)]
    gains = Params(
        *(np.asarray(g, dtype) for g in ([0.1, 0.7, 3.0], [1e-4, 1e-3, 0.1], [1.0, 1.0, 0.5], [1.0, 0.7, 1.0]))
    )
    for magnetometer in (readings[2], None):
        measurements = Imu(readings[0], readings[1], magnetometer, dt.astype(dtype))

        def one(params, measured):
            return run(complementary.step, params, complementary.init(params), measured, history=last)[0]

        expected = jax.jit(jax.vmap(jax.vmap(one, (0, None)), (None, 0)))(gains, measurements)
        found = sweep(gains, measurements)
        tolerance = 1e-11 if dtype == "float64" else 3e-5
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            assert a.dtype == b.dtype
            np.testing.assert_allclose(a, b, atol=tolerance)
