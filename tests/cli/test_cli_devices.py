"""`--devices`: told to JAX before it starts, refused afterwards."""

import json
import os
import socket
import subprocess
import sys

import jax
import numpy as np
import pytest

from jaxest.io import SensorLog, Stream, write
from jaxest.systems import orientation


def test_the_processor_is_split():
    words = ["reproduce", "sato2023", "--part", "fig2", "--small", "--json", "--devices", "2"]
    done = subprocess.run([sys.executable, "-m", "jaxest.cli", *words], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["devices"] == ["cpu:cpu"] * 2


def test_a_running_jax_cannot_be_split(invoke):
    jax.devices()
    result = invoke("reproduce", "sato2023", "--part", "fig2", "--small", "--devices", "2")
    assert result.exit_code == 2
    assert "JAX runs already" in result.stderr


@pytest.mark.slow  # three processes, each of which compiles
def test_starts_are_spread_and_processes_joined(tmp_path):
    """Two processes, each with two devices, tune what one does; the first alone writes."""
    system = orientation.build(sensors=("gyroscope", "accelerometer"))
    draw = system.simulate(system.default_params, key=jax.random.key(0), steps=100, rate_hz=50.0, shaking=1.0)
    measurements, truth = jax.tree.map(lambda x: np.asarray(x, np.float64), draw)
    time = np.arange(100) / 50.0
    streams = {
        "gyroscope": Stream(time, measurements.gyroscope.value, "rad/s"),
        "accelerometer": Stream(time, measurements.accelerometer.value, "m/s2"),
        "orientation": Stream(time, truth.quaternion, "1"),
    }
    write(SensorLog(streams), tmp_path / "log.npz")
    (tmp_path / "start.toml").write_text("[orientation]\nproportional_gain = 3.0\n")
    words = ["tune", "log.npz", "-m", "orientation", "-c", "start.toml", "--free", "proportional_gain", "--starts", "3",
             "--evaluations", "4", "--json"]  # fmt: skip
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        place = f"127.0.0.1:{free.getsockname()[1]}"

    def begin(name, *more):
        full = [sys.executable, "-m", "jaxest.cli", *words, "-o", f"{name}.toml", *more]
        environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
        return subprocess.Popen(full, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                text=True)  # fmt: skip

    running = [begin("alone"), *(begin(f"joined{i}", "--devices", "2", "--join", f"{place},{i}/2") for i in range(2))]
    found = [process.communicate(timeout=240) for process in running]
    assert [process.returncode for process in running] == [0, 0, 0], found
    assert json.loads(found[1][0])["devices"] == ["cpu:cpu"] * 4
    assert not found[2][0].strip()
    assert not (tmp_path / "joined1.toml").exists()
    assert (tmp_path / "joined0.toml").read_text() == (tmp_path / "alone.toml").read_text()


@pytest.mark.parametrize("words", [("--join", "host0", "--devices", "2"), ("--devices", "2", "--join", "host0")])
def test_the_processor_is_split_before_processes_join(invoke, words):
    """Joining starts JAX, which can then no longer be split; that it cannot here is said first, in either order."""
    jax.devices()
    assert "JAX runs already" in invoke("tune", "log.npz", "-m", "orientation", *words).stderr


def test_a_place_that_is_none_is_refused(invoke):
    result = invoke("tune", "log.npz", "-m", "orientation", "--join", "host0")
    assert result.exit_code == 2
    assert "got 'host0'" in result.stderr
