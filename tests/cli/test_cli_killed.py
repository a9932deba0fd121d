"""Long runs that are stopped at any moment, by Ctrl-C or by `kill -9`, and begun again: as if nothing had happened.

Real processes, stopped at random times while they work: the engine twice here, three commands six times each with
`-m slow`.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from test_cli_torque import PENDULUM
from test_cli_torque import log as pendulum_log
from test_cli_tune import PLAIN, shaken

from jaxest.io import read, write

# A process begun in the background of a shell inherits that Ctrl-C is ignored; these must hear it.
HEAR = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"  # imports are no work yet
LOAD = "import jaxest.cli.methods.torque as torque; torque.PIECE = 10; from jaxest.cli import main\n"
START = DEAF + LOAD + HEAR + "main()"
TORQUE = ["estimate", "log.npz", "-m", "torque", "--robot", "arm.xml", "-c", "c.toml", "--work", "kept", "--force"]
WORK, STILL = 600.0, 120.0  # processor seconds of the longest command many times over; s without any work at all
PAPER = ["reproduce", "santaera2015", "--small", "--part", "calibration", "--work", "kept", "--force"]
TUNE = ["tune", "log.npz", "-m", "orientation", "-c", "c.toml", "--checkpoint", "kept.npz", "--force", "--starts", "2",
        "--evaluations", "60"]  # fmt: skip


def prepare_torque(folder):
    write(pendulum_log(), folder / "log.npz")
    (folder / "arm.xml").write_text(PENDULUM)
    lines = ["[torque]", 'torque = "constant"', "iterations = 100", "rest = true", "velocity_noise = 1e-3"]
    (folder / "c.toml").write_text("\n".join(lines))


def prepare_tune(folder):
    write(shaken(0), folder / "log.npz")
    (folder / "c.toml").write_text(PLAIN)


def begin(words, folder):
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "PYTHONPATH": str(Path(__file__).parents[2])}
    return subprocess.Popen(
        [sys.executable, "-c", START, *words], cwd=folder, env=environment, text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )  # fmt: skip


def worked(number):
    """Processor seconds that a process has had, None where the system does not tell."""
    try:
        fields = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def ended(child):
    """What a process wrote, once it has ended: it hangs where it has had more work than any needs, or long none."""
    last, since = worked(child.pid), time.monotonic()
    while True:
        try:
            return child.communicate(timeout=1)
        except subprocess.TimeoutExpired:
            now = worked(child.pid)
            if now is None or now != last:
                last, since = now, time.monotonic()
            if (now or 0) > WORK or time.monotonic() - since > STILL:
                child.kill()
                _, err = child.communicate()
                pytest.fail(f"hangs after {now} s of work: {err}")


def finish(words, folder, status=(0, 3)):
    child = begin(words, folder)
    out, err = ended(child)
    assert child.returncode in status, err
    return out


def stopped(words, folder, number, chance, seconds):
    """Run a command, stop it at a random moment, and say whether it was still at work."""
    child = begin(words, folder)
    wait, begun = chance.uniform(0.2, 1.0) * seconds, time.monotonic()
    while child.poll() is None and time.monotonic() - begun < wait:
        time.sleep(0.005)
    if child.poll() is None:
        child.send_signal(number)
    _, err = ended(child)
    assert "Traceback" not in err
    return child.returncode not in (0, 3)


def survives(words, prepare, results, tmp_path, stops):
    """Results of a run that is stopped now and then against those of one that is not."""
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    for folder in (whole, broken):
        folder.mkdir()
        prepare(folder)
    begun = time.monotonic()
    finish(words, whole)
    seconds, chance = time.monotonic() - begun, random.Random(7)
    interrupted = 0
    while interrupted < stops:
        number = signal.SIGINT if interrupted % 3 == 2 else signal.SIGKILL
        if stopped(words, broken, number, chance, seconds):
            interrupted += 1
            continue
        seconds *= 0.6  # it was done already: programs are compiled by now
        shutil.rmtree(broken)
        broken.mkdir()
        prepare(broken)
    finish(words, broken)
    for name in results:
        same(whole / name, broken / name)


def same(one, other):
    if one.is_dir():
        names = {file.relative_to(one) for file in one.rglob("*.npz")}
        assert names == {file.relative_to(other) for file in other.rglob("*.npz")} != set()
        for name in names:
            expected, found = np.load(one / name), np.load(other / name)
            for key in expected:
                np.testing.assert_array_equal(found[key], expected[key])
    elif one.suffix == ".npz":
        expected, found = read(one), read(other)
        assert set(found.streams) == set(expected.streams)
        for name, item in expected.streams.items():
            np.testing.assert_array_equal(found.streams[name].value, item.value)
    else:
        assert other.read_text() == one.read_text()


CHAINS = (
    HEAR
    + """
import sys, time
import jax, numpy as np
from jaxest.io import chains, npz
def advance(state, size):
    if not isinstance(state, jax.core.Tracer):
        print("going", flush=True)
        time.sleep(0.1)
    draws = state + jax.numpy.arange(1.0, size + 1)
    return draws[-1], draws
_, history = chains.sample(advance, jax.numpy.zeros(()), 100, piece=5, folder="kept")
npz.save("out.npz", {"history": history}, overwrite=True)
"""
)


def test_pieces_of_a_killed_run_are_whole_and_gone_on_from(tmp_path):
    chance = random.Random(3)
    for number in (signal.SIGKILL, signal.SIGINT):
        child = subprocess.Popen(
            [sys.executable, "-c", CHAINS], cwd=tmp_path, stdout=subprocess.PIPE, text=True, stderr=subprocess.DEVNULL
        )
        for _ in range(chance.randint(2, 8)):
            assert child.stdout.readline() == "going\n"
        time.sleep(chance.uniform(0, 0.1))
        child.send_signal(number)
        child.communicate(timeout=60)
        assert child.returncode != 0
    before = len(list((tmp_path / "kept").glob("piece*.npz")))
    out = subprocess.run([sys.executable, "-c", CHAINS], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert out.returncode == 0, out.stderr
    assert 0 < before == 20 - out.stdout.count("going")
    np.testing.assert_array_equal(np.load(tmp_path / "out.npz")["history"], np.arange(1.0, 101.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "prepare", "results"),
    [
        ([*TORQUE, "-o", "out"], prepare_torque, ["out/estimate.npz"]),
        ([*TUNE, "-o", "tuned.toml"], prepare_tune, ["tuned.toml"]),
        ([*PAPER, "-o", "out"], lambda folder: None, ["kept"]),
    ],
    ids=["estimate", "tune", "reproduce"],
)
def test_stopped_many_times(words, prepare, results, tmp_path, request):
    survives(words, prepare, results, tmp_path, 6)
