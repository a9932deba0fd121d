"""Recordings of two IMUs with clocks of their own, and every way in which they can be unfit."""

import jax
import numpy as np
import pytest

from jaxest.manifolds import quaternion as quat
from jaxest.systems import onsite, onsite_batch
from jaxest.systems.onsite_recording import Imu, clipped, estimate, explain, late_by, pair
from jaxest.types import InputError

STEPS = 1500


@pytest.fixture(scope="module")
def rod():
    """Readings of a rod of 200 mm, 15 s at 100 Hz, and its truth."""
    params = jax.tree.map(np.float32, onsite.build().default_params)
    m, truth = jax.jit(lambda key: onsite.simulate(params, key=key, steps=STEPS))(jax.random.key(4))
    time = np.arange(STEPS) / 100
    a, p = (
        Imu(time, *(np.asarray(getattr(m, f"{kind}_{s}").value, float) for kind in ("gyroscope", "accelerometer")))
        for s in "ap"
    )
    return a, p, truth


def drawn(imu, rows):
    return Imu(*(x[rows] for x in imu[:3]))


@pytest.mark.slow
def test_a_late_clock_and_lost_samples(rod):
    a, p, truth = rod
    kept = np.random.default_rng(0).uniform(size=STEPS) > 0.03
    late = drawn(p, kept)
    late = late._replace(time=late.time + 0.02)
    found = estimate(a, late, names=("imu0", "imu1"))
    assert abs(found.offset.seconds - 0.02) < 5 * found.offset.deviation + 1e-4
    assert any("+20" in note or "+19.9" in note for note in found.notes)
    # 15 s: (40 / 15)^(1/2) times what 40 s leave, median 0.2 mm, to the worst of a hundred.
    assert np.linalg.norm(found.estimate.position - truth.position) < 1.5e-3
    assert np.linalg.norm(quat.local(found.estimate.quaternion, truth.quaternion)) < 2e-3


@pytest.mark.slow
def test_doubt_of_the_clock_belongs_to_the_covariance(rod):
    a, p, _ = rod
    time, m = pair(a, p)
    choice = onsite_batch.choose(m)
    none, half, whole = (late_by(p, 0.0, error, time, m, choice, None) for error in (0.0, 2e-3, 4e-3))
    np.testing.assert_allclose(none, 0, atol=1e-12)
    assert np.trace(whole[3:, 3:]) > 0
    # Its readings are interpolated elsewhere, which draws part of their noise anew.
    assert np.trace(whole) == pytest.approx(4 * np.trace(half), rel=0.25)
    # A clock that is off by so much moves the estimate so.
    time, m = pair(a, p._replace(time=p.time - 4e-3))
    moved = onsite_batch.choose(m).estimate.quaternion
    angle = np.linalg.norm(quat.local(choice.estimate.quaternion, moved))
    assert angle == pytest.approx(np.sqrt(np.trace(whole[:3, :3])), rel=0.25)


def test_gaps_are_not_filled(rod):
    a, p, _ = rod
    kept = np.ones(STEPS, bool)
    kept[400:440] = False
    time, m = pair(a, drawn(p, kept))
    there = np.asarray(m.gyroscope_p.valid)
    assert not there[(time > 4.01) & (time < 4.38)].any()
    assert there[(time > 1) & (time < 3.9)].all()
    assert np.asarray(m.gyroscope_a.valid).all()
    with pytest.raises(InputError, match=r"do not overlap: one from 0.000 to 14.990 s, the other from 100"):
        pair(a, p._replace(time=p.time + 100))


def test_not_one_rigid_link(rod):
    a, p, _ = rod
    swinging = p.gyroscope + 0.5 * np.sin(2 * np.pi * 0.8 * p.time)[:, None] * [0, 1, 0]  # a joint between them
    with pytest.raises(
        InputError, match=r"imu0 and imu1 are not on one rigid link: their rates differ by 0\.\d+ rad/s"
    ):
        estimate(a, p._replace(gyroscope=swinging), names=("imu0", "imu1"))


def test_too_little_rotation_says_which_component(rod):
    a, _, truth = rod
    # Only what lies along one axis of the link is left of the motion, as when a single joint swings.
    axis = np.array([0.0, 0.0, 1.0])
    r = np.asarray(quat.to_matrix(truth.quaternion), float)
    noise = np.random.default_rng(1).normal(size=(4, STEPS, 3)) * np.array([0.01, 0.05, 0.01, 0.05])[:, None, None]
    rate = a.gyroscope[:, 2:] * axis
    turn = np.gradient(rate, 0.01, axis=0)
    place = np.asarray(truth.position, float)
    force = np.tile([0.3, 0.2, 9.8], (STEPS, 1))
    there = force + np.cross(rate, np.cross(rate, place)) + np.cross(turn, np.tile(place, (STEPS, 1)))
    one = Imu(a.time, rate + noise[0], force + noise[1])
    other = Imu(a.time, rate @ r + noise[2], there @ r + noise[3])
    with pytest.raises(
        InputError,
        match=r"not determined: the position along \[-?0.0\d, -?0.0\d, 1.00\] of A is known to .* mm only; turn the",
    ):
        estimate(one, other, align_clocks=False)
    sure = np.diag([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 4.0])
    assert explain(sure).startswith("the position along [0.00, 0.00, 1.00] of A is open")
    assert explain(np.diag([0.04, *[1e-6] * 5])).startswith(
        "the rotation about [1.00, 0.00, 0.00] of P is known to 11.5 deg"
    )
    assert explain(np.eye(6) * 1e-6) == ""
    assert "not finite" in explain(np.full((6, 6), np.nan))


def test_clocks_that_drift(rod):
    a, p, _ = rod
    with pytest.raises(InputError, match=r"the clocks of a and b drift apart by [+-]3\.\d+ ms/s, .* synchronise them"):
        estimate(a, p._replace(time=p.time * 1.003), names=("a", "b"))


def test_saturated_sensors(rod):
    a, p, truth = rod
    rare, often = (np.quantile(np.abs(p.gyroscope), q) for q in (0.995, 0.8))
    found = estimate(a, p._replace(gyroscope=np.clip(p.gyroscope, -rare, rare)), names=("a", "b"), align_clocks=False)
    assert any("b/gyroscope: saturated in" in note and "left out" in note for note in found.notes)
    assert np.linalg.norm(found.estimate.position - truth.position) < 2e-3
    with pytest.raises(InputError, match=r"b/gyroscope: saturated in \d+ % of the samples, at .*expected at most 10 %"):
        estimate(a, p._replace(gyroscope=np.clip(p.gyroscope, -often, often)), names=("a", "b"))
    assert not clipped(p.gyroscope).any()
    assert not clipped(np.zeros((10, 3))).any()


def test_fewer_samples_than_windows(rod):
    a, p, _ = rod
    with pytest.raises(InputError, match="got 30 samples, expected at least 44, four windows"):
        estimate(drawn(a, slice(0, 30)), drawn(p, slice(0, 30)), align_clocks=False)
