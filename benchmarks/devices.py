"""What spreading over devices costs and gives on one processor that is split into 1 to 8 devices.

    python benchmarks/devices.py [1 2 4 8] [--small] [--json]

Each number of devices is a process of its own. Measured are a batch of independent filters (4096 robots, a second of
orientation at 100 Hz, `parallel.shards`) and a bootstrap step of one filter's 65,536 particles
(`parallel.particles.filter_step`), and whether both give the bits that one device gives. On a machine with real
accelerators, where nothing is to be split, `jaxest bench scaling` with `--devices` left out says the same for one.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
from typing import Any


def child(small: bool) -> dict[str, Any]:
    """Measure in this process, with the devices that it has."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxest import kinematics, models, parallel
    from jaxest.bench.deflection import SENSORS
    from jaxest.bench.harness import Candidate, race
    from jaxest.filters import last, run
    from jaxest.systems import deflection, orientation

    robots, count = (64, 1024) if small else (4096, 65536)
    system = orientation.build(sensors=("gyroscope", "accelerometer"))
    params = jax.tree.map(jnp.float32, system.default_params)
    seen = jax.jit(lambda key: system.simulate(params, key=key, steps=100, rate_hz=100.0)[0])(jax.random.key(0))
    batch = jax.tree.map(lambda x: np.repeat(np.asarray(x)[None], robots, axis=0), seen)
    spread = parallel.shards(lambda one: run(system.step, params, system.init(params), one, history=last)[1].quaternion)

    arm = deflection.build(kinematics.load(models.path("arm")), SENSORS, particles=count)
    given, key = jax.tree.map(jnp.asarray, arm.default_params), jax.random.key(0)
    samples = jax.jit(lambda key: arm.simulate(given, key=key, steps=2, missing=0.0)[0])(key)
    first, second = (jax.tree.map(lambda x, i=i: x[i], samples) for i in range(2))
    filter_step = parallel.particles.filter_step(arm.step.args[0])
    step = jax.jit(lambda state, sample: filter_step(given, state, sample, key=key))
    state, _ = step(arm.init(given, key=key), first)
    calls = {"robots": lambda: spread(batch), "particles": lambda: step(state, second)[1].mean}
    bits = {name: hashlib.sha256(np.asarray(call()).tobytes()).hexdigest() for name, call in calls.items()}
    found = race([Candidate(name, call) for name, call in calls.items()], repeats=3 if small else 9)
    return {name: (1e3 * found[name].median, 1e3 * found[name].spread, bits[name]) for name in calls}


def main(arguments: list[str]) -> int:
    """Run a process for each number of devices, and return 1 if their bits differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("devices", nargs="*", type=int)
    parser.add_argument("--small", action="store_true", help="tiny sizes, to see that it runs")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.child:
        print(json.dumps(child(given.small)))
        return 0
    from jaxest.io.report import Row, report, to_json

    words = [sys.executable, __file__, "--child", *(["--small"] if given.small else [])]
    rows, alone, differ = [], {}, False
    for count in given.devices or [1, 2, 4, 8]:
        flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={count}"
        environment = os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
        done = subprocess.run(words, env=environment, stdout=subprocess.PIPE, check=True)
        for name, (value, spread, bits) in json.loads(done.stdout).items():
            one, expected = alone.setdefault(name, (value, bits))
            differ = differ or bits != expected
            same = "the same bits" if bits == expected else "OTHER BITS"
            rows.append(
                Row(name, f"{count} devices, {same}", value, "ms", spread, 9, one, "the first row", one / value)
            )
            told = f"{value:8.2f} ms (spread {spread:.2f}), {one / value:.2f} times as fast, {same}"
            print(f"{name:10s} {count} devices {told}", file=sys.stderr)
    if given.json:
        print(to_json(report("devices", rows)))
    return int(differ)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
