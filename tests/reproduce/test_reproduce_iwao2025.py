"""The pieces of Iwao 2025's table and figures, in small, and their figures of merit on made-up runs."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxest import reproduce
from jaxest.reproduce.iwao2025 import runs, table
from jaxest.reproduce.iwao2025.conditions import chosen, condition
from jaxest.types import InputError

WORKERS = """
import multiprocessing, os, time
from concurrent.futures import ProcessPoolExecutor
from jaxest.reproduce.iwao2025.table import _as_worker
if __name__ == "__main__":
    pool = ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"), initializer=_as_worker)
    started = [pool.submit(os.getpid), pool.submit(time.sleep, 0.5), pool.submit(os.getpid)]
    print(*{started[0].result(), started[2].result()}, flush=True)
    pool.submit(time.sleep, 60).result()
"""


SCANS = """
import os, tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from jaxest.reproduce.iwao2025 import runs, table

def scan(name, one, plan, work):
    runs.scans(work, f"{plan.seed}").touch()
    return {"mean": {"5": 0.0}}

class Pool(ProcessPoolExecutor):
    def __init__(self, workers, **options):
        super().__init__(1, **options)

    def submit(self, work, *job):
        return super().submit(scan, *job)

if __name__ == "__main__":
    os.sched_getaffinity = lambda pid: {0, 1}
    table.ProcessPoolExecutor = Pool
    table.gathered(["5 links"], [runs.Plan(0, 1.0), runs.Plan(1, 1.0)], None, print)
    print(len(list(Path(tempfile.gettempdir()).glob("jaxest-*/scans/?.npz"))))
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    return tmp_path_factory.mktemp("iwao2025")


@pytest.fixture(scope="module")
def first(work):
    """One condition in one room, a second long."""
    choice = reproduce.Choice(small=True, runs=1, rows=("5 links",), work=work)
    return table.table2(choice, lambda message: None)


def test_a_row_stands_beside_the_papers(first):
    assert first.title.startswith("Table II: position error, 1 room of ")
    found = {(row.metric, row.condition): row for row in first.rows}
    error = found["position error", "5 links, link 5"]
    assert error.reference == condition("5 links").paper[5][0]
    assert 0 < error.value < found["kinematics alone", "5 links, link 5"].value
    assert found["worst room", "5 links, link 5"].value == error.value
    assert 50 < found["map points within 5 cm of a surface", "5 links"].value <= 100


def test_a_finished_run_is_not_computed_again(first, work):
    (kept,) = (work / "runs").glob("*.json")
    changed = json.loads(kept.read_text())
    changed["mean"]["5"] = 123.0
    kept.write_text(json.dumps(changed))
    again = table.table2(reproduce.Choice(small=True, runs=1, rows=("5 links",), work=work), lambda message: None)
    assert again.rows[0].value == 123.0
    assert list((work / "scans").iterdir())


def test_a_row_that_is_none_is_named():
    with pytest.raises(InputError, match="20 links"):
        chosen(("20 link",))


def test_nees_counts_only_directions_that_can_move():
    random = np.random.default_rng(0)
    root = random.normal(size=(4, 4)) * [[1], [2], [3], [0]]
    covariance = root @ root.T
    errors = random.normal(size=(40_000, 4)) @ root.T
    found = runs.nees(errors, np.broadcast_to(covariance, (40_000, 4, 4)))
    # A chi-square of 3 by 3: its mean over 40000 has a standard error of 0.004.
    assert found.mean() == pytest.approx(1, abs=0.02)
    assert np.all(runs.nees(np.ones((2, 4)), np.zeros((2, 4, 4))) == 0)


def test_turns_are_those_of_the_world():
    angle = 0.3
    turned = np.array([[[np.cos(angle / 2), 0, 0, np.sin(angle / 2)]]])
    before = np.array([[[np.sqrt(0.5), np.sqrt(0.5), 0, 0]]])
    both = np.asarray(jax.vmap(jax.vmap(runs.quaternion.compose))(turned, before))
    np.testing.assert_allclose(runs._turned(both, before)[0, 0], [0, 0, angle], atol=1e-6)


def test_scans_that_workers_keep_for_now_end_with_the_run(tmp_path):
    (tmp_path / "parent.py").write_text(SCANS)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    command = [sys.executable, str(tmp_path / "parent.py")]
    told = subprocess.run(command, env={**os.environ, "TMPDIR": str(temporary)}, capture_output=True, text=True)
    assert told.stdout.splitlines()[-1] == "2", told.stderr
    assert not list(temporary.glob("jaxest-*"))


@pytest.mark.skipif(os.name != "posix", reason="kill -9 is POSIX")
def test_workers_end_with_a_parent_that_was_killed(tmp_path):
    (tmp_path / "parent.py").write_text(WORKERS)
    parent = subprocess.Popen([sys.executable, str(tmp_path / "parent.py")], stdout=subprocess.PIPE, text=True)
    workers = [int(number) for number in parent.stdout.readline().split()]
    assert workers
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()  # its workers hold the other end
    until = time.monotonic() + 30
    while any(alive(worker) for worker in workers) and time.monotonic() < until:
        time.sleep(0.1)
    left = [worker for worker in workers if alive(worker)]
    for worker in left:
        os.kill(worker, signal.SIGKILL)
    assert not left


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # One that has ended stays in the table until somebody asks for its exit status.
    told = Path(f"/proc/{pid}/stat")
    return not (told.is_file() and told.read_text().rpartition(")")[2].split()[0] == "Z")
