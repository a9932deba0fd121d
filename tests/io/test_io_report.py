"""The JSON object that every command prints."""

import json
from importlib import metadata

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxest
from jaxest.io import Report, Row, environment, to_json
from jaxest.io.report import report

FIELDS = ["name", "jaxest", "jax", "mujoco", "devices", "flags", "rows"]
ROW = ["metric", "condition", "value", "unit", "spread", "n", "reference", "reference_name", "ratio"]


def test_fields_are_those_that_others_rely_on(monkeypatch):
    jax.devices()  # a backend that starts under unknown flags ends the process
    monkeypatch.setenv("XLA_FLAGS", "--a=1 --b")
    item = report("bench", [Row("time", "7 joints", np.float32(0.5), "us", jnp.float32(0.25), np.int64(3))])
    data = json.loads(to_json(item))
    assert list(data) == FIELDS
    assert list(data["rows"][0]) == ROW
    assert data["rows"][0]["value"] == 0.5
    assert data["rows"][0]["spread"] == 0.25
    assert data["rows"][0]["n"] == 3
    assert data["rows"][0]["reference"] is None
    assert data["jaxest"] == jaxest.__version__
    assert data["jax"] == jax.__version__
    assert data["devices"][0].startswith("cpu")
    assert data["flags"][:2] == ["--a=1", "--b"]


def test_what_is_not_finite_is_null():
    rows = (Row("a", "", float("nan"), "s", np.float32(np.inf), 1, -np.inf),)
    data = json.loads(to_json(Report("x", "0", "0", "0", (), (), rows)), parse_constant=pytest.fail)
    assert data["rows"][0]["value"] is data["rows"][0]["spread"] is data["rows"][0]["reference"] is None


def test_what_json_cannot_hold_is_refused():
    with pytest.raises(ValueError, match="object"):
        to_json(Report("x", "0", "0", "0", (), (), (Row("a", "", object(), "s"),)))


def test_an_absent_package_is_said(monkeypatch):
    def absent(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", absent)
    assert environment().mujoco == "absent"
