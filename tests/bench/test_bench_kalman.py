"""The benchmark of Kalman filters runs, and the loop beside it computes the same."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK

from jaxest import bench
from jaxest.bench.kalman import DT, EARTH, MODEL, Noise, beginning, simulated
from jaxest.bench.kalman_loop import Loop
from jaxest.filters import kalman, run
from jaxest.manifolds import quaternion


@pytest.mark.slow
@pytest.mark.parametrize("peers", [True, False])
def test_kalman(peers):
    found = list(bench.rows("kalman", peers=peers, small=True))
    timed = [row for row in found if row.metric != "compile"]
    assert [row.metric for row in timed][:3] == ["live step", "filter", "batched filter"]
    assert len(found) == 2 * len(timed)
    assert all(row.value > 0 for row in found)
    assert sum(row.ratio is not None for row in timed) == (5 if peers else 0)


@pytest.mark.slow
def test_the_loop_is_the_same_filter_and_smoother(x64):
    @partial(jax.jit, compiler_options=QUICK)
    def ours(noise, samples, start):
        _, filtered = run(kalman.filter_step(MODEL), noise, start, samples)
        return filtered, kalman.smooth(MODEL, noise, start, samples, iterations=1)

    for scale in (1.0, 1e-2):
        noise = Noise(*(scale * x for x in Noise()))
        samples = jax.tree.map(lambda x: x[0], simulated(noise, 1, 20, jnp.float64))
        loop = Loop(DT, *noise, EARTH)
        arrays = samples.gyroscope.value, samples.directions.value
        # The smoothers differ by terms of second order: measured 0.06 of the squared spread of the start.
        for found, expected, second in zip(
            ours(noise, samples, beginning(noise, jnp.float64)),
            (loop.filter(*arrays), loop.smooth(*arrays)),
            (0, 0.1),
            strict=True,
        ):
            turns, biases, covariances = expected
            matrices = jax.vmap(quaternion.to_matrix)(found.mean.orientation)
            allowed = 1e-11 + second * noise.turned**2
            np.testing.assert_allclose(matrices, turns, atol=allowed)
            np.testing.assert_allclose(found.mean.bias, biases, atol=allowed)
            np.testing.assert_allclose(found.covariance, covariances, atol=(1e-9 + second * scale) * covariances.max())
