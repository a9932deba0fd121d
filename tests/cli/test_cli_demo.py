import json


def test_demo(invoke, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxest.cli.demo.SECONDS", 4.0)
    result = invoke("demo", "--json")
    assert result.exit_code == 0, result.output
    rows = {(row["metric"], row["condition"]): row["value"] for row in json.loads(result.stdout)["rows"]}
    assert rows["inclination RMSE", "6 axes"] < 10
    assert rows["total RMSE", "9 axes"] < 15
    assert (tmp_path / "jaxest-out" / "demo.png").read_bytes()[:4] == b"\x89PNG"
    again = invoke("demo")
    assert again.exit_code == 2
    assert "--force" in again.stderr
