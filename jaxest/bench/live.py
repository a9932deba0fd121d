"""Live use: the deflection filter fed by another process through a UDP port at 1 kHz, each step on the clock.

It runs in a process of its own, on one core (`alone`), with one thread for XLA (`NPROC=1`): handing the small kernels
of a single robot from core to core costs more than it saves, and one that waits for another core to wake is what makes
the slowest steps. The sender has the others; where there are none, the loop sleeps between samples instead of asking.

A core does not always run at its speed: virtual machines were seen whose cores take eleven times as long for anything
during some ten milliseconds. So a piece of work that is always the same is timed beside every step.
"""

import itertools
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest import kinematics, live, models
from jaxest.bench.deflection import SENSORS
from jaxest.bench.harness import Progress
from jaxest.io.report import Row
from jaxest.live import latency
from jaxest.live.sources import Source
from jaxest.systems import deflection

RATE_HZ, DEADLINE, PARTICLES = 1000, 1e-3, 64
SECONDS = 20.0
QUICK = {"NPROC": "1"}
LONGEST = 60.0  # s, of each control
LITTLE = 0.1  # share of a step that the second control takes
ROUNDS = 64  # products by which a control is measured
WARM = 0.2  # share of a run behind which memory may grow no more
YARDSTICK = 4  # products, of some 5 us each
USUAL = 1.5  # times its median that the yardstick may take, before and behind a step, at the core's usual speed

SENDER = """
import json, os, socket, sys, time
host, port, rate, lines = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), sys.stdin.read().splitlines()
count, cores = int(sys.argv[4]), json.loads(sys.argv[5])
if cores:
    os.sched_setaffinity(0, cores)
values = [json.loads(line) for line in lines]
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
begun = time.perf_counter()
for i in range(count):
    line = json.dumps({"time": i / rate, **values[i % len(values)]}).encode()
    pause = begun + i / rate - time.perf_counter()
    if pause > 0:
        time.sleep(pause)
    out.sendto(line, (host, port))
time.sleep(0.2)
out.sendto(b"", (host, port))
"""


class Fed(NamedTuple):
    """A live run and the memory of its process."""

    outcome: live.Outcome
    sent: int
    grown: float
    """MiB, how much the peak of the process rose behind the first fifth of the run."""
    took: NDArray[np.float64]
    """(steps,) s, from a sample at hand to behind its step."""
    yardstick: NDArray[np.float64]
    """(steps,) s, of work that is always the same, just behind each step."""

    def usual(self) -> NDArray[np.bool_]:
        """Return (steps,) whether the core ran at its usual speed before and behind a step."""
        slow = self.yardstick > USUAL * np.median(self.yardstick)
        return ~(slow | np.concatenate([slow[:1], slow[:-1]]))


def rows(*, peers: bool, progress: Progress, small: bool = False, seconds: float = SECONDS) -> Iterable[Row]:
    """Run the packaged arm's filter live.

    Args:
        peers: not used; nobody else's filter stands beside it.
        progress: hears what is being measured.
        small: half a second.
        seconds: of the run.

    Yields:
        Share of steps within 1 ms beside that of NumPy work as long as a step, the share of steps at the core's usual
        speed within it, how often that was, the share of NumPy work a tenth as long, quantiles of a step's time,
        samples that never arrived, growth of memory.
    """
    del peers
    seconds = 0.5 if small else seconds
    progress(f"live, {seconds:.0f} s")
    words = [sys.executable, "-m", "jaxest.bench.live", repr(seconds)]
    done = subprocess.run(words, env={**os.environ, **QUICK}, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"the live process failed:\n{done.stderr}")
    yield from (Row(**one) for one in json.loads(done.stdout.splitlines()[-1]))


def measured(seconds: float) -> Iterable[Row]:
    """Run live in this process and make the rows of `rows`."""
    found = fed(seconds, cores=alone())
    step, n = found.outcome.latency, found.outcome.steps
    where = f"arm of 4 joints, 4 sensors, guided, {PARTICLES} particles, {RATE_HZ} Hz by UDP for {seconds:.4g} s"
    reached = 100 * (1 - found.outcome.missed / max(n, 1))
    plain, little = (control(share * step.quantile(0.5), min(seconds, LONGEST)) for share in (1, LITTLE))
    yield Row("steps within 1 ms", where, reached, "%", None, n, 100 * plain.share_within(DEADLINE),
              f"NumPy work of {plain.quantile(0.5) * 1e6:.0f} us at the median, at the same rate")  # fmt: skip
    usual = found.usual()
    yield Row("steps within 1 ms, core at its usual speed",
              f"where a fixed piece of work took less than {USUAL:g} times its median before and behind the step",
              100 * float(np.mean(found.took[usual] <= DEADLINE)), "%", n=int(usual.sum()))  # fmt: skip
    yield Row("core at its usual speed", f"median of the piece {np.median(found.yardstick) * 1e6:.0f} us",
              100 * float(usual.mean()), "%", n=n)  # fmt: skip
    yield Row("a tenth of that work within 1 ms", f"{little.quantile(0.5) * 1e6:.0f} us at the median, at that rate",
              100 * little.share_within(DEADLINE), "%", n=little.number)  # fmt: skip
    for share in (0.5, 0.99, 0.999):
        yield Row(f"step, {100 * share:g} %", where, step.quantile(share) * 1e6, "us", n=n)
    yield Row("step, longest", where, step.longest * 1e6, "us", n=n)
    yield Row("samples that never arrived", where, float(found.sent - n - found.outcome.late), "1", n=found.sent)
    yield Row("growth of memory", f"{where}, behind the first fifth", found.grown, "MiB")


