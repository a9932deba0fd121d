"""`jaxest tune`: a config that is better than the one it started from, and all that may be wrong with a request."""

import json
import tomllib
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxest import parallel, tuning
from jaxest.cli import tuned
from jaxest.cli.tunable import Tunable
from jaxest.io import SensorLog, Stream, write
from jaxest.systems import orientation
from jaxest.types import InputError

PLAIN = "[orientation]\nproportional_gain = 3.0\nintegral_gain = 0.0012\n"
TUNE = ("--method", "orientation", "--config", "start.toml", "-o", "tuned.toml")


class Numbers(NamedTuple):
    value: object
    dt: object


def shaken(seed, n=400, hz=50.0):
    """A log of an IMU that is turned and shaken, with its truth."""
    system = orientation.build(sensors=("gyroscope", "accelerometer"))
    measurements, truth = jax.tree.map(
        lambda x: np.asarray(x, np.float64),
        system.simulate(system.default_params, key=jax.random.key(seed), steps=n, rate_hz=hz, shaking=1.0),
    )
    time = np.arange(n) / hz
    streams = {
        "gyroscope": Stream(time, measurements.gyroscope.value, "rad/s"),
        "accelerometer": Stream(time, measurements.accelerometer.value, "m/s2"),
        "orientation": Stream(time, truth.quaternion, "1"),
    }
    return SensorLog(streams)


@pytest.fixture
def files(tmp_path):
    """Three logs, one without its truth, and a config whose gain is much too high."""
    for i in range(2):
        write(shaken(i), tmp_path / f"{i}.npz")
    log = shaken(2)
    write(SensorLog({"orientation": log.streams["orientation"]}), tmp_path / "truth.npz")
    write(SensorLog({k: v for k, v in log.streams.items() if k != "orientation"}), tmp_path / "blind.npz")
    write(SensorLog({**log.streams, "magnetometer": log.streams["accelerometer"]._replace(unit="T")}),
          tmp_path / "magnetic.npz")  # fmt: skip
    (tmp_path / "start.toml").write_text(PLAIN)
    return tmp_path


def test_gains_are_tuned_written_and_better(invoke, files):
    result = invoke("tune", "0.npz", "1.npz", *TUNE, "--starts", 2, "--evaluations", 12, "--json")
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    rows = {(row["metric"], row["condition"]): row for row in report["rows"]}
    fitted = next(row for (_, condition), row in rows.items() if condition == "tuned")
    assert fitted["value"] < 0.8 * fitted["reference"]
    assert rows["integral_gain", "free, error unknown"]["spread"] is None  # two logs do not tell how logs differ
    assert "more logs to tune on than free numbers, got 2 for 2" in result.stderr
    written = tomllib.loads((files / "tuned.toml").read_text())
    assert set(written["orientation"]) == {"filter", "proportional_gain", "integral_gain"}
    assert written["orientation"]["proportional_gain"] < 2.0
    assert (files / "tuned.png").stat().st_size > 5000
    plain, better = (
        json.loads(invoke("estimate", "0.npz", "-m", "orientation", "-c", config, "-o", config[:-5], "--json").stdout)
        for config in ("start.toml", "tuned.toml")
    )
    wrong = [next(r["value"] for r in one["rows"] if r["metric"] == "inclination RMSE") for one in (plain, better)]
    assert wrong[1] < wrong[0]
    assert invoke("tune", "0.npz", *TUNE).exit_code == 2  # the config is kept unless forced


def mean_square(params, one, key):
    noise = 0 if key is None else jax.random.normal(key)
    return jnp.mean((one.measurements.value - params["mean"]) ** 2 - params["mean"] * noise)


@pytest.mark.parametrize("random", [False, True])
def test_figures_are_of_the_config_before_and_after_also_once_resumed(random):
    """Not of what a search evaluated first and last: on the same data, and at the point that is written."""
    values = np.random.default_rng(0).normal(size=(3, 40)).astype(np.float32)
    logs = [tuning.recording(Numbers(row, np.ones(40, np.float32))) for row in values]
    space = tuning.space({"mean": np.float32(3)}, {"mean": tuning.transforms.real})
    given = Tunable(tuning.Objective(mean_square, random=random), space, logs, "error", "deg", 10.0, None,
                    tuning.Windows(2, 40) if random else None, None, np.float32)  # fmt: skip
    start, point = jnp.array([3.0]), jnp.array([0.5])
    parts = tuning.padded(logs[:2]), tuning.padded(logs[2:])
    judged = tuned.judge(given, start, point, parts, jax.random.key(0))
    search = tuning.begin(tuning.Problem(given.objective, space), tuning.lbfgs(), start[None])
    found = tuning.Result(None, point, 1.0, point[None], np.ones(1), None, search, "converged")
    rows = {row.condition: row for row in tuned.rows(given, found, judged, 1, 0.0)}
    for condition, part in (("tuned", values[:2]), ("held out", values[2:])):
        before, after = (np.mean((part - mean) ** 2) for mean in (3, 0.5))
        noise = (before - rows[condition].reference / 10) / 3
        assert (abs(noise) > 1e-3) == random
        assert rows[condition].value / 10 == pytest.approx(after - noise / 2, abs=1e-5)


