"""Importing the package is quick and quiet: no backend, no simulator, no plots, nothing printed."""

import subprocess
import sys

CODE = """
import sys
import jaxest
from jaxest import filters, io, kinematics, manifolds, metrics, systems, types
for name in systems.__all__:
    getattr(systems, name)
heavy = {"mujoco", "matplotlib", "optax", "rich", "typer"} & set(sys.modules)
assert not heavy, heavy
from jax._src import xla_bridge
assert not xla_bridge.backends_are_initialized()
"""


def test_clean_import():
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert done.stderr == ""
