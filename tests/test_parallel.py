"""The same numbers on one device, on two devices, and on two processes over the loopback address; lost processes."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import particle_models
import pytest

from jaxest import parallel
from jaxest.filters import particle, run
from jaxest.io import studies
from jaxest.parallel import hosts
from jaxest.types import InputError

PROGRAM = """
import os, sys
sys.path.insert(0, os.environ["TESTS"])
import jax, numpy as np
from jaxest import parallel
rank, count, port, out = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], sys.argv[4]
if count > 1:
    place = parallel.start(f"127.0.0.1:{port}", rank, count)
    assert place == (rank, count), place
import particle_models as models
from jaxest import tuning
from jaxest.filters import full, last, particle, run
from jaxest.systems import orientation
from jaxest.types import Reading
system = orientation.build(sensors=("gyroscope", "accelerometer"))
params = jax.tree.map(np.float32, system.default_params)
samples, truth = system.simulate(params, key=jax.random.key(0), steps=50, shaking=1.0)
samples, truth = jax.tree.map(np.asarray, (samples, truth))
def one(gain):
    tuned = params._replace(proportional_gain=gain)
    return run(system.step, tuned, system.init(params), samples, history=last)[0].quaternion
gains = np.linspace(0.1, 2.0, 7, dtype=np.float32)
found = parallel.gather(parallel.shards(one)(gains))
assert found.shape == (7, 4), found.shape

space = tuning.space(params, ["proportional_gain"])
problem = tuning.Problem(tuning.supervised(system, tuning.errors.inclination), space)
batch = tuning.padded([tuning.recording(samples, truth.quaternion)])
starts = np.log(np.array([[0.1], [1.0], [4.0]], np.float32))
tuned = tuning.minimise(problem, batch, starts=starts, evaluations=4, over=parallel.mesh())

model = particle.Model(models.JOINTS, models.BOOTSTRAP)
given = jax.tree.map(np.float32, models.Params())
angles = np.linspace([0.1, 0.2], [0.5, 0.9], 8, dtype=np.float32)
tips = np.stack([np.cos(angles[:, 0]) + np.cos(angles.sum(1)), np.sin(angles[:, 0]) + np.sin(angles.sum(1))], axis=1)
there = np.ones(8, bool)
seen = models.Seen(Reading(angles, there[:, None] | (angles > 9)), Reading(tips, there), np.full(8, 0.1, np.float32))
drawn = np.random.default_rng(0).uniform(-1, 1, (64, 2)).astype(np.float32)
state = particle.State(drawn, np.full(64, -np.log(64), np.float32), np.int32(0))
step = parallel.particles.filter_step(model, blocks=4)
_, info = run(step, given, state, seen, key=jax.random.key(3), history=full)
here = [np.asarray(x.addressable_data(0)) for x in (info.mean, info.log_likelihood)]
np.savez(f"{out}{rank}.npz", gains=found, points=np.asarray(tuned.points), values=tuned.values, mean=here[0],
         evidence=here[1])
print(len(jax.devices()), jax.process_count())
"""
STUDY = """
import os, sys
import jax, numpy as np
from jaxest import parallel
from jaxest.io import studies
rank, count, port, out, dies = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], sys.argv[4], sys.argv[5]
if count > 1:
    parallel.start(f"127.0.0.1:{port}", rank, count, patience=10)
spread = parallel.shards(lambda key, x: {"sum": x + jax.random.normal(key, (3,))})
heard = []
def run(items):
    heard.extend([] if isinstance(items[1], jax.core.Tracer) else [1])  # traced for the shapes
    if len(heard) == 3 and rank == 1 and dies == "dies":
        os._exit(9)
    return spread(*items)
