"""The accuracy benchmark on trials made up here: reading, padding, groups; and the figures on the real ones."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest.bench import broad
from jaxest.metrics import broad_rmse_deg
from jaxest.types import InputError

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "broad.py"
NAMES = ("01_undisturbed_slow_rotation_A", "24_disturbed_tapping_A")


@pytest.fixture
def folder(tmp_path):
    """Two trials of different lengths, at rest at a known orientation."""
    for name, steps in zip(NAMES, (300, 200), strict=True):
        turn = Rotation.from_euler("ZYX", [0.4, 0.2, -0.1])
        acc, mag = (np.tile(turn.inv().apply(v), (steps, 1)) for v in ([0, 0, 9.81], [0, 18.0, -41]))
        quat = np.tile(np.roll(turn.as_quat(), 1), (steps, 1))
        quat[5] = np.nan
        np.savez(tmp_path / f"{name}.npz", gyr=np.zeros((steps, 3)), acc=acc, mag=mag, quat=quat,
                 movement=np.ones(steps, bool), fs=285.7142857)  # fmt: skip
    return tmp_path


def test_trials_are_padded_and_what_is_padded_does_not_count(folder):
    trials = broad.load(folder)
    assert [trial.name for trial in trials] == list(NAMES)
    assert [len(trial.movement) for trial in trials] == [300, 200]
    assert trials[0].interval == pytest.approx(0.0035)
    rows = broad.padded(trials, 6)
    assert rows.magnetometer is None
    assert rows.gyroscope.value.shape == (2, 300, 3)
    assert np.asarray(rows.accelerometer.valid).sum(axis=1).tolist() == [300, 200]
    assert np.all(np.asarray(rows.dt)[1, 200:] == 0)
    both, alone = broad.estimates("decoupled", trials, 9), broad.estimates("decoupled", trials[1:], 9)
    assert both[1].shape == (200, 4)
    np.testing.assert_allclose(both[1], alone[0], atol=1e-6)
    assert broad_rmse_deg(both[1], trials[1].truth, trials[1].movement).total < 0.01


def test_groups_go_by_the_names(folder):
    assert broad.groups(broad.load(folder)) == {
        "all": [0, 1], "undisturbed, rotation": [0], "undisturbed, slow": [0], "tapping": [1],
    }  # fmt: skip


def test_every_filter_has_every_group_and_a_gyro_bias_of_its_own(folder, monkeypatch):
    """Rows of one online filter and the smoother, without a peer; the bias is in the gyroscope that filters get."""
    given = []

    def exact(name, trials, axes, dtype=np.float32):
        given.append((name, axes, trials[0].sensors["gyroscope"][0]))
        return [trial.truth for trial in trials]

    monkeypatch.setattr(broad, "estimates", exact)
    rows = list(broad.rows(folder, peers=False))
    groups = [*broad.groups(broad.load(folder))]
    by_filter = {}
    for row in rows:
        by_filter.setdefault(row.metric, []).append(row.condition)
    assert len(by_filter) == 2 * (len(broad.ONLINE) + 1)
    for metric, conditions in by_filter.items():
        biased = [broad.BIASED] if metric.endswith(("ekf", broad.SMOOTHER)) else []
        assert conditions == groups + biased
    assert all(row.value == pytest.approx(0, abs=1e-6) for row in rows)
    for name in ("ekf", broad.SMOOTHER):
        seen = [rate for filter_name, axes, rate in given if (filter_name, axes) == (name, 9)]
        np.testing.assert_allclose(np.abs(seen), [[0, 0, 0], np.deg2rad([0.5] * 3)], atol=1e-12)


def test_a_folder_without_trials_is_refused(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="no NPZ file, expected the trials of BROAD"):
        broad.load(tmp_path)
    monkeypatch.setattr(sys, "argv", ["broad.py", str(tmp_path), "--command"])
    with pytest.raises(SystemExit, match=r"error: .* no NPZ file"):
        runpy.run_path(str(SCRIPT), run_name="__main__")


@pytest.mark.recorded
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "inclination", "total"),
    [("ekf", 0.70, 1.9), ("decoupled", 0.80, 2.25), ("ekf, smoothed", 0.60, 1.85), ("madgwick", 2.0, 5.3)],
)
def test_figures_on_the_recordings(shared, name, inclination, total):
    """Mean over the 20 trials, one setting for all; VQF has 0.78 and 2.44, offline 0.55 and 2.17."""
    trials = broad.load(shared / "recordings" / "broad")
    assert len(trials) == 20
    found = {}
    for axes, part in ((6, "inclination"), (9, "total")):
        quaternions = broad.estimates(name, trials, axes)
        errors = [broad_rmse_deg(q, t.truth, t.movement) for q, t in zip(quaternions, trials, strict=True)]
        found[part] = np.mean([getattr(error, part) for error in errors])
    assert found["inclination"] < inclination
    assert found["total"] < total
