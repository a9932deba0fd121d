"""The pieces of Santaera 2015's table and figures; every part in small where time allows."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest import reproduce
from jaxest.calibration.mounting import Axes
from jaxest.reproduce.santaera2015 import axes, cases, hand, kept, table
from jaxest.simulate import grasp


def test_a_redundant_pair_agrees_with_the_way_around():
    random = np.random.default_rng(0)
    earth = Rotation.random(7, rng=random)
    edges = [earth[i].inv() * earth[j] for i, j in hand.EDGES]
    exact = jnp.asarray([e.as_quat(scalar_first=True) for e in edges])[None]
    assert np.asarray(cases.redundancy(exact)).max() < 1e-3  # float32
    edges[hand.REDUNDANT[0]] *= Rotation.from_rotvec([0, 0.1, 0])
    off = jnp.asarray([e.as_quat(scalar_first=True) for e in edges])[None]
    np.testing.assert_allclose(np.asarray(cases.redundancy(off)), [[0.1, 0]], atol=1e-3)


def test_a_joints_two_halves_are_one_angle():
    robot = hand.robot()
    q = np.array(robot.home, float)
    for name, angle in zip(grasp.LEADERS, np.arange(6) / 10, strict=True):
        for joint in (name, f"{name}_roll"):
            q[robot.topology.joint_q[robot.joint_names.index(joint)]] = angle / 2
    np.testing.assert_allclose(hand.finger_angles(q), np.arange(6) / 10)


def test_an_angles_deviation_is_that_of_both_halves_together():
    robot, names = hand.robot(), hand.robot().joint_names
    off = np.random.default_rng(0).normal(size=(3, robot.nv))
    at = [[robot.topology.joint_v[names.index(f"{n}{end}")] for end in ("", "_roll")] for n in grasp.LEADERS]
    expected = np.abs(np.stack([off[:, pair].sum(axis=1) for pair in at], axis=1))
    np.testing.assert_allclose(hand.finger_deviations(off[:, :, None] * off[:, None]), expected, atol=1e-7)


def test_contact_points_follow_the_posture():
    """A point of the palm's base stays, one of a finger's end moves with its last joint."""
    robot = hand.robot()
    q = np.array(robot.home, float)
    contacts = tuple(grasp.Contact(name, np.array([0, 0.01, 0.02]), 1.0) for name in ("left_root", "left_distal"))
    before = table.touched(q, contacts)
    q[robot.topology.joint_q[robot.joint_names.index("left_q1")]] += 0.3
    after = table.touched(q, contacts)
    np.testing.assert_allclose(after[0], before[0], atol=1e-9)
    assert np.linalg.norm(after[1] - before[1]) > 0.003
    assert table.touched(q, ()).shape == (0, 2)


def test_errors_of_axes_are_those_of_lines_and_a_hinge_has_one_sign():
    spread = 1e-4 * np.eye(6)
    spread[0, 0] = spread[3, 3] = 0.0

    def found(first, second):
        return Axes(np.array(first), np.array(second), spread, 0.0, 0.0, 0.0, 0.0, 1.0)

    truth = [np.array([1.0, 0, 0])] * 2
    c, s = math.cos(0.01), math.sin(0.01)
    first, second, squared = axes._compared(found([c, s, 0], [-1.0, 0, 0]), truth, two=True)
    assert (first, second) == pytest.approx((np.rad2deg(0.01), 0))
    assert squared == pytest.approx(0.25, rel=1e-3)  # one deviation in one of four directions
    first, second, _ = axes._compared(found([1.0, 0, 0], [-1.0, 0, 0]), truth, two=False)
    assert (first, second) == pytest.approx((0, 180))


def test_what_was_kept_is_not_computed_again(tmp_path):
    made = []

    def compute():
        made.append(1)
        return {"error": np.arange(3.0), "links": np.array(["a", "bc"])}

    first, second = (kept.piece(tmp_path, "x", compute) for _ in range(2))
    assert len(made) == 1
    assert all(np.array_equal(first[name], second[name]) for name in ("error", "links"))
    kept.piece(None, "x", compute)
    assert len(made) == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in reproduce.parts("santaera2015") if name != "broad"])
def test_every_part_is_as_good_as_it_was_and_goes_on_from_what_is_kept(tmp_path, name):
    """With few runs: bounds are three times what many runs give on the mean."""
    choice = reproduce.Choice(small=True, work=tmp_path / "work")
    (section,) = reproduce.sections("santaera2015", (name,), choice=choice)
    assert all(row.value is None or math.isfinite(row.value) for row in section.rows)
    found = {(row.metric, row.condition): row.value for row in section.rows}
    if name == "table1":
        for radius in grasp.DISKS:
            disk = f"disk of {1e3 * radius:g} mm"
            assert found["mean absolute error", disk] < 3
            assert 4 <= found["contact points", disk] <= 5
    if name == "cases":
        assert max(value for (metric, _), value in found.items() if metric == "finger angles, RMSE") < 5
        assert found["finger angles, RMSE", "rest (fig. 5)"] < 0.1
    if name == "angles":
        assert max(value for (metric, _), value in found.items() if metric == "finger angles, RMSE") < 1.5
        assert found["share of the variance taken away", "palm's yaw, without, headings unknown"] < 10
    if name == "calibration":
        assert max(value for (metric, _), value in found.items() if metric == "error of an axis, largest") < 0.5
    if section.draw:
        section.draw(tmp_path / "a.png")
        assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    stamps = {path: path.stat().st_mtime_ns for path in (tmp_path / "work").rglob("*.npz")}
    assert stamps
    (again,) = reproduce.sections("santaera2015", (name,), choice=choice)
    assert again.rows == section.rows
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "work").rglob("*.npz")} == stamps
