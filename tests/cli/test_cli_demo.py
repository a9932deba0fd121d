import json

import numpy as np
import pytest

from jaxest import kinematics, models
from jaxest.cli import demo
from jaxest.metrics import circular_error


def test_demo(invoke, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxest.cli.demo.SECONDS", 6.0)
    monkeypatch.setattr("jaxest.cli.demo.PARTICLES", 64)
    result = invoke("demo", "--json")
    assert result.exit_code == 0, result.output
    rows = {row["metric"]: row for row in json.loads(result.stdout)["rows"]}
    shoulder = rows["shoulder: RMSE"]
    assert shoulder["reference"] > 2  # the encoders know nothing of the sagging
    assert shoulder["ratio"] > 2
    assert rows["hand position: RMSE"]["ratio"] > 1
    assert rows["truth inside the 95 % band"]["n"] == 480
    assert (tmp_path / "jaxest-out" / "demo.png").read_bytes()[:4] == b"\x89PNG"
    again = invoke("demo")
    assert again.exit_code == 2
    assert "--force" in again.stderr


@pytest.mark.slow
def test_bands_are_as_wide_as_they_should_and_nothing_is_worse_than_the_encoders():
    robot = kinematics.load(models.path("arm"))
    recorded = demo.simulate(robot, 20, 120.0)
    found = demo.estimate(robot, recorded.measurements, 20)
    away = circular_error(recorded.angles, found.mean)
    covered = (away >= found.lower - found.mean) & (away <= found.upper - found.mean)
    # Shoulder and elbow err as tilts do, of which 120 s have 60 independent ones; the mean is over four joints.
    error = np.sqrt(0.95 * 0.05 / 60) / 2
    assert abs(covered.mean() - 0.95) < 3 * error, covered.mean()
    naive = circular_error(recorded.angles, np.asarray(recorded.measurements.encoders.value, float))
    mine, other = (np.sqrt(np.mean(x**2, axis=0)) for x in (away, naive))
    assert (mine < 1.005 * other).all()  # what 256 particles scatter by
