"""`--devices`: told to JAX before it starts, refused afterwards."""

import json
import subprocess
import sys

import jax


def test_the_processor_is_split():
    words = ["reproduce", "sato2023", "--part", "fig2", "--small", "--json", "--devices", "2"]
    done = subprocess.run([sys.executable, "-m", "jaxest.cli", *words], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["devices"] == ["cpu:cpu"] * 2


def test_a_running_jax_cannot_be_split(invoke):
    jax.devices()
    result = invoke("reproduce", "sato2023", "--part", "fig2", "--small", "--devices", "2")
    assert result.exit_code == 2
    assert "JAX runs already" in result.stderr
