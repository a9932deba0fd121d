"""Scaling curves, and the small filters beside other people's."""

import time

import numpy as np
import pytest

from jaxest import bench, kinematics, models
from jaxest.bench import deflection, deflection_accuracy, deflection_peers, scaling, scaling_cases
from jaxest.types import InputError


def test_exponent_is_the_slope_over_the_larger_half():
    sizes = [1, 10, 100, 1000, 10_000, 100_000]
    times = [5.0, 5.0, 5.0, *(1e-3 * np.array(sizes[3:]) ** 1.5)]
    slope, error = scaling.exponent(sizes, times)
    assert slope == pytest.approx(1.5)
    assert error == pytest.approx(0, abs=1e-12)
    assert scaling.exponent([2, 4], [3.0, 12.0]) == (pytest.approx(2.0), None)


def test_a_curve_ends_in_time_and_an_unknown_one_is_refused(monkeypatch):
    calls = []

    def build(size):
        calls.append(size)
        return scaling_cases.Program(lambda: time.sleep(size * 1e-3), ())

    curve = scaling_cases.Curve("sleeps", "sleeping", [1, 4, 16, 64, 1024], build)
    monkeypatch.setattr(scaling, "curves", lambda small, peers: [curve])
    rows = list(scaling.rows(peers=False, progress=lambda message: None, only=["sleeps"], seconds=2.0))
    assert calls[:2] == [1, 4]
    assert 1024 not in calls  # five calls of a second each
    assert [row.metric for row in rows][:2] == ["time against sleeps", "first call, sleeps"]
    assert rows[-1].metric == "exponent of sleeps"
    with pytest.raises(InputError, match="sleeps"):
        list(scaling.rows(peers=False, progress=lambda message: None, only=["sleep"]))


def test_a_fit_says_what_it_is_of(monkeypatch):
    curve = scaling_cases.Curve("sleeps", "", [1, 4], lambda size: scaling_cases.Program(lambda: time.sleep(1e-3), ()))
    monkeypatch.setattr(scaling, "curves", lambda small, peers: [curve])
    *_, fit = scaling.rows(peers=False, progress=lambda message: None)
    assert (fit.condition, fit.n, fit.spread) == ("from 1 on", 2, None)


@pytest.mark.slow  # compiles ten programs
def test_scaling(tmp_path):
    pytest.importorskip("scipy")
    rows = list(bench.rows("scaling", small=True))
    studies = scaling.curves(True, True)
    assert [row.metric for row in rows if row.metric.startswith(scaling.EXPONENT)] == [
        scaling.EXPONENT + curve.item for curve in studies
    ]
    assert len(rows) == sum(len(curve.sizes) + 2 for curve in studies)  # the first call and the exponent
    assert all(row.value > 0 for row in rows if row.metric.startswith(scaling.METRIC))
    assert all(
        (row.ratio is not None) == row.metric.endswith("points")
        for row in rows
        if row.metric.startswith(scaling.METRIC)
    )
    scaling.draw(tmp_path / "curves.png", rows)
    assert (tmp_path / "curves.png").stat().st_size > 10_000


@pytest.mark.parametrize("name", ["savitzky_golay", "rls"])
def test_small_filters_agree_with_numpy_and_scipy(name):
    pytest.importorskip("scipy")
    rows = list(bench.rows(name, small=True))
    timed = [row for row in rows if row.metric.endswith("step")]
    assert len(timed) == 2
    assert all(row.value > 0 and row.ratio > 0 for row in timed)
    if name == "rls":  # of 360 readings of 10 mm each unknown is known to 0.5 mm
        (error,) = (row for row in rows if row.metric == "error")
        assert max(error.value, error.reference) < 4 * 0.5 * np.sqrt(3)
    else:
        assert all(row.value < 1e-4 for row in rows if row.metric == "largest difference of a value")
    assert all(row.ratio is None for row in bench.rows(name, small=True, peers=False))


def test_bingham_agrees_with_pyrecest():
    pytest.importorskip("pyrecest")
    rows = list(bench.rows("bingham", small=True))
    found = [row for row in rows if row.metric == "log of the normaliser"]
    assert len(found) == 4
    for row in found:
        assert row.value == pytest.approx(row.reference, abs=3e-6)


@pytest.mark.slow  # runs four filters of 2048 particles
@pytest.mark.parametrize("name", ["pyrecest", "blackwell"])
def test_particle_filters_of_others_find_the_same_mean(name):
    """A peer that computes something else would be no peer."""
    module = pytest.importorskip({"pyrecest": "pyrecest.filters", "blackwell": "blackwell.filters.particle"}[name])
    core = pytest.importorskip("particles")
    if name == "pyrecest":
        step = deflection_peers.pyrecest_filter(module, 2048)
    else:
        robot = kinematics.load(models.path("arm"))
        params = deflection._problem(robot, 16, deflection.deflection.bootstrap)[1]
        given = params, deflection_accuracy.still(deflection.SENSORS)
        step = deflection_peers.blackwell_filter(module, robot, deflection.SENSORS, given, 2048)
    plain = deflection_peers.particles_filter(core, 2048)
    theirs, expected = (np.array([np.asarray(one()) for _ in range(60)])[10:] for one in (step, plain))
    error = np.hypot(theirs.std(axis=0), expected.std(axis=0)) / np.sqrt(50)
    # The walk of blackwell is Gaussian, ours von Mises of the same concentration: 0.02 rad of the marker's elbow.
    assert (np.abs(theirs.mean(axis=0) - expected.mean(axis=0)) < 4 * error + 0.02).all()