items = jax.random.split(jax.random.key(0), 10), np.arange(10, dtype=np.float32)
results = studies.study(run, items, piece=3, folder=out, say=lambda line: print(line, flush=True))
assert results["sum"].shape == (10, 3)
print(len(heard))
"""


SLURM = """
import jax, numpy as np
from jaxest import parallel
place = parallel.start()
doubled = parallel.gather(parallel.shards(lambda x: 2 * x)(np.arange(5.0)))
print(*place, jax.device_count(), doubled.tolist())
"""


def start(tmp_path, name, rank=0, count=1, port=0, devices=1, program=PROGRAM, more=()):
    # The compiler's effort would be most of the time. Its fused loops are those that users have: without them last bits
    # depend on how many items a device holds.
    flags = f"--xla_force_host_platform_device_count={devices} --xla_backend_optimization_level=0"
    tests = str(Path(__file__).parent)
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu", "TESTS": tests}
    arguments = [str(rank), str(count), str(port), str(tmp_path / name), *more]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-c", program, *arguments], env=environment, **pipes)


def finish(process):
    out, error = process.communicate(timeout=240)
    assert process.returncode == 0, error
    return out.strip().splitlines()[-1]


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def test_devices_and_processes_give_the_same_bits(tmp_path):
    """Independent items, starts of a tuning, and the particles of one filter."""
    alone = start(tmp_path, "alone")
    pair = start(tmp_path, "pair", devices=2)
    assert [finish(alone), finish(pair)] == ["1 1", "2 1"]
    port = free_port()
    processes = [start(tmp_path, "process", rank, 2, port) for rank in range(2)]
    assert [finish(process) for process in processes] == ["2 2", "2 2"]
    expected = np.load(tmp_path / "alone0.npz")
    assert np.ptp(expected["gains"], axis=0).max() > 1e-4  # the gains matter
    assert np.ptp(expected["mean"], axis=0).min() > 1e-2
    for name in ("pair0", "process0", "process1"):
        found = np.load(tmp_path / f"{name}.npz")
        for part in expected.files:
            np.testing.assert_array_equal(found[part], expected[part], err_msg=f"{name}, {part}")


@pytest.mark.slow  # two processes for an edge of JAX's own
def test_processes_find_each_other_by_the_variables_that_slurm_sets():
    """On one host; no cluster is at hand."""
    job = {"SLURM_JOB_ID": str(os.getpid()), "SLURM_STEP_NODELIST": "localhost", "SLURM_NTASKS": "2"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    words = [sys.executable, "-c", SLURM]
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", **job}
    processes = [
        subprocess.Popen(words, env={**environment, "SLURM_PROCID": rank, "SLURM_LOCALID": rank}, **pipes)
        for rank in "01"
    ]
    assert [finish(process) for process in processes] == [f"{rank} 2 2 [0.0, 2.0, 4.0, 6.0, 8.0]" for rank in "01"]


def test_a_lost_process_is_named_and_the_study_goes_on(tmp_path):
    """One of two ends in the third piece of four: the other says so; a single process finishes from the second."""
    port = free_port()
    first, second = (start(tmp_path, "kept", rank, 2, port, program=STUDY, more=("dies",)) for rank in range(2))
    second.communicate(timeout=240)
    out, error = first.communicate(timeout=240)
    assert second.returncode == 9
    assert first.returncode not in (0, None)
    assert "another process was lost in the piece from run 6" in error, error
    assert [line.split(",")[0] for line in out.splitlines() if " of 10 " in line] == ["3 of 10 runs", "6 of 10 runs"]
    again = finish(start(tmp_path, "kept", program=STUDY, more=("lives",)))
    assert again == "2"  # the pieces that were left
    finish(start(tmp_path, "whole", program=STUDY, more=("lives",)))
    kept, whole = (np.load(tmp_path / name / "results.npz") for name in ("kept", "whole"))
    assert set(kept.files) == set(whole.files)
    for name in kept.files:
        np.testing.assert_array_equal(kept[name], whole[name])


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


def test_bad_spreads_are_refused():
    model = particle.Model(particle_models.JOINTS, particle_models.BOOTSTRAP)
    with pytest.raises(ValueError, match=r"blocks: got 0, expected a multiple of the 1 device"):
        parallel.particles.filter_step(model, blocks=0)
    with pytest.raises(ValueError, match=r"model: a guided proposal wants few particles"):
        parallel.particles.filter_step(model._replace(propose=particle_models.GUIDED))
    step = parallel.particles.filter_step(model, parallel.mesh(), blocks=8)
    assert step is parallel.particles.filter_step(model, parallel.mesh(), blocks=8)
    params = jax.tree.map(np.float32, particle_models.Params())
    seen, _ = particle_models.simulate(params, key=jax.random.key(1), steps=1)
    state = particle_models.start(params, key=jax.random.key(2), count=20)
    first = jax.tree.map(lambda x: x[0], seen)
    with pytest.raises(ValueError, match="particles: got 20, expected a multiple of the 8 blocks"):
        step(params, state, first, key=jax.random.key(3))
    with pytest.raises(ValueError, match="key: got None"):
        step(params, state, first)


def test_one_block_is_the_plain_filter():
    """The same draws, so the same numbers; with several blocks others, of the same distribution."""
    model = particle.Model(particle_models.JOINTS, particle_models.BOOTSTRAP, ancestors=True)
    params = jax.tree.map(np.float32, particle_models.Params())
    seen, _ = particle_models.simulate(params, key=jax.random.key(1))
    state = particle_models.start(params, key=jax.random.key(2), count=2048)
    steps = [particle.filter_step(model), *(parallel.particles.filter_step(model, blocks=n) for n in (1, 4))]
    plain, one, four = (run(step, params, state, seen, key=jax.random.key(3))[1] for step in steps)
    jax.tree.map(np.testing.assert_array_equal, one, plain)
    sd = np.sqrt(np.diagonal(plain.covariance, axis1=1, axis2=2) / plain.ess[:, None])
    off = np.abs(four.mean - plain.mean) / sd
    assert 0 < off.max() < 6  # both scatter, and errors of earlier steps are carried on
    assert (np.asarray(four.ancestors) < 2048).all()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("host0", "got 'host0', expected HOST:PORT,RANK/COUNT"),
        ("host0:1,a/2", "got 'host0:1,a/2'"),
        ("host0:1,2/2", "got rank 2 of 2, expected 0 to 1"),
    ],
)
def test_bad_places_are_refused(words, said):
    with pytest.raises(InputError, match=said):
        hosts.start(*hosts.parse(words))
    with pytest.raises(InputError, match="go together"):
        hosts.start("host0:1")
    assert hosts.parse("host0:12,1/4") == ("host0:12", 1, 4)
    assert hosts.parse("auto") == (None, None, None)


def test_a_study_goes_on_and_refuses_another(tmp_path):
    def twice(x):
        calls.extend([] if isinstance(x, jax.core.Tracer) else [x])  # traced for the shapes
        return spread(x)

    spread, calls = parallel.shards(lambda x: 2 * x), []
    items = np.arange(7.0, dtype=np.float32)
    found = studies.study(twice, items, piece=3, folder=tmp_path)
    np.testing.assert_array_equal(found, 2 * items)
    np.testing.assert_array_equal(np.load(tmp_path / studies.MERGED)["leaf0"], 2 * items)
    (tmp_path / "items00000003_3.npz").unlink()
    calls.clear()
    np.testing.assert_array_equal(studies.study(twice, items, piece=3, folder=tmp_path), found)
    assert len(calls) == 1
    np.testing.assert_array_equal(studies.study(twice, items, piece=7), found)
    with pytest.raises(InputError, match="belongs to a run with other data"):
        studies.study(twice, items + 1, piece=3, folder=tmp_path)
