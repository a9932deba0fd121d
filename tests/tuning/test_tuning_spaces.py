"""Parameter spaces and recordings: names, ties, frozen leaves, padding, windows."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tuning_models import KALMAN, Params, Seen, drawn

from jaxest import tuning
from jaxest.tuning import transforms as tr
from jaxest.types import InputError, Reading


class Sensor(NamedTuple):
    lam: object
    mounting: object = np.array([1.0, 0.0, 0.0, 0.0])


class Nested(NamedTuple):
    sensors: dict
    walk: object = 5.0
    count: object = 3


NESTED = Nested({"a": Sensor(np.array([0.0, -8.0, -8.0, 0.0])), "b": Sensor(np.array([0.0, -8.0, -8.0, 0.0]))})


def test_paths_name_leaves():
    expected = ("sensors.a.lam", "sensors.a.mounting", "sensors.b.lam", "sensors.b.mounting", "walk", "count")
    assert tuning.paths(NESTED) == expected


def test_free_tied_and_frozen(dtype):
    space = tuning.space(NESTED, {"walk": tr.positive, "sensors.a.lam+sensors.b.lam": None})
    assert space.size == 2
    assert space.names == ("walk", *(f"sensors.a.lam[{i}]" for i in range(4)))
    z = space.pack(NESTED, dtype)
    assert z.dtype == dtype
    there = space.unpack(z + jnp.asarray([0.1, 0.2], dtype))
    np.testing.assert_allclose(there.walk, 5 * np.exp(0.1), rtol=1e-6)
    np.testing.assert_allclose(there.sensors["a"].lam, np.array([0, -8, -8, 0]) * np.exp(0.2), rtol=1e-6)
    np.testing.assert_array_equal(there.sensors["a"].lam, there.sensors["b"].lam)
    np.testing.assert_array_equal(there.sensors["a"].mounting, NESTED.sensors["a"].mounting)
    assert there.sensors["a"].mounting.dtype == dtype
    assert there.count == 3
    np.testing.assert_allclose(space.pack(there, dtype), z + jnp.asarray([0.1, 0.2], dtype), rtol=1e-5)


def test_a_space_of_arrays_can_be_static():
    space = tuning.space(NESTED, ["walk"])
    assert jax.jit(lambda s, z: s.unpack(z).walk, static_argnums=0)(space, jnp.zeros(1)) == 1
    assert hash(space) != hash(tuning.space(NESTED, ["walk"]))


def test_a_tie_adds_its_gradients():
    space = tuning.space(NESTED, {"sensors.a.lam+sensors.b.lam": tr.bingham})

    def loss(z):
        params = space.unpack(z)
        return params.sensors["a"].lam[1] + 3 * params.sensors["b"].lam[2]

    np.testing.assert_allclose(jax.grad(loss)(space.pack(NESTED)), [-8 * 4], rtol=1e-5)


@pytest.mark.parametrize(
    ("free", "words"),
    [
        (["wolk"], ["'wolk'", "did you mean 'walk'"]),
        (["sensors.a.lm"], ["'sensors.a.lam'"]),
        (["walk", "walk+sensors.a.lam"], ["walk", "free twice"]),
        (["sensors.a.lam+walk"], ["'walk'", "shape ()", "(4,)"]),
        ({"walk": tr.bingham}, ["'walk'", "largest is 0"]),
        ({"sensors.a.lam": tr.positive}, ["'sensors.a.lam'", "above 0"]),
        ([], ["no parameter is free", "walk"]),
    ],
)
def test_bad_descriptions_are_refused(free, words):
    with pytest.raises(InputError) as error:
        tuning.space(NESTED, free)
    for word in words:
        assert word in str(error.value)


def test_padding_changes_nothing():
    objective = tuning.likelihood(KALMAN)
    short, long = drawn(1, steps=20), drawn(2, steps=33)
    params = Params()
    alone = [objective.loss(params, one, None) for one in (short, long)]
    batch = tuning.padded([short, long])
    assert batch.counts.shape == (2, 33)
    np.testing.assert_allclose(tuning.each(objective, params, batch), alone, rtol=1e-6)
    slopes = [jax.grad(lambda p, one=one: objective.loss(p, one, None))(params) for one in (short, long)]
    both = jax.grad(lambda p: jnp.sum(tuning.each(objective, p, batch)))(params)
    for one, other, found in zip(*slopes, both, strict=True):
        np.testing.assert_allclose(one + other, found, rtol=2e-5)


def test_unknown_truth_does_not_count():
    one = drawn(1, steps=10)
    truth = one.truth.copy()
    truth[:2], truth[5] = np.nan, np.nan
    found = tuning.recording(one.measurements, truth)
    np.testing.assert_array_equal(np.flatnonzero(~found.counts), [0, 1, 5])
    assert np.isfinite(found.truth).all()
    with pytest.raises(ValueError, match="leading axes"):
        tuning.recording(one.measurements, truth[:4])
    with pytest.raises(ValueError, match="got none"):
        tuning.padded([])


def test_windows_are_cut_from_the_recordings():
    steps = [50, 30, 41]
    batch = tuning.padded(
        [
            tuning.recording(
                Seen(Reading(100.0 * i + np.arange(n)[:, None], np.ones(n, bool)), np.ones(n)), np.zeros((n, 1))
            )
            for i, n in enumerate(steps)
        ]
    )
    windows = tuning.Windows(recordings=5, length=12, settle=4)
    firsts = set()
    for seed in range(30):
        found = tuning.sample_windows(batch, windows, jax.random.key(seed))
        value = np.asarray(found.measurements.value.value)[:, :, 0]
        assert value.shape == (5, 12)
        np.testing.assert_array_equal(np.diff(value, axis=1), 1)
        item, place = (value[:, 0] // 100).astype(int), value[:, 0] % 100
        assert set(item) == {0, 1, 2}
        assert (place + 12 <= np.array(steps)[item]).all()
        np.testing.assert_array_equal(np.asarray(found.counts), np.broadcast_to(np.arange(12) >= 4, (5, 12)))
        firsts |= {(int(i), int(p)) for i, p in zip(item, place, strict=True)}
    assert {p for i, p in firsts if i == 1} >= {0, 18}  # both ends of the shortest are reached
    with pytest.raises(ValueError, match="settle < length"):
        tuning.sample_windows(batch, windows._replace(length=51), jax.random.key(0))
