import json

from jaxest import bench
from jaxest.io.report import Row


def test_cases_are_listed(invoke):
    assert invoke("bench", "--list").stdout.split() == list(bench.CASES)
    assert json.loads(invoke("bench", "--list", "--json").stdout)["cases"] == list(bench.CASES)


def test_rows(invoke, monkeypatch):
    def rows(name, *, peers, progress, small, robots, peer_seconds):
        progress("now")
        assert (peers, small, peer_seconds) == (False, True, None)
        yield Row("step", name, 2.0, "us", spread=0.1, n=5, reference=20.0, reference_name="peer", ratio=10.0)
        yield Row("step", "alone", 2.0, "us", ratio=0.5)

    monkeypatch.setattr("jaxest.bench.rows", rows)
    result = invoke("bench", "orientation", "--no-peers", "--small")
    assert "10 x faster" in result.stdout
    assert "2 x slower" in result.stdout
    found = json.loads(invoke("bench", "--no-peers", "--small", "--json").stdout)
    assert found["name"] == "bench"
    assert [row["condition"] for row in found["rows"]] == [c for name in bench.CASES for c in (name, "alone")]
