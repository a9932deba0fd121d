import numpy as np
import pytest

from jaxest.viz import joints


@pytest.mark.parametrize("known", [True, False])
def test_a_picture_is_written_with_and_without_reference_and_truth(tmp_path, known):
    time = np.linspace(0, 2, 50)
    mean = np.stack([np.sin(time), 3 + time], axis=1)  # the second goes beyond half a turn
    read = mean - 0.1
    read[10:20] = np.nan
    given = {"reference": read, "truth": mean + 2 * np.pi} if known else {}
    joints.draw(tmp_path / "a.png", time, mean, mean - 0.2, mean + 0.2, names=("a", "b"), title="t", **given)
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"


def test_whole_turns_are_taken_off():
    assert np.allclose(joints._beside(np.array([370.0, -350.0, 190.0]), 0.0), [10, 10, -170])
