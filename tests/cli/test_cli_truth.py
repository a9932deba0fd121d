"""True joint coordinates at an estimate's times."""

import numpy as np

from jaxest.cli import truth
from jaxest.io import Stream


def test_a_truth_that_pauses_and_wraps_is_interpolated_where_it_is_known():
    """An angle that runs through half a turn, unknown for a while, and a slide beside it."""
    time = np.arange(200) / 100.0
    angle = (3.0 * time + np.pi) % (2 * np.pi) - np.pi
    value = np.stack([0.1 * time, angle], axis=1)
    value[40] = np.nan  # one sample is bridged
    value[100:130, 1] = np.nan  # a pause is not
    at = np.arange(0.005, 2.5, 0.01)
    found = truth.joints(Stream(time, value, ""), {0: 1, 1: 0}, [True, False], at)
    inside = at <= time[-1]
    away = (found[:, 0] - 3.0 * at + np.pi) % (2 * np.pi) - np.pi
    pause = (at > time[99]) & (at < time[130])
    np.testing.assert_allclose(away[inside & ~pause], 0, atol=1e-9)
    assert np.isnan(found[pause, 0]).all()
    np.testing.assert_allclose(found[inside, 1], 0.1 * at[inside], atol=1e-12)
    assert np.isnan(found[~inside]).all()
    nothing = truth.joints(Stream(time, np.full(200, np.nan), ""), {0: 0}, [True], at)
    assert np.isnan(nothing).all()
