"""Reports: standard errors, of what they come from, and what recordings cannot tell."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from tuning_models import KALMAN, Params, drawn

from jaxest import tuning

BATCH = tuning.padded([drawn(seed, steps=150) for seed in range(10)])
LIKELIHOOD = tuning.likelihood(KALMAN)
PROBLEM = tuning.Problem(LIKELIHOOD, tuning.space(Params(), ["walk", "seen"]))


@pytest.mark.slow
def test_standard_errors_are_those_of_repetitions():
    """The spread of the estimates over fresh data is what the Hessian claims, to its sampling error."""
    runs = 40
    batches = [tuning.padded([drawn(100 + 4 * run + i, steps=80) for i in range(4)]) for run in range(runs)]
    points, claims = [], []
    for batch in batches:
        found = tuning.minimise(PROBLEM, batch, evaluations=25)
        points.append(np.asarray(found.point))
        claims.append(np.diag(tuning.curvature(PROBLEM, found.point, batch).covariance))
    ratio = np.var(points, axis=0, ddof=1) / np.mean(claims, axis=0)
    # A variance of 40 draws has a relative standard deviation of sqrt(2 / 39) = 0.23.
    assert (np.abs(np.log(ratio)) < 3 * 0.23).all(), ratio


def test_what_cannot_be_told_apart_is_said():
    space = tuning.space(Params(), ["walk", "seen", "scale"])
    problem = tuning.Problem(LIKELIHOOD, space)
    found = tuning.minimise(problem, BATCH, evaluations=30)
    rows = {
        row.name: row for row in tuning.estimates(problem, found.point, tuning.curvature(problem, found.point, BATCH))
    }
    assert rows["walk"].identified
    assert not rows["seen"].identified
    assert not rows["scale"].identified
    assert np.isinf(rows["scale"].sd)


class Normal(NamedTuple):
    mean: object = 0.5
    sd: object = 1.0


class Numbers(NamedTuple):
    value: object
    dt: object


def numbers(*rows):
    return tuning.padded([tuning.recording(Numbers(np.asarray(row), np.ones(len(row)))) for row in rows])


@pytest.mark.parametrize("count", [1, 3])
def test_errors_of_an_objective_that_is_no_likelihood_need_recordings_that_differ(count):
    """The mean of recordings' means has their standard error; of one recording nobody knows how it differs."""
    rows = np.random.default_rng(0).normal(size=(count, 20)).astype(np.float32)
    objective = tuning.Objective(lambda params, one, key: jnp.mean((one.measurements.value - params.mean) ** 2))
    problem = tuning.Problem(objective, tuning.space(Normal(), {"mean": tuning.transforms.real}))
    z = jnp.asarray(rows.mean())[None]
    (row,) = tuning.estimates(problem, z, tuning.curvature(problem, z, numbers(*rows)))
    assert row.identified == (count > 1)
    expected = np.std(rows.mean(axis=1), ddof=1) / np.sqrt(count) if count > 1 else np.nan
    np.testing.assert_allclose(row.sd, expected, rtol=1e-3)


def normal(params, measurements):
    z = (measurements.value - params.mean) / params.sd
    return -jnp.sum(z * z / 2 + jnp.log(params.sd))


def tilted(params, measurements):
    """A mean that a number which nothing is known of hardly moves: along that number the density even rises."""
    far = jnp.log(params.sd)
    return -jnp.sum((measurements.value - params.mean - 0.003 * far) ** 2 - 1e-4 * far**2) / 2


def test_what_hardly_moves_with_an_unknown_is_known(dtype):
    rows = numbers(np.tile(np.asarray([-1, 1], dtype), 500))
    names = {"mean": tuning.transforms.real, "sd": tuning.transforms.positive}
    problem = tuning.Problem(tuning.density(tilted), tuning.space(Normal(0.0, 1.0), names))
    z = problem.space.pack(Normal(0.0, 1.0), dtype)
    mean, sd = tuning.estimates(problem, z, tuning.curvature(problem, z, rows))
    assert mean.identified
    assert np.isinf(sd.sd)
    # Where the other is, within a factor e, moves it by a tenth of its error.
    assert mean.sd == pytest.approx(np.hypot(1 / np.sqrt(1000), 0.003), rel=0.02)


def sine(params, measurements):
    """Of that argument, within which the values' spread does not matter."""
    return -jnp.sum((jnp.sin(0.3) - jnp.sin(100 * params.mean)) ** 2 + 0 * measurements.value) / 2


@pytest.mark.parametrize(
    ("density", "start", "free", "expected"),
    [
        (normal, Normal(0.5, 3e-3), {"mean": "real", "sd": "positive"}, (3e-3, 3e-3 / np.sqrt(2))),
        (normal, Normal(5e5, 3e5), {"mean": "real", "sd": "positive"}, (3e5, 3e5 / np.sqrt(2))),
        (sine, Normal(3e-3), {"mean": "real"}, (1 / (100 * np.cos(0.3)),)),
    ],
    ids=["small unit", "large unit", "bent"],
)
def test_errors_know_no_unit(density, start, free, expected, dtype):
    """Fisher's information is known; a number whose unit is small, and steep therefore, hides none beside it."""
    rows = numbers(start.mean + start.sd * np.tile(np.asarray([-1, 1], dtype), 500))
    names = {path: tuning.transforms.named(name) for path, name in free.items()}
    problem = tuning.Problem(tuning.density(density), tuning.space(start, names))
    z = problem.space.pack(start, dtype)
    found = tuning.estimates(problem, z, tuning.curvature(problem, z, rows))
    np.testing.assert_allclose([row.sd for row in found], np.array(expected) / np.sqrt(1000), rtol=0.02)
