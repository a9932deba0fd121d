"""The orientation of one IMU: a live step from Python, and thousands of filters over one recording."""

from collections.abc import Iterable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.bench import attitude_peers
from jaxest.bench.attitude_peers import PEERS
from jaxest.bench.harness import Candidate, Progress, Timing, candidate, compare, compile_row, find_peer, race
from jaxest.filters import attitude, last, run
from jaxest.io.report import Row
from jaxest.systems import orientation

RATE = 285.714  # Hz, as in the BROAD recordings
SYSTEMS = {
    "one filter": orientation.build(),
    "one filter with covariance": orientation.build(covariance=True),
    "one attitude.ekf": orientation.build(filter=attitude.ekf),
    "one attitude.decoupled": orientation.build(filter=attitude.decoupled),
    "one attitude.madgwick": orientation.build(filter=attitude.madgwick),
}


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time the filters of one IMU with a magnetometer, float32; the complementary one with and without covariance.

    The peer is VQF in C++: another filter for the same sensors, called by the same program on the same samples; the
    live step also beside `imufusion` and `ahrs`.

    Args:
        peers: whether to run the peer.
        progress: hears what is being measured.
        small: fewer filters and samples.

    Yields:
        The time of one live step called from Python with NumPy readings and waited for; of one sample of one filter
        when 20 recordings are each filtered with 260 settings at once (the attitude filters: 20 recordings with one);
        and the time to compile either.
    """
    vqf = find_peer("vqf") if peers else None
    missing = "vqf" if peers and vqf is None else ""
    yield from _live(vqf, peers, missing, progress, small)
    yield from _batched(vqf, missing, progress, small)
    yield from _recordings(vqf, missing, progress, small)


def _live(vqf: Any, peers: bool, missing: str, progress: Progress, small: bool) -> Iterable[Row]:
    progress("live step")
    count = 5 if small else 200
    samples = _samples(jax.random.key(0), count)
    one = [jax.tree.map(lambda x, i=i: x[i], samples) for i in range(count)]
    candidates = []
    chosen = dict(list(SYSTEMS.items())[:2] if small else SYSTEMS)
    for name, system in chosen.items():
        step = jax.jit(system.step)
        params = jax.tree.map(jnp.float32, system.default_params)  # on the device, where a live loop keeps them
        state = system.init(params)
        compiled = candidate(name, step, params, state, one[0])
        loop = partial(_walk, step, params, state, one)
        candidates.append(Candidate(name, loop, count, compiled.compile_s))
    if vqf is not None:
        candidates.append(Candidate("vqf", partial(_walk_vqf, vqf, samples), count))
    for name, other in attitude_peers.steps(1 / RATE, 9).items() if peers else ():
        candidates.append(Candidate(name, partial(_walk_other, other, samples), count))
    timings = race(candidates, repeats=2 if small else 20)
    peer = _named(timings.get("vqf"), "VQF in C++, update() from Python")
    for name in chosen:
        yield compare("live step", f"{name}, each step waited for", timings[name], peer, missing=missing)
        yield compile_row(name, timings[name])
    for name in PEERS if peers else ():
        ours, beside = timings["one filter"], _named(timings.get(name), f"{name}, update from Python")
        condition = "one filter, each step waited for"
        yield compare("live step", condition, ours, beside, missing="" if beside else PEERS[name])


def _batched(vqf: Any, missing: str, progress: Progress, small: bool) -> Iterable[Row]:
    trials, settings, length = (2, 3, 10) if small else (20, 260, 200)
    progress(f"{trials} recordings x {settings} settings")
    samples = jax.vmap(lambda key: _samples(key, length))(jax.random.split(jax.random.key(1), trials))
    system = orientation.build()
    gains = system.default_params._replace(
        proportional_gain=jnp.geomspace(0.05, 5.0, settings, dtype=jnp.float32),
        integral_gain=jnp.geomspace(1e-5, 1e-1, settings, dtype=jnp.float32),
        lambda_acc=jnp.ones(settings, jnp.float32),
        lambda_mag=jnp.ones(settings, jnp.float32),
    )

    def final(params: Any, measurements: Any) -> Any:
        return run(system.step, params, system.init(params), measurements, history=last)[0].quaternion

    every = jax.jit(jax.vmap(jax.vmap(final, in_axes=(0, None)), in_axes=(None, 0)))
    pieces = trials * settings * length
    candidates = [candidate("batched", every, gains, samples, items=pieces)]
    if vqf is not None:
        long = jax.tree.map(lambda x: np.asarray(x, np.float64).reshape(trials * length, *x.shape[2:]), samples)
        candidates.append(Candidate("vqf", partial(_batch_vqf, vqf, long), trials * length))
    timings = race(candidates, repeats=2 if small else 10)
    condition = f"{trials} recordings x {settings} settings at once, per sample and filter"
    peer = _named(timings.get("vqf"), "VQF in C++, updateBatch()")
    yield compare("batched step", condition, timings["batched"], peer, unit="ns", missing=missing)
    yield compile_row(f"{trials} x {settings}, {length} samples", timings["batched"])


def _recordings(vqf: Any, missing: str, progress: Progress, small: bool) -> Iterable[Row]:
    trials, length = (2, 10) if small else (20, 1000)
    progress(f"attitude filters, {trials} recordings")
    samples = jax.vmap(lambda key: _samples(key, length))(jax.random.split(jax.random.key(2), trials))
    candidates = []
    names = list(SYSTEMS)[3:] if small else list(SYSTEMS)[2:]
    for name in names:
        system = SYSTEMS[name]
        params = jax.tree.map(jnp.float32, system.default_params)

        def final(params: Any, measurements: Any, system: Any = system) -> Any:
            return run(system.step, params, system.init(params), measurements, history=last)[1].quaternion

        every = jax.jit(jax.vmap(final, in_axes=(None, 0)))
        candidates.append(candidate(name, every, params, samples, items=trials * length))
    if vqf is not None:
        long = jax.tree.map(lambda x: np.asarray(x, np.float64).reshape(trials * length, *x.shape[2:]), samples)
        candidates.append(Candidate("vqf", partial(_batch_vqf, vqf, long), trials * length))
    timings = race(candidates, repeats=2 if small else 5)
    peer = _named(timings.get("vqf"), "VQF in C++, updateBatch()")
    for each in candidates[: len(names)]:
        condition = f"{each.name.removeprefix('one ')}, {trials} recordings at once, per sample"
        yield compare("batched step", condition, timings[each.name], peer, unit="ns", missing=missing)
        yield compile_row(condition, timings[each.name])


def _samples(key: jax.Array, count: int) -> Any:
    params = jax.tree.map(np.float32, orientation.build().default_params)
    measurements, _ = orientation.simulate(params, key=key, steps=count, rate_hz=RATE)
    return jax.tree.map(np.asarray, measurements) if not isinstance(key, jax.core.Tracer) else measurements


def _walk(step: Any, params: Any, state: Any, measurements: list[Any]) -> Any:
    for measurement in measurements:
        state, info = step(params, state, measurement)
        info.quaternion.block_until_ready()
    return state


def _walk_vqf(vqf: Any, samples: Any) -> Any:
    filter_ = vqf.VQF(1 / RATE)
    readings = (np.ascontiguousarray(np.asarray(sensor.value, np.float64)) for sensor in samples[:3])
    for gyr, acc, mag in zip(*readings, strict=True):
        filter_.update(gyr, acc, mag)
        filter_.getQuat9D()
    return None


def _walk_other(step: Any, samples: Any) -> Any:
    readings = (np.ascontiguousarray(np.asarray(sensor.value, np.float64)) for sensor in samples[:3])
    for reading in zip(*readings, strict=True):
        step(*reading)
    return None


def _batch_vqf(vqf: Any, samples: Any) -> Any:
    readings = (np.ascontiguousarray(sensor.value) for sensor in samples[:3])
    return vqf.VQF(1 / RATE).updateBatch(*readings)


def _named(timing: Timing | None, name: str) -> Timing | None:
    return None if timing is None else timing._replace(name=name)
