"""What crooked axes and biases of the sensors do to a pose, against sensors that are bent by each entry in turn."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK

from jaxest.filters import last, run
from jaxest.manifolds import quaternion as quat
from jaxest.systems import onsite, onsite_batch
from jaxest.types import Reading

NAMES = ("gyroscope_a", "gyroscope_p", "accelerometer_a", "accelerometer_p")
BEND, SHIFT = 1e-6, 1e-5
TURN, PLACE = slice(0, 3), slice(3, 6)


def rod(steps, **options):
    """One rod with next to no noise."""
    system = onsite.build()
    params = jax.tree.map(np.float64, system.default_params)
    draw = partial(system.simulate, gyroscope=1e-4, accelerometer=5e-4, **options)
    return jax.jit(lambda key: draw(params, key=key, steps=steps)[0])(jax.random.key(5))


def shifts(solve, one):
    """What of a pose (6) moves by each entry of the sensors' matrices, (36, 6), and of the forces' biases, (6, 6)."""
    found = solve(one)

    def moved(sensor, matrix, offset):
        bent = {}
        for k, name in enumerate(NAMES):
            value, valid = getattr(one, name)
            bent[name] = Reading(value + jnp.where(sensor == k, value @ matrix.T + offset[None], 0), valid)
        other = solve(one._replace(**bent))
        turn = quat.local(found.quaternion, other.quaternion)
        return jnp.concatenate([turn, other.position - found.position])

    matrices = jnp.concatenate([BEND * jnp.eye(9).reshape(9, 3, 3)] * 4 + [jnp.zeros((6, 3, 3))])
    offsets = jnp.concatenate([jnp.zeros((36, 3)), SHIFT * jnp.eye(3), SHIFT * jnp.eye(3)])
    sensors = jnp.concatenate([jnp.repeat(jnp.arange(4), 9), jnp.repeat(jnp.arange(2, 4), 3)])
    every = np.asarray(jax.jit(jax.vmap(moved), compiler_options=QUICK)(sensors, matrices, offsets))
    return every[:36] / BEND, every[36:] / SHIFT


def turns(by):
    """What of a pose moves by turns of either accelerometer, (6, 6)."""
    entries = by[18:].reshape(2, 3, 3, 6)
    pairs = [(2, 1), (0, 2), (1, 0)]
    return np.concatenate([[one[i, j] - one[j, i] for i, j in pairs] for one in entries])


def ratio(said, true, part):
    """Of the traces."""
    return np.trace(said[part, part]) / np.trace(true[part, part])


@pytest.mark.slow  # a recording's solution for each entry
def test_a_recording_knows_what_each_entry_does(x64):
    one = rod(200)
    solve = partial(onsite_batch.solve, half_width=7)
    by, _ = shifts(lambda m: solve(m, onsite_batch.Prior(0.3, 0.3)), one)

    def covariance(gyro, acc, turn=0.0):
        return np.asarray(solve(one, onsite_batch.Prior(0.3, 0.3, gyro, acc, turn)).covariance)

    plain = covariance(0.0, 0.0)
    said = covariance(1e-3, 0.0), covariance(0.0, 1e-3), covariance(0.0, 0.0, 1e-3)
    for found, rows in zip(said, (by[:18], by[18:], turns(by)), strict=True):
        true = 1e-6 * rows.T @ rows
        # The sensitivity is that of Gauss and Newton, whose Hessian leaves out the residuals' second derivatives.
        np.testing.assert_allclose(
            found - plain, true, atol=0.03 * np.sqrt(np.outer(np.diag(true), np.diag(true))).max()
        )


@pytest.mark.slow
def test_the_live_estimate_knows_it_from_a_few_sums(x64):
    """Exact for the rotation and for biases; for the position by gyros' axes from the second moments only."""
    one = rod(1000)
    system = onsite.build()
    params = system.default_params._replace(gyroscope_bias=0.003)

    @jax.jit
    def solve(measurements, axes=(0.0, 0.0, 0.0), turn=0.0):
        given = params._replace(gyroscope_axes=axes[0], accelerometer_axes=axes[1], accelerometer_bias=axes[2])
        given = given._replace(accelerometer_turn=turn)
        return run(system.step, given, system.init(given), measurements, history=last)[1]

    by, shifted = shifts(solve, one)
    plain = np.asarray(solve(one).covariance)
    gyro, acc, bias = (np.asarray(solve(one, tuple(axes)).covariance) - plain for axes in np.eye(3))
    true = by[:18].T @ by[:18]
    assert ratio(gyro, true, TURN) == pytest.approx(1, abs=0.03)
    assert ratio(gyro, true, PLACE) == pytest.approx(1, abs=0.15)
    assert ratio(acc, by[18:].T @ by[18:], PLACE) == pytest.approx(1, abs=0.15)
    turned = solve(one, turn=1.0).covariance - plain
    assert ratio(turned, turns(by).T @ turns(by), PLACE) == pytest.approx(1, abs=0.1)
    np.testing.assert_allclose(bias[PLACE, PLACE], (shifted.T @ shifted)[PLACE, PLACE], rtol=0.05, atol=1e-9)
