"""The scripts that keep results and compare them."""

import importlib.util
import json
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"


def script(name):
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def row(metric, value, unit="us", ratio=None, peer=None):
    return {"metric": metric, "condition": "a | b", "value": value, "unit": unit, "spread": 0.1, "n": 5,
            "reference": ratio and value * ratio, "reference_name": peer, "ratio": ratio}  # fmt: skip


def written(path, *rows):
    path.write_text(json.dumps({"name": "bench", "rows": rows}))
    return str(path)


def test_what_became_slower_is_said(tmp_path, capsys):
    """Ratios to the same peer count where both have one, values otherwise; counts and the like do not."""
    compare = script("compare")
    old = written(tmp_path / "old.json", row("step", 10.0, ratio=4.0, peer="NumPy"), row("alone", 1.0, "ms"),
                  row("error", 1.0, "deg"), row("runs", 5, "1"), row("gone", 1.0))  # fmt: skip
    new = written(tmp_path / "new.json", row("step", 30.0, ratio=3.9, peer="NumPy"), row("alone", 1.5, "ms"),
                  row("error", 0.5, "deg"), row("runs", 9, "1"), row("fresh", 1.0))  # fmt: skip
    assert compare.main([old, new]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["WORSE", "1.50x", "alone", "|", "a", "|", "b", "(value", "in", "ms,", "without", "a",
                                "peer)"]  # fmt: skip
    assert lines[1].startswith("same") and "ratio to NumPy" in lines[1]
    assert lines[2].startswith("better") and "0.50x" in lines[2]
    assert lines[3:] == ["only in the old result: gone | a | b", "new: fresh | a | b"]
    assert compare.main([old, new, "--tolerance", "1.6"]) == 0
    with pytest.raises(SystemExit, match="not a result"):
        compare.main([str(tmp_path / "absent.json"), new])


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ([("step", 9.0, "us", 4.0, "C"), ("step", 9.0, "us", 2.0, "NumPy")],
         [("step", 9.0, "us", 0.4, "C"), ("step", 9.0, "us", 2.0, "NumPy")], "10.00x  step | a | b (ratio to C)"),
        ([("step", 9.0, "us", 4.0, "C")], [("step", 18.0, "us")], "2.00x  step | a | b (value in us"),
        ([("error", 1.0, "deg")], [("error", None, "deg")], "infx  error | a | b (lost its value)"),
        ([("draws", 90.0, "1/s")], [("draws", 30.0, "1/s")], "3.00x  draws"),
        ([("draws", 90.0, "1", 4.0, "C")], [("draws", 90.0, "1", 2.0, "C")], "2.00x  draws | a | b (ratio to C)"),
        ([("posterior", 0.1, "sd")], [("posterior", 0.5, "sd")], "5.00x  posterior"),
    ],
    ids=["peers", "peer gone", "value gone", "rate", "ratio", "sd"],
)  # fmt: skip
def test_nothing_that_became_worse_goes_by(tmp_path, capsys, before, after, said):
    compare = script("compare")
    files = [written(tmp_path / f"{i}.json", *(row(*one) for one in rows)) for i, rows in enumerate((before, after))]
    assert compare.main(files) == 1
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("WORSE ") and said in first
    assert compare.main(files[:1] * 2) == 0


def test_kept_results_can_be_read_and_compared(tmp_path, monkeypatch, capsys):
    keep, compare = script("keep"), script("compare")
    monkeypatch.setattr(keep, "RESULTS", tmp_path / "results")
    rows = [row("step", 10.0, ratio=4.0, peer="NumPy"), row("compile", None, "s")]
    report = {"name": "bench", "jaxest": "1", "jax": "2", "mujoco": "3", "devices": ["cpu:cpu"], "rows": rows}

    def run(words, **options):
        heard.append(words[1:])
        return type("Done", (), {"returncode": 1 if "slam" in words else 0, "stdout": json.dumps(report)})

    heard = []
    monkeypatch.setattr(keep.subprocess, "run", run)
    assert keep.main(["rls", "slam", "--devices", "2"]) == 1
    assert heard[0] == ["-m", "jaxest.cli", "bench", "rls", "--json", "--devices", "2"]
    text = (tmp_path / "results" / "rls.md").read_text()
    assert "`jaxest bench rls --json --devices 2`" in text
    assert "| step | a | b | 10 us | 0.1 | 5 | NumPy | 40 | 4 |" in text
    assert not (tmp_path / "results" / "slam.json").exists()
    file = str(tmp_path / "results" / "rls.json")
    assert compare.main([file, file]) == 0
    assert "same" in capsys.readouterr().out