@pytest.mark.slow
def test_a_kept_search_goes_on(invoke, files):
    words = ("tune", "0.npz", *TUNE, "--starts", 1, "--checkpoint", "kept.npz", "--force", "--json", "--free",
             "proportional_gain", "--evaluations")  # fmt: skip
    shown = []
    for evaluations in (2, 4, 40, 40):
        report = json.loads(invoke(*words, evaluations).stdout)
        rows = {row["metric"]: row for row in report["rows"]}
        shown.append({row["condition"]: row for row in report["rows"]}["tuned"])
        assert rows["evaluations"]["value"] == evaluations or evaluations == 40
    assert "converged" in rows["evaluations"]["condition"]
    assert len({row["reference"] for row in shown}) == 1
    assert shown[0]["value"] > shown[1]["value"] >= shown[2]["value"] == shown[3]["value"]
    other = invoke(*words, 4, "--seed", 1)
    assert other.exit_code == 2
    assert "kept.npz: belongs to a run with other data" in other.stderr


OTHERS = (
    (PLAIN.replace("0.0012", "0.9"), ()),  # what is frozen counts
    (PLAIN + 'update = "projection"\n', ()),
    (PLAIN, ("--free", "integral_gain")),
    (PLAIN, ("--free", "proportional_gain=real")),
    (PLAIN, ("--held-out", 1)),
    (PLAIN, ("--seed", 1)),
)


def test_only_the_same_search_goes_on(refused, files, monkeypatch):
    """All that a search's numbers depend on is in the mark; the search itself is left out."""

    def begun(*given, **options):
        options["keep"](options["search"])
        raise InputError("begun")

    def said(config, words):
        (files / "start.toml").write_text(config)
        return refused("tune", "0.npz", "1.npz", *TUNE, "--checkpoint", "kept.npz", "--starts", 1,
                       "--free", "proportional_gain", *words)  # fmt: skip

    monkeypatch.setattr(tuning, "minimise", begun)
    for _ in range(2):
        assert "begun" in said(PLAIN, ("--evaluations", 9))
    for config, words in OTHERS:
        assert "kept.npz: belongs to a run with other data, settings" in said(config, words), (config, words)


def test_a_search_that_finds_nothing_finite_writes_nothing(refused, files, monkeypatch):
    nothing = tuning.Result(None, None, np.inf, None, np.full(2, np.inf), None, None, "evaluations")
    monkeypatch.setattr(tuning, "minimise", lambda *given, **options: nothing)
    assert "not finite from any of 2 start(s)" in refused("tune", "0.npz", *TUNE, "--starts", 2)
    assert not (files / "tuned.toml").exists()


def test_a_lost_process_is_told_and_what_to_do(invoke, files, monkeypatch):
    def lost(*given, **options):
        raise ValueError("Gloo AllGather failed: connection closed by peer")

    monkeypatch.setattr(tuning, "minimise", lost)
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    monkeypatch.setattr(parallel, "from_first", lambda tree: tree)
    with pytest.raises(RuntimeError, match=r"lost in the search; start all again, kept\.npz has the search so far"):
        invoke("tune", "0.npz", *TUNE, "--starts", 1, "--checkpoint", "kept.npz")


@pytest.mark.slow
def test_a_truth_of_its_own_and_a_judge(invoke, files):
    result = invoke("tune", "0.npz", "blind.npz", *TUNE, "--truth", "0.npz", "--truth", "truth.npz", "--held-out", 1,
                    "--starts", 1, "--evaluations", 3, "--free", "proportional_gain=positive")  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "held out" in result.stdout
    assert "wrote tuned.toml" in result.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("0.npz", "--free", "proportional_gian"), ["'proportional_gian'", "'proportional_gain'"]),
        (("0.npz", "--free", "proportional_gain=positiv"), ["'positiv'", "'positive'"]),
        (("0.npz", "--free", "integral_gain=bingham"), ["integral_gain", "largest is 0"]),
        (("0.npz", "--held-out", 1), ["--held-out 1", "at least one"]),
        (("blind.npz",), ["no true orientation", "--truth"]),
        (("0.npz", "1.npz", "--truth", "truth.npz"), ["--truth", "one each"]),
        (("0.npz", "magnetic.npz"), ["magnetic.npz: holds", "magnetometer, expected", "as in 0.npz", "sensors ="]),
        (("0.npz", "--objective", "likelihood"), ["likelihood", "error"]),
        (("0.npz", "--objective", "eror"), ["'eror'", "'error'"]),
        (("absent.npz",), ["absent.npz", "no such file"]),
    ],
)
def test_bad_requests(refused, files, words, said):
    message = refused("tune", *words, *TUNE)
    for part in said:
        assert part in message
    assert not (files / "tuned.toml").exists()


def test_bad_method(refused, files):
    assert "'orientation'" in refused("tune", "0.npz", "-m", "orientaton", "-o", "x.toml")
    said = refused("tune", "0.npz", "-m", "posture", "-o", "x.toml")
    assert "the method 'posture' cannot be tuned, expected orientation, deflection, onsite or torque" in said
    assert "--robot" in refused("tune", "0.npz", "-m", "deflection", "-o", "x.toml")
