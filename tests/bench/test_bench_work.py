"""Work is counted as by hand, and two results are compared by their ratios."""

import importlib.util
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from jaxest.bench import work

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "compare.py"


def test_operations_by_hand():
    a, b = jnp.zeros((3, 4)), jnp.zeros((4, 5))
    assert work.count(lambda a, b: a @ b, a, b) == work.Work(2 * 3 * 4 * 5, 4 * (12 + 20 + 15))
    assert work.count(lambda x: jnp.sin(x) * 2 + 1, jnp.zeros(7)).operations == 21
    assert work.count(lambda x: x.reshape(7, 1)[::2], jnp.zeros(7)).operations == 0
    assert work.count(jnp.sum, jnp.zeros(9)).operations == 9


def test_loops_are_multiplied_and_jit_is_looked_into():
    def loop(x):
        return jax.lax.scan(lambda c, _: (c * c + 1, None), x, None, length=10)[0]

    assert work.count(loop, jnp.zeros(6)).operations == 10 * 2 * 6
    assert work.count(jax.jit(jax.vmap(loop)), jnp.zeros((3, 6))).operations == 3 * 10 * 2 * 6
    both = work.count(lambda x: jax.lax.cond(x[0] > 0, jnp.sin, lambda x: x * x * x, x), jnp.zeros(5)).operations
    assert 10 <= both <= 13  # the dearer branch, and the choice


def test_floor_is_the_longer_time():
    peak = work.Peak(operations=100.0, bandwidth=10.0)
    assert peak.floor(work.Work(200.0, 1.0)) == 2.0
    assert peak.floor(work.Work(200.0, 50.0)) == 5.0
    measured = work.peak(64, 1, 1)
    assert measured.operations > 0
    assert measured.bandwidth > 0


@pytest.fixture
def compare():
    spec = importlib.util.spec_from_file_location("compare_results", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def result(path, **rows):
    made = [{"metric": name, "condition": "c", **row} for name, row in rows.items()]
    path.write_text(json.dumps({"rows": made}))
    return str(path)


def test_what_became_slower_is_said(compare, tmp_path, capsys):
    old = result(
        tmp_path / "old.json",
        step={"value": 10.0, "unit": "us", "ratio": 4.0, "reference_name": "peer"},
        alone={"value": 1.0, "unit": "ms"},
        gone={"value": 1.0, "unit": "s"},
        samples={"value": 5.0, "unit": "1"},
    )
    busy = result(
        tmp_path / "busy.json",  # a slower machine: every time doubles, the ratio to the peer stays
        step={"value": 20.0, "unit": "us", "ratio": 4.0, "reference_name": "peer"},
        alone={"value": 1.1, "unit": "ms"},
        samples={"value": 50.0, "unit": "1"},
    )
    assert compare.main([old, busy]) == 0
    assert "only in the old result: gone" in capsys.readouterr().out
    slow = result(
        tmp_path / "slow.json",
        step={"value": 10.0, "unit": "us", "ratio": 2.0, "reference_name": "peer"},
        alone={"value": 0.5, "unit": "ms"},
    )
    assert compare.main([old, slow]) == 1
    out = capsys.readouterr().out
    assert "WORSE    2.00x  step | c (ratio to peer)" in out
    assert "better   0.50x  alone" in out
    with pytest.raises(SystemExit, match="not a result"):
        compare.main([old, str(tmp_path / "absent.json")])
