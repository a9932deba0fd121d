"""The same numbers on one device, on two devices, and on two processes over the loopback address."""

import os
import socket
import subprocess
import sys

import jax
import numpy as np
import pytest

from jaxest import parallel

PROGRAM = """
import sys
import jax, numpy as np
rank, count, port, out = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], sys.argv[4]
if count > 1:
    jax.distributed.initialize(f"127.0.0.1:{port}", count, rank)
from jaxest import parallel
from jaxest.filters import last, run
from jaxest.systems import orientation
system = orientation.build()
params = jax.tree.map(np.float32, system.default_params)
samples, _ = orientation.simulate(params, key=jax.random.key(0), steps=50)
samples = jax.tree.map(np.asarray, samples)
def one(gain):
    tuned = params._replace(proportional_gain=gain)
    return run(system.step, tuned, system.init(params), samples, history=last)[0].quaternion
gains = np.linspace(0.1, 2.0, 7, dtype=np.float32)
found = parallel.gather(parallel.shards(one)(gains))
assert found.shape == (7, 4), found.shape
np.save(f"{out}{rank}.npy", found)
print(len(jax.devices()), jax.process_count())
"""


def start(tmp_path, name, rank=0, count=1, port=0, devices=1):
    # The compiler's effort would be most of the time, and all compare with the same.
    flags = f"--xla_force_host_platform_device_count={devices} --xla_backend_optimization_level=0"
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    arguments = [str(rank), str(count), str(port), str(tmp_path / name)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-c", PROGRAM, *arguments], env=environment, **pipes)


def finish(process):
    out, error = process.communicate(timeout=240)
    assert process.returncode == 0, error
    return out.strip().splitlines()[-1]


def test_devices_and_processes_give_the_same_bits(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    alone = start(tmp_path, "alone")
    pair = start(tmp_path, "pair", devices=2)
    assert [finish(alone), finish(pair)] == ["1 1", "2 1"]
    processes = [start(tmp_path, "process", rank, 2, port) for rank in range(2)]
    assert [finish(process) for process in processes] == ["2 2", "2 2"]
    expected = np.load(tmp_path / "alone0.npy")
    assert np.ptp(expected, axis=0).max() > 1e-4  # the gains matter
    for name in ("pair0", "process0", "process1"):
        np.testing.assert_array_equal(np.load(tmp_path / f"{name}.npy"), expected)


def test_one_device_equals_vmap_and_keys_are_items_too():
    keys = jax.random.split(jax.random.key(0), 5)
    values = np.arange(5, dtype=np.float32)
    found = parallel.gather(parallel.shards(lambda key, x: x + jax.random.normal(key))(keys, values))
    expected = jax.jit(jax.vmap(lambda key, x: x + jax.random.normal(key)))(keys, values)
    np.testing.assert_array_equal(found, expected)


def test_shapes_are_those_of_the_run():
    spread = parallel.shards(lambda a, x: a * x, common=1)
    shape = jax.eval_shape(spread, np.float32(2), np.zeros((5, 3), np.float32))
    assert (shape.shape, shape.dtype) == ((5, 3), np.float32)
    np.testing.assert_array_equal(jax.jit(spread)(np.float32(2), np.ones(4, np.float32)), np.full(4, 2, np.float32))


def test_unequal_batches_are_refused():
    with pytest.raises(ValueError, match=r"batch: leading axes \[\(3,\), \(4,\)\]"):
        parallel.shards(lambda a, b: a + b)(np.zeros(3), np.zeros(4))
    with pytest.raises(ValueError, match=r"batch: leading axes \[\(\), \(3,\)\]"):
        parallel.shards(lambda a, b: a + b)(np.zeros(3), 1.0)
