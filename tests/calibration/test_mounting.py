"""Joint axes from exact paths, mountings from vectors and from a zero posture, and circles."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest.calibration import circle, mounting
from jaxest.types import InputError


def waves(random, time, size):
    frequency, phase = random.uniform(0.1, 0.7, (3, 4)), random.uniform(0, 2 * np.pi, (3, 4))
    return size * np.sin(2 * np.pi * frequency * time[:, None, None] + phase).mean(axis=1)


def paths(seed, two, rate_hz=50, shift=0.0):
    """Exact orientations of two IMUs mounted any way, the second's heading turned and drifting; and the axes."""
    random = np.random.default_rng(seed)
    time = np.arange(20 * rate_hz) / rate_hz + shift
    move = waves(random, time, 1.2)
    base = Rotation.from_euler("ZYX", move[:, :3])
    axes = np.array([[0, 1.0, 0], [1, 0, 0]])
    joint = Rotation.from_rotvec(waves(random, time, 1.4)[:, :1] * axes[0])
    if two:
        joint = joint * Rotation.from_rotvec(waves(random, time, 1.4)[:, :1] * axes[1])
    mounts = Rotation.random(2, rng=random)
    turn = Rotation.from_rotvec(np.outer(2.0 + 0.002 * time, [0, 0, -1.0]))
    first, second = base * mounts[0], turn * base * joint * mounts[1]
    truth = mounts[0].inv().apply(axes[0]), mounts[1].inv().apply(axes[int(two)])
    return time, first.as_quat(scalar_first=True), second.as_quat(scalar_first=True), truth


@pytest.mark.parametrize("seed", range(5))
def test_a_hinge_is_found_with_its_sign(seed):
    time, first, second, truth = paths(seed, two=False)
    found = mounting.hinge(time, first, second)
    sign = np.sign(found.first @ truth[0])
    np.testing.assert_allclose(sign * found.first, truth[0], atol=1e-6)
    np.testing.assert_allclose(sign * found.second, truth[1], atol=1e-6)
    assert abs(np.angle(np.exp(1j * (found.heading - 2.0)))) < 1e-5
    assert abs(found.drift - 0.002) < 1e-6
    assert found.angle == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_both_axes_of_a_joint_are_found(seed):
    time, first, second, truth = paths(seed, two=True)
    found = mounting.two_axis(time, first, second)
    assert abs(found.first @ truth[0]) > 1 - 1e-9
    assert abs(found.second @ truth[1]) > 1 - 1e-9
    assert abs(found.angle - np.pi / 2) < 1e-4


def gyroscopes(seed, two):
    """100 Hz: stamps, orientations some tenths of a degree off for seconds, rates with biases; and the axes."""
    ends = [paths(seed, two, 100, shift) for shift in (-1e-4, 1e-4)]
    time, *exact, truth = paths(seed, two, 100)
    random = np.random.default_rng([seed, 1])
    rates, wrong = [], []
    for k in (0, 1):
        first, second = (Rotation.from_quat(end[1 + k], scalar_first=True) for end in ends)
        rates.append((first.inv() * second).as_rotvec() / 2e-4 + random.normal(0, 0.005, 3))
        tilt = waves(random, time, 0.012)[:, :3] * [1, 1, 0]
        path = Rotation.from_rotvec(tilt) * Rotation.from_quat(exact[k], scalar_first=True)
        wrong.append(path.as_quat(scalar_first=True))
    return time, wrong, tuple(rates), truth


@pytest.mark.parametrize("two", [False, True], ids=["hinge", "two axes"])
def test_rates_find_the_axes_in_spite_of_wrong_tilts_and_biases(two):
    """Within 0.1 deg, and by at most three of the deviations that are told; by the tilts alone several times worse."""
    search, ratios = (mounting.two_axis if two else mounting.hinge), []
    for seed in range(3):
        time, path, rates, truth = gyroscopes(seed, two)
        errors = []
        for given in (None, rates):
            found = search(time, *path, rates=given)
            axes = zip((found.first, found.second), truth, strict=True)
            errors.append([float(np.arccos(min(abs(a @ b), 1))) for a, b in axes])
        assert max(errors[1]) < np.deg2rad(0.1)
        assert (np.array(errors[1]) < 3 * np.array(found.sigma)).all()
        ratios.append(max(errors[0]) / max(errors[1]))
    assert np.median(ratios) > 3


