"""The pieces of Sato 2024's figures."""

import numpy as np
import pytest

from jaxest import reproduce
from jaxest.reproduce.sato2024 import frequency, reach, rod


@pytest.mark.slow
def test_the_filter_loses_3_db_where_the_paper_finds_it():
    rows = reproduce.parts("sato2024")["fig9"](reproduce.Choice(), lambda message: None).rows
    found = {row.condition: row.value for row in rows}
    assert found["N = 3, M = 5, forces smoothed too"] == pytest.approx(0.3, abs=0.02)
    # A wider window loses sooner, a higher degree later; averages keep what the centre's fit loses.
    assert found["N = 10, M = 3, forces smoothed too"] < found["N = 5, M = 3, forces smoothed too"]
    assert found["N = 5, M = 3, forces smoothed too"] < found["N = 5, M = 5, forces smoothed too"]
    assert found["N = 10, M = 3, averaged (ours)"] > 0.25
    assert frequency._lengths(0.01, 3, 5)[0] == pytest.approx(1, abs=1e-3)


def test_a_target_is_within_reach_and_above_its_box():
    from jaxest.kinematics import modular
    from jaxest.simulate import manipulator

    sticks = manipulator.draw(4)
    robot = modular.assemble(sticks.assembly, sticks.links)
    target, box = reach._placed(robot, 4)
    np.testing.assert_allclose(target - box, [0, 0, 0.09], atol=1e-12)
    assert np.linalg.norm(target[:2]) > 0.2


def test_what_is_within_an_ellipsoid_is_counted():
    turn = np.tile(np.array([1.0, 0, 0, 0]), (2, 1))
    found = rod.onsite_batch.Estimate(
        np.array([[1.0, 0, 0], [0, 0, 0]]), turn, np.tile(0.1 * np.eye(6), (2, 1, 1)),
        *[None] * 7,
    )  # fmt: skip
    errors = rod.off(found, np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)))
    np.testing.assert_allclose(errors.distance, [1000, 0])
    assert errors.placed.tolist() == [False, True]  # 1 / 0.1 is more than 7.8
    assert errors.turned.all()


@pytest.mark.slow
@pytest.mark.paper
def test_two_assemblies_reach_their_boxes():
    """The gripper is within 10 mm of the target and the ball falls into the box, before and after rebuilding."""
    for seed in (11, 12):
        one = reach.once(seed)
        assert one.distance < 10
        assert one.inside


@pytest.mark.slow
def test_a_calibrated_rod_is_found():
    """Of a short recording: what is left of raw sensors, and no more than the paper's 3 mm of calibrated ones."""
    found = reproduce.parts("sato2024")["fig5"](reproduce.Choice(small=True, seed=1), lambda message: None)
    values = {(row.metric, row.condition): row.value for row in found.rows}
    calibrated = values["position error, median", "calibrated, whole recording"]
    assert calibrated < 3
    assert calibrated < values["position error, median", "accelerometers not calibrated, live"] / 3
