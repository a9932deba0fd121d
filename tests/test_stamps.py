"""What a gap in time is."""

import numpy as np
import pytest

from jaxest import stamps


def test_one_lost_sample_is_no_gap_and_two_are():
    random = np.random.default_rng(0)
    time = np.arange(1000) / 100 + random.uniform(-1e-3, 1e-3, 1000)
    kept = np.ones(1000, bool)
    kept[[100, 300, 301, 500, 501, 502]] = False
    time = time[kept]
    np.testing.assert_array_equal(stamps.gaps(time), [298, 496])
    assert stamps.longest(time) == pytest.approx(0.025, rel=0.05)


@pytest.mark.parametrize("time", [[], [1.0], [1.0, 9.0]])
def test_a_few_stamps_have_no_gap(time):
    assert len(stamps.gaps(np.array(time))) == 0


def test_how_far_apart_what_is_known_stands_around_a_time():
    found = stamps.apart(np.array([0.0, 1.0, 3.0]), np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_array_equal(found, [np.inf, 0, 1, 0, 2, 0, np.inf])


def test_samples_around_a_time():
    rows = stamps.around(np.array([0.0, 1.0, 5.0]), np.array([-1.0, 0.5, 1.0, 4.0, 9.0]))
    np.testing.assert_array_equal(rows, [[0, 1], [0, 1], [0, 1], [1, 2], [1, 2]])
    time = np.array([0.0, 1.0, 2.0, 3.0, 7.0, 8.0])
    np.testing.assert_array_equal(stamps.near(time, np.array([0.5, 3.0, 3.1, 6.9, 7.5])), [1, 1, 0, 0, 1])