def test_rates_that_cannot_be_used_are_named():
    time, path, rates, _ = gyroscopes(0, two=False)
    with pytest.raises(InputError, match=r"those of first are .* are they in rad/s"):
        mounting.hinge(time, *path, rates=(np.rad2deg(rates[0]), rates[1]))
    with pytest.raises(InputError, match=r"those of second are .* along the sensor's axes"):
        mounting.hinge(time, *path, rates=(rates[0], rates[1][:, [1, 0, 2]]))
    with pytest.raises(InputError, match="row 7 is not finite"):
        mounting.hinge(time, *path, rates=(np.where(np.arange(2000)[:, None] == 7, np.nan, rates[0]), rates[1]))
    with pytest.raises(InputError, match=r"a gap of 1 s after 9\.99 s, rates cannot be integrated"):
        mounting.hinge(time + 0.99 * (time > 9.995), *path, rates=rates)
    with pytest.raises(InputError, match=r"rates: got shapes \(3,\), \(3,\)"):
        mounting.hinge(time, *path, rates=([0, 0, 0], [0, 0, 0]))


def test_a_joint_that_rests_shows_no_axis():
    time, first, _, _ = paths(0, two=False)
    with pytest.raises(InputError, match=r"turns by 0\.0 deg rms, expected at least 10; move it more"):
        mounting.hinge(time, first, first)
    with pytest.raises(InputError, match="second: row 3 is not a unit quaternion"):
        mounting.hinge(time, first, np.where(np.arange(1000)[:, None] == 3, np.nan, first))
    with pytest.raises(InputError, match="increasing stamps"):
        mounting.two_axis(time[::-1], first, first)


def test_a_mounting_from_directions():
    turn = Rotation.random(rng=np.random.default_rng(1))
    link = np.array([[1.0, 0, 0], [0, 0.6, 0.8]])
    found = mounting.from_vectors(turn.inv().apply(link), link)
    assert (Rotation.from_quat(found, scalar_first=True).inv() * turn).magnitude() < 1e-9
    with pytest.raises(InputError, match="all parallel"):
        mounting.from_vectors([[1, 0, 0], [-1, 0, 0]], [[0, 1, 0], [0, -1, 0]])
    with pytest.raises(InputError, match="link: row 1 is not finite"):
        mounting.from_vectors(link, [[1, 0, 0], [np.nan, 0, 0]])
    with pytest.raises(InputError, match=r"weight: got shape \(3,\), expected \(2,\)"):
        mounting.from_vectors(link, link, [1, 1, 1])


def test_a_zero_posture_levels_the_nominal_mounting():
    """With a magnetometer the mounting itself; without, its tilt, while the turn about the vertical is the file's."""
    link, turn = Rotation.from_euler("ZYX", [0.4, 0.2, -0.3]), Rotation.from_rotvec([0.05, -0.04, 0.03])
    sensor = link * turn
    force, field = sensor.inv().apply([0, 0, 9.8]), sensor.inv().apply([0, 18, -41])
    carried = link.as_quat(scalar_first=True)
    whole = Rotation.from_quat(mounting.zero_posture(force, carried, field=field), scalar_first=True)
    assert (whole.inv() * turn).magnitude() < 1e-9
    tilt = Rotation.from_quat(mounting.zero_posture(force, carried), scalar_first=True)
    np.testing.assert_allclose((link * tilt).apply(force), [0, 0, 9.8], atol=1e-9)
    assert tilt.magnitude() < turn.magnitude()
    with pytest.raises(InputError, match="are axes swapped, or is another posture held"):
        mounting.zero_posture(-force, carried)
    with pytest.raises(InputError, match="force: got"):
        mounting.zero_posture([0, 0, np.nan], carried)


def test_a_circle():
    angle = np.array([0.1, 0.9, 2.0, 4.0])
    points = np.c_[0.3 + 0.0245 * np.cos(angle), -0.2 + 0.0245 * np.sin(angle)]
    found = circle.fit(points)
    assert abs(found.radius - 0.0245) < 1e-12
    np.testing.assert_allclose(found.centre, [0.3, -0.2], atol=1e-12)
    assert found.residual < 1e-12
    with pytest.raises(InputError, match="on one line"):
        circle.fit([[0, 0], [1, 1], [2, 2]])
    with pytest.raises(InputError, match="at least three"):
        circle.fit([[0, 0], [1, 1]])
