"""Rays of MuJoCo against boxes in closed form, motion inside the room, faults as stated, bad input by name."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jaxest.sensors.proximity import Proximity, rays, ring, tilted, zones
from jaxest.simulate import boxes, proximity, rooms
from jaxest.types import InputError

LINKS = 3


@pytest.fixture(scope="module")
def scan():
    model = proximity.compiled(rooms.scene(LINKS, rooms.room(3, reach=1.0)))
    time, q = proximity.inside(model, 3, duration=2.0)
    return proximity.cast(model, rooms.sensors(LINKS, rows=3, columns=3), q, time)


def test_rays_end_where_boxes_begin(scan):
    room = rooms.room(3, reach=1.0)
    sensors = rooms.sensors(LINKS, rows=3, columns=3)
    model = mujoco.MjModel.from_xml_string(rooms.structure(LINKS))
    data = mujoco.MjData(model)
    data.qpos[:] = scan.q[7]
    mujoco.mj_kinematics(model, data)
    origin, away = [], []
    for one in sensors:
        body = model.body(one.frame).id
        turn = data.xmat[body].reshape(3, 3)
        origin += [data.xpos[body] + turn @ one.position] * len(one.directions)
        away.append(one.directions @ turn.T)
    closed = boxes.distance(
        boxes.Boxes(room.lower, room.upper, room.centers[6:], room.halves[6:]),
        jnp.asarray(np.array(origin), jnp.float32),
        jnp.asarray(np.concatenate(away), jnp.float32),
    )
    found = scan.ranges[7]
    assert found.shape == (rays(sensors),) == ((LINKS + 1) * 8 * 9,)
    np.testing.assert_allclose(found, closed, atol=2e-5)
    ends = np.array(origin) + found[:, None] * np.concatenate(away)
    surface = boxes.surface(
        boxes.Boxes(room.lower, room.upper, room.centers[6:], room.halves[6:]), jnp.asarray(ends, jnp.float32)
    )
    assert np.asarray(surface).max() < 1e-4


def test_motion_stays_inside_and_a_wild_one_is_refused():
    model = proximity.compiled(rooms.scene(5, rooms.room(0, reach=2.2)))
    data = mujoco.MjData(model)
    _, q = proximity.inside(model, 1, duration=5.0)
    assert not proximity.touches(model, data, q)
    # A room for a structure a quarter as long: this one goes through its wall.
    short = proximity.compiled(rooms.scene(5, rooms.room(0, reach=0.5)))
    assert proximity.touches(short, mujoco.MjData(short), q)
    with pytest.raises(InputError, match=r"3 motions of up to 0\.1 rad"):
        proximity.inside(short, 1, duration=5.0, amplitude=0.1, tries=3)


def test_a_seed_is_a_room_and_rooms_differ():
    one, same, other = rooms.room(1), rooms.room(1), rooms.room(2)
    np.testing.assert_array_equal(one.centers, same.centers)
    assert one.centers.shape != other.centers.shape or not np.allclose(one.centers, other.centers)
    for center, half in zip(one.centers[6:], one.halves[6:], strict=True):
        along = np.clip(center, [-0.3, 0, 0], [3.9, 0, 0])
        assert np.linalg.norm(np.maximum(np.abs(center - along) - half, 0)) > 0.7


def test_noise_bias_and_dropouts_are_as_stated(scan):
    sensors = rooms.sensors(LINKS, rows=3, columns=3)
    faults = proximity.Faults(noise=0.02, dropout=0.1)
    value, there = proximity.corrupt(scan, sensors, faults, 0)
    inside = np.isfinite(scan.ranges) & (scan.ranges < 3.9)
    n = inside.sum()
    # A share of a Bernoulli variable, and the deviation of n normal ones, to 5 standard errors.
    assert abs(there[inside].mean() - 0.9) < 5 * np.sqrt(0.09 / n)
    relative = (value / scan.ranges - 1)[there & inside]
    assert abs(relative.std() / (0.02 / 2.7) - 1) < 5 / np.sqrt(2 * len(relative))
    again, _ = proximity.corrupt(scan, sensors, faults, 0)
    np.testing.assert_array_equal(value, again)
    read = proximity.encoders(scan.q, faults, 0)
    np.testing.assert_allclose(read - scan.q, 0.05)
    short = [one._replace(maximum=1.0) for one in sensors]
    assert not proximity.corrupt(scan, short, faults, 0)[1][scan.ranges > 1.1].any()


def test_rays_pass_through_the_robot_alone_and_its_model_stays_as_it_is():
    """Whatever the group or material of a wall is, it is met; the robot's own shapes are where that is asked for."""
    model = mujoco.MjModel.from_xml_string("""<mujoco><asset><material name="blue" rgba="0 0 1 1"/></asset><worldbody>
    <geom type="box" pos="0 0 1.05" size="1 1 .05" group="5"/><body name="b"><joint/>
    <geom size=".03" pos="0 0 .2" group="2" material="blue"/></body></worldbody></mujoco>""")
    before = model.geom_group.copy(), model.geom_matid.copy(), model.geom_rgba.copy()
    up = [Proximity("b", np.array([0, 0, 0.05]), np.array([[0, 0, 1.0]]))]
    q, time = np.zeros((1, 1)), np.zeros(1)
    np.testing.assert_allclose(proximity.cast(model, up, q, time).ranges, 0.95, atol=1e-6)
    for left, now in zip(before, (model.geom_group, model.geom_matid, model.geom_rgba), strict=True):
        np.testing.assert_array_equal(left, now)
    np.testing.assert_allclose(proximity.cast(model, up, q, time, itself=True).ranges, 0.12, atol=1e-6)


