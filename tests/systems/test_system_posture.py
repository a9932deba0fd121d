"""A person's arm from four IMUs without magnetometers: what is found, what cannot be, and a gap."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxest import kinematics, models
from jaxest.filters import run
from jaxest.filters.complementary import Imu
from jaxest.simulate import grasp
from jaxest.systems import posture
from jaxest.systems._posture_fusion import Prior, fuse, joints
from jaxest.systems._posture_links import loose, turned_any_way
from jaxest.types import Reading

SITES = tuple(f"site:imu_{name}" for name in ("trunk", "upper_arm", "forearm", "hand"))
HZ, STEPS, SETTLED = 50.0, 600, 150
GAP = slice(300, 450)
"""Samples in which the hand's IMU is silent: 3 s."""
SHOULDER, BEYOND = slice(3, 6), slice(6, 10)
"""Coordinates of v, after the trunk's three: what a wrong heading turns, and what headings become known by."""


class Case(NamedTuple):
    error: Any
    """(T, 7) rad, of the hinges"""
    deviation: Any
    """(T, 7) rad"""
    info: Any


@pytest.fixture(scope="module")
def cases():
    """Start and headings known; neither known; known, with a gap."""
    robot = kinematics.load(models.path("human_arm"))
    system = posture.build(robot, SITES)
    params = jax.tree.map(np.float32, system.default_params)
    draw = jax.jit(lambda key: system.simulate(params, key=key, steps=STEPS, rate_hz=HZ))
    measurements, truth = draw(jax.random.key(4))
    there = jnp.ones((STEPS, len(SITES)), bool)
    silent = there.at[GAP, 3].set(False)

    def estimate(start, heading, seen):
        given = params._replace(start=start, initial_heading=heading)
        gyro, acc = (r._replace(valid=seen) for r in (measurements.gyroscope, measurements.accelerometer))
        read = measurements._replace(gyroscope=gyro, accelerometer=acc)
        return run(system.step, given, system.init(given), read)[1]

    starts = jnp.stack([truth.q[0], params.start, truth.q[0]])
    headings = jnp.array([0.03, 1.8, 0.03], jnp.float32)
    infos = jax.jit(jax.vmap(estimate))(starts, headings, jnp.stack([there, there, silent]))
    true = np.asarray(truth.q, float)[:, 4:]
    found = {}
    for k, name in enumerate(("known", "unknown", "gap")):
        info = jax.tree.map(lambda x, k=k: np.asarray(x[k]), infos)
        error = (info.q[:, 4:] - true + np.pi) % (2 * np.pi) - np.pi
        found[name] = Case(error, np.sqrt(np.diagonal(info.covariance, axis1=1, axis2=2))[:, 3:], info)
    return found


def rms(x):
    return np.sqrt(np.mean(np.square(x), axis=0))


@pytest.mark.slow
def test_joints_are_followed_where_the_start_was_known(cases):
    """The shoulder drifts with the gyroscopes' headings; elbow, forearm and wrist lean on constraints."""
    case = cases["known"]
    assert rms(case.error[SETTLED:, 3:]).max() < np.deg2rad(1.0)
    assert rms(case.error[SETTLED:, :3]).max() < np.deg2rad(6.0)
    assert rms(case.error / case.deviation).max() < 2
    assert (case.info.status == 0).all()
    assert case.info.valid[1:].all()
    assert (case.info.known[SETTLED:, BEYOND] > 0.95).all()


def test_what_no_sensor_tells_is_said(cases):
    """Neither the trunk's yaw nor the shoulder, whatever hinges seem to say; the joints beyond it are found."""
    case = cases["unknown"]
    assert rms(case.error[SETTLED:, 3:]).max() < np.deg2rad(1.0)
    assert (case.info.known[SETTLED:, BEYOND] > 0.95).all()
    assert (case.info.known[:, SHOULDER] < 0.2).all()
    assert rms(case.error / case.deviation).max() < 2
    yaw = case.info.known[-1, 2]
    assert yaw < 0.5
    assert case.info.heading_deviation[-1, 0] > np.deg2rad(60)
    # headings beyond the shoulder are known against each other, if not against the trunk's
    assert case.info.heading_deviation[-1, 1] < case.info.heading_deviation[0, 1]


def test_a_gap_is_bridged_and_grows_the_covariance(cases):
    case, whole = cases["gap"], cases["known"]
    wrist = case.deviation[:, 5:]
    before, end, after = wrist[GAP.start - 1], wrist[GAP.stop - 1], wrist[GAP.stop + 100]
    assert (end > 5 * before).all()
    assert (np.diff(wrist[GAP].max(axis=1)) > 0).mean() > 0.9
    assert (np.abs(case.error[GAP]) < 3 * case.deviation[GAP]).all()
    assert (after < 2 * before).all()
    assert rms(case.error / case.deviation).max() < 2
    assert np.isfinite(case.info.q).all()
    np.testing.assert_array_equal(case.info.q[: GAP.start], whole.info.q[: GAP.start])


def hinges(*axes):
    joints = "".join(f'<joint axis="{axis}" armature="0.1"/>' for axis in axes)
    geom = '<geom size="0.05" mass="1"/>'
    return kinematics.load(
        f'<mujoco><worldbody><body name="base"><joint type="ball"/>{geom}<body name="link">{joints}{geom}'
        f'<body name="tip"><joint axis="0 1 0"/>{geom}</body></body></body></worldbody></mujoco>'
    )