def alone() -> list[int]:
    """Keep this process, before it has threads, on the last of its cores, and return the others, if there are any."""
    if not hasattr(os, "sched_setaffinity"):
        return []
    *others, last = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, [last])
    return others


def fed(seconds: float, particles: int = PARTICLES, cores: Sequence[int] = ()) -> Fed:
    """Start a sender and drive the filter until it ends.

    Args:
        seconds: how long.
        particles: number N.
        cores: for the sender, while this process asks for samples without sleeping; none: they share its own.

    Returns:
        The run.
    """
    robot = kinematics.load(models.path("arm"))
    system = deflection.build(robot, SENSORS, particles=particles, proposal=deflection.guided)
    params = jax.tree.map(jnp.float32, system.default_params)
    key = jax.random.key(0)
    measurements, _ = jax.jit(lambda key: system.simulate(params, key=key, steps=RATE_HZ))(key)
    measurements = jax.tree.map(np.asarray, measurements)
    template = jax.tree.map(lambda x: x[0], measurements)
    count, peaks = round(seconds * RATE_HZ), []
    at = {round(WARM * count), count - 1}
    tick, begun = itertools.count(), [0.0]
    took, yardstick = np.ones(count), np.ones(count)  # written, so that memory does not grow by them
    work = _products()

    def emit(stamp: float, info: Any) -> None:
        i = next(tick)
        took[i] = time.perf_counter() - begun[0]
        yardstick[i] = work(YARDSTICK)
        if i in at:
            peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)

    def handed(source: Source) -> Source:
        for sample in source:
            begun[0] = time.perf_counter()
            yield sample

    senders = []

    def start(address: tuple[str, int]) -> None:
        words = [sys.executable, "-c", SENDER, address[0], str(address[1]), str(RATE_HZ), str(count), json.dumps(cores)]
        sender = subprocess.Popen(words, stdin=subprocess.PIPE, text=True)
        assert sender.stdin
        sender.stdin.write(_lines(measurements))
        sender.stdin.close()
        senders.append(sender)

    source = handed(_while_sent(live.from_udp(0, ready=start, busy=bool(cores)), senders))
    outcome = live.drive(system.step, params, system.init(params, key=key), source, template, key=key,
                         deadline=DEADLINE, emit=emit)  # fmt: skip
    for sender in senders:
        sender.wait()
    unit = 2**10 if sys.platform == "linux" else 2**20
    grown = (peaks[-1] - peaks[0]) / unit if len(peaks) > 1 else 0.0
    return Fed(outcome, count, grown, took[: outcome.steps], yardstick[: outcome.steps])


def control(work: float, seconds: float) -> latency.Latency:
    """Do NumPy work at the loop's rate and time it: what is slow here, the machine made slow.

    Args:
        work: s, how long it takes at the median.
        seconds: how long to go on.

    Returns:
        How long it took each time.
    """
    busy = _products()

    def timed(rounds: int, count: int) -> latency.Latency:
        found = latency.empty()
        for _ in range(count):
            begun = time.perf_counter()
            found = latency.counted(found, busy(rounds))
            time.sleep(max(begun + 1 / RATE_HZ - time.perf_counter(), 0))
        return found

    rounds, found = ROUNDS, latency.empty()
    some = timed(rounds, RATE_HZ // 2).quantile(0.5)
    for _ in range(max(1, round(seconds))):  # measured anew each second: the clock of a core changes
        rounds = max(1, round(rounds * work / some))
        piece = timed(rounds, round(min(seconds, 1) * RATE_HZ))
        some = piece.quantile(0.5)
        found = latency.joined(found, piece)
    return found


def _products() -> Callable[[int], float]:
    """NumPy work: does a number of matrix products and returns how long they took (s)."""
    matrix, into = np.eye(64, dtype=np.float32), np.empty((64, 64), np.float32)

    def work(rounds: int) -> float:
        begun = time.perf_counter()
        for _ in range(rounds):
            np.matmul(matrix, matrix, out=into)
        return time.perf_counter() - begun

    return work


def _while_sent(source: Source, senders: list[Any]) -> Source:
    """End where the sender has, too: its last datagram is lost where the machine is too slow for the others."""
    for sample in source:
        if sample is live.IDLE and senders and senders[0].poll() is not None:
            return
        yield sample


def _lines(measurements: Any) -> str:
    """One line of JSON a step, null where a sensor was silent."""
    from jaxest.live.measure import fields

    names = fields(measurements)

    def value(reading: Any, i: int) -> Any:
        return reading.value[i].tolist() if np.all(reading.valid[i]) else None

    length = len(measurements.dt)
    return "\n".join(json.dumps({n: value(getattr(measurements, n), i) for n in names}) for i in range(length))


__all__ = ["Fed", "alone", "control", "fed", "measured", "rows"]

if __name__ == "__main__":
    print(json.dumps([row._asdict() for row in measured(float(sys.argv[1]))]))  # noqa: T201
