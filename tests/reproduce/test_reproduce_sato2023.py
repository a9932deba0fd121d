"""The pieces that figs. 6 to 10 are made of; every part in small where time allows."""

import math

import jax
import numpy as np
import pytest

from jaxest import reproduce
from jaxest.manifolds import quaternion as quat
from jaxest.metrics import circular_error
from jaxest.reproduce.sato2023 import arm, drift, fusion, hand, shapes
from jaxest.systems import direct_fusion


@pytest.fixture(scope="module")
def scene():
    """The whole motion, through the desk."""
    return arm.scene(0, collision=True)


def test_the_arm_rests_in_the_postures_and_sags_but_for_the_desk(scene):
    for number, posture in enumerate(arm.POSTURES):
        at = np.isclose(scene.time, 2 + (arm.REST + arm.MOVE) * number)
        if at.any():
            assert np.allclose(scene.reference[at], posture, atol=1e-6)
    lying = (scene.time >= 20.5) & (scene.time < arm.DESK[0])
    held = (scene.time >= arm.DESK[0]) & (scene.time < arm.DESK[1])
    height = arm.ends(scene.angles).position[:, 2]
    assert (height[lying] < arm.ends(scene.reference).position[lying, 2] - 0.05).all()
    assert height[held].min() > height[lying].max()


def test_sensors_are_masked_by_name_and_time(scene):
    seen = scene.time < 1
    found = arm.using(scene, ("encoders", "end_effector"), seen)
    assert np.asarray(found.encoders.valid).all()
    assert not np.asarray(found.imu2.valid).any()
    assert np.array_equal(found.end_effector.valid, seen)


def test_drift_turns_imus_about_the_vertical(scene):
    found = drift.drifting(scene, 3.0)
    before, after = scene.measurements.imu2.value, found.imu2.value
    turn = np.asarray(jax.vmap(lambda a, b: quat.log(quat.compose(a, quat.inverse(b))))(after, before))
    expected = np.deg2rad(3.0) * scene.time
    expected = (expected + np.pi) % (2 * np.pi) - np.pi
    assert np.allclose(turn[:, :2], 0, atol=1e-4)
    assert np.allclose(turn[:, 2], expected, atol=1e-3)


def test_direct_fusion_locks_in_one_order_only(scene):
    good, bad = (
        circular_error(hand.direct(scene, heading), scene.angles)[:, 1:3]
        for heading in (direct_fusion.heading_of_y, direct_fusion.heading_of_x)
    )
    assert np.rad2deg(arm.rms(good)) < 2  # IMUs tilt by 0.6 deg about each axis
    assert np.rad2deg(np.abs(bad).max()) > 90


def test_coverage_counts_what_lies_inside_also_across_half_a_turn(scene):
    truth = np.full((4, 4), np.pi - 0.01)
    mean = np.full((4, 4), -np.pi + 0.01)
    wide = np.array([[0.03], [0.03], [0.03], [0.01]])
    one = scene._replace(angles=truth)
    found = arm.Result(mean, mean - wide, mean + wide, np.full(4, 7.0))
    rows = {row.metric: row.value for row in fusion.rows_of("x", [one], [found])}
    assert rows["truth inside 95 % interval"] == 75.0
    assert math.isclose(rows["yaw: RMSE"], np.rad2deg(0.02), rel_tol=1e-6)


def test_the_wrapped_normal_integrates_to_one():
    x = np.linspace(-np.pi, np.pi, 2001)
    for variance in (0.01, 1.0, 5.0):
        assert math.isclose(np.trapezoid(shapes.wrapped_normal(x, variance), x), 1, rel_tol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", reproduce.parts("sato2023"))
def test_every_part_gives_finite_rows_and_a_picture(tmp_path, name):
    (section,) = reproduce.sections("sato2023", (name,), choice=reproduce.Choice(small=True))
    assert section.rows
    assert all(row.value is None or math.isfinite(row.value) for row in section.rows)
    section.draw(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