def test_hinges_that_turn_any_way_are_recognised():
    shoulder = loose(hinges("1 0 0", "0 1 0", "0 0 1"), ("base", "link", "tip"))
    np.testing.assert_array_equal(shoulder.carried, [[0], [1], [1]])
    np.testing.assert_array_equal(shoulder.between, [[-1], [1], [0]])
    np.testing.assert_array_equal(shoulder.hinges[:, 0], [0, 0, 0, 1, 1, 1, 0])
    for axes in (("0 1 0", "0 1 0", "0 1 0"), ("1 0 0", "0 1 0")):  # parallel, too few
        assert loose(hinges(*axes), ("base", "link", "tip")).carried.shape == (3, 0)
    assert loose(hinges("1 0 0", "0 0 1"), ("base", "tip")).carried.shape == (2, 1)
    assert loose(kinematics.load(models.path("gripper")), grasp.SITES).carried.shape == (7, 0)


def test_loose_hinges_are_as_uncertain_as_the_turn_between_headings():
    """As the fourth power of it: 0.1 rad matters little, half a turn means that nothing is known."""
    groups = loose(hinges("1 0 0", "0 1 0", "0 0 1"), ("base", "link", "tip"))

    def more(deviation, alike=0.0):
        doubt = deviation**2 * (jnp.eye(3) * (1 - alike) + alike)
        return np.asarray(turned_any_way(groups, doubt))

    assert more(1.5)[3:6] == pytest.approx(np.pi**2 / 3, rel=1e-6)
    assert (more(1.5)[[0, 1, 2, 6]] == 0).all()
    assert np.sqrt(more(0.1)[3]) == pytest.approx(1.814 * 2 * 0.1**2, rel=1e-3)
    assert more(1.0, alike=1.0).max() < 1e-6  # headings that are wrong together turn no joint


def test_headings_that_are_known_leave_the_joints_alone():
    """The short way with magnetometers is the long one with headings of no variance; and against NumPy in float64."""
    random = np.random.default_rng(0)
    n, k, prior = 4, 6, 3.0
    design, error, gone = random.normal(size=(n, 3, k)), random.normal(size=(n, 3)), random.normal(size=k)
    half = random.normal(size=(n, 3, 3))
    noise = half @ half.transpose(0, 2, 1) + 0.1 * np.eye(3)
    weight = np.linalg.inv(noise)
    information = np.einsum("nij,nik,nkl->jl", design, weight, design) + np.eye(k) / prior
    pull = np.einsum("nij,nik,nk->j", design, weight, error) - gone / prior
    known = jnp.zeros((n, n), jnp.float32)
    given = [jnp.asarray(x, jnp.float32) for x in (design, noise, error)]
    before = Prior(known, known, jnp.float32(prior), jnp.asarray(gone, jnp.float32))
    found = joints(*given, before), fuse(*given, before, jnp.float32(0.01), jnp.zeros((n, 0), jnp.float32))
    for each in found:
        np.testing.assert_allclose(each.covariance, np.linalg.inv(information), atol=1e-5)
        np.testing.assert_allclose(each.move, np.linalg.solve(information, pull), atol=1e-5)
        assert not np.any(each.heading_covariance)
        assert not np.any(each.heading_move)


@pytest.mark.recorded
def test_a_rod_with_two_raw_imus_is_a_hinge_that_stays_at_zero(shared):
    """Shaken by up to 4 g, without magnetometers, headings unknown; biases from the rest it begins with.

    The IMUs' own frames are 1.8 deg from parallel by the recording's authors.
    """
    data = np.load(shared / "recordings" / "two_imus_200mm" / "twoimus_200mm_sample.npz")
    first, second = data["imu0"], data["imu1"]
    time = first[:, 0]
    other = np.stack([np.interp(time, second[:, 0], second[:, k]) for k in range(2, 8)], axis=1)
    both = np.stack([first[:, 2:8], other], axis=1)
    gyro, acc = both[..., :3] - both[:20, :, :3].mean(axis=0), both[..., 3:]
    seen = np.ones(gyro.shape[:2], bool)
    readings = (Reading(x.astype(np.float32), seen) for x in (gyro, acc))
    measurements = Imu(*readings, None, np.diff(time, prepend=time[0]).astype(np.float32))
    robot = kinematics.load(
        '<mujoco><worldbody><body name="one"><joint type="ball"/><geom size="0.02" mass="0.1"/><body name="two" '
        'pos="-0.2 0 0"><joint axis="0 1 0"/><geom size="0.02" mass="0.1"/></body></body></worldbody></mujoco>'
    )
    system = posture.build(robot, ("one", "two"))
    params = jax.tree.map(np.float32, system.default_params)
    _, info = run(system.step, params, system.init(params), measurements)
    angle, late = np.asarray(info.q)[:, 4], slice(300, None)  # 5 s
    assert rms(angle[late]) < np.deg2rad(4)
    assert rms(angle[late] / np.sqrt(np.asarray(info.covariance)[late, 3, 3])) < 3
