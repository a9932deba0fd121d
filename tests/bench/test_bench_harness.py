import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxest.bench import harness
from jaxest.bench.harness import Candidate, Timing, candidate, compare, compile_row, measure, race


def test_jitted_functions_are_compiled_before_they_are_timed():
    traces = []

    @jax.jit
    def double(x):
        traces.append(1)
        return 2 * x

    one = candidate("double", double, jnp.ones(3), items=3)
    assert len(traces) == 1
    assert one.compile_s > 0
    timing = race([one], repeats=4, min_time=0.0)["double"]
    assert len(traces) == 1
    assert timing.seconds.shape == (4,)
    assert (timing.seconds > 0).all()
    assert candidate("plain", lambda: None).compile_s is None


def test_times_are_per_piece():
    timing = race([Candidate("sleep", lambda: time.sleep(0.02), items=4)], repeats=3)["sleep"]
    assert 0.005 <= timing.median < 0.1  # a sleep lasts at least what it says


def test_candidates_take_turns_both_ways():
    order = []
    candidates = [Candidate(name, lambda name=name: order.append(name)) for name in "ab"]
    race(candidates, repeats=2, min_time=0.0)
    assert order[-4:] == ["a", "b", "b", "a"]


def test_results_are_waited_for():
    class Slow:
        waited = 0

        def block_until_ready(self):
            Slow.waited += 1
            return self

    race([Candidate("slow", Slow)], repeats=3, min_time=0.0)
    assert Slow.waited == 3 + 2  # two calls warm up and say how long one takes


@pytest.mark.parametrize("arguments", [{"repeats": 0}, {"repeats": 2, "candidates": 2}])
def test_what_makes_no_sense(arguments):
    candidates = [Candidate("same", lambda: None)] * arguments.pop("candidates", 1)
    with pytest.raises(ValueError, match=r"at least 1|distinct"):
        race(candidates, **arguments)


def test_rows_by_hand():
    ours = Timing("ours", np.array([1.0, 2.0, 3.0, 4.0, 10.0]) * 1e-6, 0.5)
    peer = Timing("theirs", np.array([2.0, 8.0, 12.0, 12.0, 10.0]) * 1e-6, None)
    row = compare("step", "small", ours, peer)
    assert (row.value, row.spread, row.n) == (pytest.approx(3.0), pytest.approx(2.0), 5)
    assert (row.reference, row.reference_name) == (pytest.approx(10.0), "theirs")
    assert row.ratio == pytest.approx(3.0)  # the median of 2, 4, 4, 3, 1, not 10 / 3
    assert compare("step", "", ours, unit="ns").value == pytest.approx(3000.0)
    assert compile_row("small", ours)[2:4] == (0.5, "s")


def test_a_peer_that_is_absent_is_named_with_the_line_that_installs_it():
    assert harness.find_peer("no_such_peer") is None
    row = compare("step", "", Timing("ours", np.ones(2), None), missing="vqf")
    assert row.reference is None
    assert row.ratio is None
    assert row.reference_name == "vqf is not installed: pip install 'jaxest[peers]'"


def test_measure():
    timing = measure(jax.jit(jnp.sum), jnp.ones(3), repeats=2, name="sum")
    assert timing.name == "sum"
    assert timing.compile_s is not None
