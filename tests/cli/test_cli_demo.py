import json


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
    assert rows["truth inside the 95 % band"]["value"] > 90
    assert (tmp_path / "jaxest-out" / "demo.png").read_bytes()[:4] == b"\x89PNG"
    again = invoke("demo")
    assert again.exit_code == 2
    assert "--force" in again.stderr
