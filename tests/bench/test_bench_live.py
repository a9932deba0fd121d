"""The live bench: which steps ran while the core was at its usual speed, and that all of it runs."""

import numpy as np
import pytest

from jaxest.bench import live


def test_steps_beside_slow_work_are_told_apart():
    yardstick = np.array([20, 21, 19, 220, 110, 20, 20, 29, 31, 20]) * 1e-6
    fed = live.Fed(None, 10, 0.0, np.zeros(10), yardstick)
    assert fed.usual().tolist() == [True, True, True, False, False, False, True, True, False, False]


@pytest.mark.slow
def test_half_a_second_gives_all_rows():
    rows = {row.metric: row for row in live.rows(peers=False, progress=lambda message: None, small=True)}
    first = rows["steps within 1 ms"]
    assert 0 <= first.value <= 100
    assert first.n == 500
    assert rows["samples that never arrived"].value == 0
    assert rows["steps within 1 ms, core at its usual speed"].n <= 500
    assert rows["step, 50 %"].value <= rows["step, 99 %"].value <= rows["step, longest"].value
