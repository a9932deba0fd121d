"""All recordings x 260 settings of the complementary filter in one call, beside the same as a compiled C loop.

    python benchmarks/complementary_sweep.py [STEPS]

The C loop (`complementary_loop.c`) is compiled here with `gcc -O3 -march=native -ffast-math` and run on one thread and
on two, half of the recordings each; it is given unit vectors, so that it normalises nothing again. Neither stores a
history. Printed are nanoseconds a sample and setting, the median over rounds in which all ran in turn.
"""

import ctypes
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import jax
import numpy as np

from jaxest.bench.harness import Candidate, candidate, race
from jaxest.filters.complementary import Params
from jaxest.filters.complementary_sweep import sweep
from jaxest.metrics import orientation_error
from jaxest.systems import orientation

FLAGS = ("-O3", "-march=native", "-ffast-math")
TRIALS, SETTINGS, RATE_HZ = 20, 260, 285.714
FLOATS = ctypes.POINTER(ctypes.c_float)


def main(steps: int) -> None:
    """Time and compare."""
    params = jax.tree.map(np.float32, orientation.build().default_params)
    keys = jax.random.split(jax.random.key(1), TRIALS)
    draw = jax.jit(jax.vmap(lambda k: orientation.simulate(params, key=k, steps=steps, rate_hz=RATE_HZ)[0]))
    measurements = draw(keys)
    ones = np.ones(SETTINGS, np.float32)
    gains = Params(
        np.geomspace(0.05, 5.0, SETTINGS, dtype=np.float32), np.geomspace(1e-5, 1e-1, SETTINGS, dtype=np.float32),
        ones, ones,
    )  # fmt: skip
    pieces = TRIALS * SETTINGS * steps
    candidates = [candidate("jaxest", sweep, gains, measurements, items=pieces)]
    loop = _loop()
    if loop is None:
        print("no gcc: the C loop is left out")
    else:
        run, out = _bound(loop, measurements, gains, steps)
        candidates += [
            Candidate("C, 1 thread", lambda: run(1), pieces),
            Candidate("C, 2 threads", lambda: run(2), pieces),
        ]
        run(1)
        ours = np.asarray(sweep(gains, measurements).quaternion)
        apart = orientation_error(out, ours).total
        print(f"largest difference of the final orientations: {np.rad2deg(apart.max()):.2f} deg, median "
              f"{np.rad2deg(np.median(apart)):.6f} deg")  # fmt: skip
    for timing in race(candidates, repeats=5).values():
        compiled = "" if timing.compile_s is None else f", compiled in {timing.compile_s:.1f} s"
        print(f"{timing.name:14s} {1e9 * timing.median:7.2f} ns (spread {1e9 * timing.spread:.2f}){compiled}")


def _loop() -> ctypes.CDLL | None:
    gcc = shutil.which("gcc")
    if gcc is None:
        return None
    target = Path(tempfile.mkdtemp()) / "loop.so"
    source = Path(__file__).with_name("complementary_loop.c")
    subprocess.run([gcc, *FLAGS, "-shared", "-fPIC", "-o", str(target), str(source), "-lm"], check=True)
    print(f"C loop: gcc {' '.join(FLAGS)}")
    return ctypes.CDLL(str(target))


def _bound(loop: ctypes.CDLL, measurements, gains, steps: int):
    """A function that runs the loop on some threads, and the quaternions (trials, settings, 4) that it fills in."""
    gyr, acc, mag = (np.asarray(x.value, np.float32) for x in measurements[:3])
    acc, mag = (np.ascontiguousarray(v / np.linalg.norm(v, axis=-1, keepdims=True)) for v in (acc, mag))
    pair = np.ascontiguousarray(np.stack(gains[:2], axis=1))
    out = np.zeros((TRIALS, SETTINGS, 4), np.float32)

    def part(first: int, count: int) -> None:
        arrays = [x[first:].ctypes.data_as(FLOATS) for x in (gyr, acc, mag)]
        sizes = [ctypes.c_long(n) for n in (count, steps, SETTINGS)]
        loop.filter(*arrays, ctypes.c_float(1 / RATE_HZ), pair.ctypes.data_as(FLOATS), *sizes,
                    out[first:].ctypes.data_as(FLOATS))  # fmt: skip

    def run(threads: int) -> np.ndarray:
        share = TRIALS // threads
        workers = [threading.Thread(target=part, args=(k * share, share)) for k in range(threads)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        return out

    return run, out


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
