"""The picture of a tuning is drawn from any number of starts, with gaps and with or without held-out recordings."""

import numpy as np
import pytest

from jaxest.viz import tuning


@pytest.mark.parametrize("starts", [1, 3])
@pytest.mark.parametrize("judged", [True, False])
def test_draw(tmp_path, starts, judged):
    rng = np.random.default_rng(0)
    values = rng.uniform(1, 9, (6, starts))
    values[0, 0] = np.nan
    points = rng.normal(size=(6, starts, 2))
    path = tmp_path / "a.png"
    tuning.draw(path, values, points, names=("gain", "offset"), best=0, held_out=values if judged else None, title="a")
    assert path.stat().st_size > 5000
    assert path.read_bytes()[:4] == b"\x89PNG"