def test_late_sensors_see_the_past():
    """A sensor a whole sample late reads what a prompt one read the sample before."""
    scene = rooms.scene(LINKS, rooms.room(3, reach=1.0))
    time, q = proximity.inside(scene, 3, duration=0.5)
    sensors = rooms.sensors(LINKS, rows=1, columns=2)
    prompt = proximity.cast(scene, sensors, q, time)
    stagger = np.where(np.arange(len(sensors)) % 2 == 0, 0.0, 0.1)
    late = proximity.cast(scene, sensors, q, time, stagger=stagger)
    column = np.repeat(stagger > 0, 2)
    np.testing.assert_array_equal(late.ranges[:, ~column], prompt.ranges[:, ~column])
    np.testing.assert_allclose(late.ranges[1:, column], prompt.ranges[:-1, column], atol=1e-5)


def test_a_free_structure_lies_on_the_floor_and_moves():
    scene = rooms.scene(LINKS, rooms.room(0, reach=1.0, free=True), free=True)
    _, q = proximity.crawl(scene, 0, duration=2.0, start=0.5)
    assert q.shape == (20, 7 + LINKS)
    assert np.abs(q[:, 2] - (rooms.BODY - 0.06)).max() < 0.03
    assert np.abs(q[-1, 7:] - q[0, 7:]).max() > 0.005
    np.testing.assert_allclose(np.linalg.norm(q[:, 3:7], axis=1), 1, atol=1e-9)


def test_zones_and_rings_look_outwards():
    away = zones(8, 8)
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 1)
    widest = np.rad2deg(np.arctan2(away[:, 1], away[:, 0])).max()
    np.testing.assert_allclose(widest, 45 * 7 / 16)
    for one in ring("a", 0.1, count=4, rows=2, columns=3):
        outwards = one.position * [0, 1, 1] / 0.05
        assert np.all(one.directions @ outwards > np.cos(np.deg2rad(33)))
        assert one.position[0] == 0.1
    turned = tilted(ring("a", 0.1, count=1), [0.1], [[0.0, 0.0, 1.0]])[0]
    np.testing.assert_allclose(np.linalg.norm(turned.directions, axis=1), 1)
    middle = ring("a", 0.1, count=1)[0].directions.mean(0), turned.directions.mean(0)
    angle = np.arccos(np.dot(*middle) / np.linalg.norm(middle[0]) / np.linalg.norm(middle[1]))
    np.testing.assert_allclose(angle, 0.1, atol=1e-9)


def test_scans_are_kept_whole(scan, tmp_path):
    proximity.save(scan, tmp_path / "deep" / "scan.npz")
    kept = proximity.load(tmp_path / "deep" / "scan.npz")
    for one, other in zip(kept, scan, strict=True):
        np.testing.assert_array_equal(one, other)
    (tmp_path / "bad.npz").write_bytes(b"no")
    with pytest.raises(InputError, match="no run can go on from this file"):
        proximity.load(tmp_path / "bad.npz")


def test_bad_input_is_named():
    scene, q = rooms.scene(LINKS, None), np.zeros((3, LINKS))
    with pytest.raises(InputError, match="frame 'lonk1' does not exist; did you mean 'link1'"):
        proximity.cast(scene, ring("lonk1", 0.1), q, np.arange(3.0))
    with pytest.raises(InputError, match="time: row 2 is not later"):
        proximity.cast(scene, ring("link1", 0.1), q, np.array([0.0, 0.1, 0.1]))
    with pytest.raises(InputError, match=r"q: got shape \(3, 3\), expected \(2, 3\)"):
        proximity.cast(scene, ring("link1", 0.1), q, np.arange(2.0))
    with pytest.raises(InputError, match="links: 0"):
        rooms.structure(0)
    with pytest.raises(InputError, match="zones: 0 x 8"):
        zones(0, 8)
    nothing = proximity.cast(scene, [Proximity("link1", np.zeros(3), np.array([[0.0, 0, 1]]))], q, np.arange(3.0))
    assert np.all(np.isinf(nothing.ranges))
