import json

import pytest

from jaxest.cli import doctor


def test_table(invoke):
    result = invoke("doctor")
    assert result.exit_code == 0
    assert "jaxlib" in result.stdout
    assert "devices" in result.stdout


def test_json(invoke):
    found = json.loads(invoke("doctor", "--json").stdout)
    assert found["name"] == "doctor"
    assert found["rows"] == []
    assert found["cpus"] >= 1
    assert {one["package"]: one["verdict"] for one in found["packages"]}["jax"] == "ok"


def test_what_is_missing_and_how_to_get_it(invoke, monkeypatch):
    lines = ["jax>=0.1", 'nonesuch>=1; extra == "peers"', 'numpy<1; extra == "viz"']
    monkeypatch.setattr("importlib.metadata.requires", lambda name: lines)
    found = json.loads(invoke("doctor", "--json").stdout)
    assert found["missing"] == {"peers": "pip install 'jaxest[peers]'"}
    verdicts = {one["package"]: one["verdict"] for one in found["packages"]}
    assert (verdicts["jax"], verdicts["nonesuch"], verdicts["numpy"]) == ("ok", "missing", "not tested")
    assert "pip install 'jaxest[peers]'" in invoke("doctor").stdout


@pytest.mark.parametrize(
    ("version", "wanted", "answer"),
    [
        ("0.10.2", "<0.11,>=0.10.2", True),
        ("0.11", "<0.11,>=0.10.2", False),
        ("0.9.9", ">=0.10.2", False),
        ("4", ">=4.0.0", True),
        ("4.0.1", "!=4.0.1", False),
        ("2.0.0rc1", ">=2", True),
        ("1.0", "", True),
        ("0.17.6", "==0.17.6", True),
    ],
)
def test_ranges(version, wanted, answer):
    assert doctor.satisfies(version, wanted) is answer
