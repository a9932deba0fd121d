"""Relative pose of two IMUs: a live step from Python, and a thousand pairs over one recording each."""

from collections.abc import Iterable
from functools import partial
from typing import Any

import jax
import numpy as np

from jaxest.bench.harness import Candidate, Progress, candidate, compare, compile_row, race
from jaxest.bench.onsite_loop import loop
from jaxest.filters import last, run
from jaxest.io.report import Row
from jaxest.systems import onsite


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time window, rotation and position of one pair, float32, default window.

    The peer is a loop in NumPy, float64, that does the same with NumPy's own solvers: fit of the window, mode of the
    Bingham density, recursive least squares, covariances.

    Args:
        peers: whether to run the loop.
        progress: hears what is being measured.
        small: a few pairs and samples.

    Yields:
        The time of one live step called from Python with NumPy readings and waited for; of one sample of one pair when
        1000 pairs of 4000 samples run at once, with the same stamps and with stamps of their own; and the time to
        compile either.
    """
    progress("live step")
    system = onsite.build()
    params = jax.tree.map(np.float32, system.default_params)
    count = 20 if small else 200
    samples = jax.tree.map(np.asarray, system.simulate(params, key=jax.random.key(0), steps=count)[0])
    one = [jax.tree.map(lambda x, i=i: x[i], samples) for i in range(count)]
    step, state = jax.jit(system.step), system.init(params)
    params = jax.device_put(params)
    compiled = candidate("live", step, params, state, one[0])
    candidates = [Candidate("live", partial(_walk, step, params, state, one), count, compiled.compile_s)]
    if peers:
        candidates.append(Candidate("loop", partial(loop, samples), count))
    timings = race(candidates, repeats=2 if small else 10)
    peer = timings["loop"]._replace(name="NumPy, the same step by step") if peers else None
    yield compare("live step", "one pair, each step waited for", timings["live"], peer)
    yield compile_row("one pair", timings["live"])
    yield from _batched(system, params, samples, peers, progress, small)


def _batched(
    system: Any, params: Any, samples: Any, peers: bool, progress: Progress, small: bool
) -> Iterable[Row]:  # fmt: skip
    pairs, length = (3, 20) if small else (1000, 4000)
    progress(f"{pairs} pairs x {length} samples")
    draw = jax.jit(jax.vmap(lambda key: system.simulate(params, key=key, steps=length)[0]))
    measurements = draw(jax.random.split(jax.random.key(1), pairs))

    def final(one: Any) -> Any:
        info = run(system.step, params, system.init(params), one, history=last)[1]
        return info.position, info.quaternion, info.covariance

    every = jax.jit(jax.vmap(final))
    uneven = np.random.default_rng(2).uniform(0.8, 1.2, (pairs, length)).astype(np.float32)
    jittered = measurements._replace(dt=measurements.dt * uneven)
    candidates = [candidate("batched", every, measurements, items=pairs * length)]
    candidates.append(Candidate("own", partial(every, jittered), pairs * length))
    if peers:
        candidates.append(Candidate("loop", partial(loop, samples), len(samples.dt)))
    timings = race(candidates, repeats=2 if small else 4)
    peer = timings["loop"]._replace(name="NumPy, the same step by step") if peers else None
    condition = f"{pairs} pairs at once, per sample and pair"
    yield compare("batched step", condition, timings["batched"], peer)
    yield compare("batched step", f"{condition}, stamps of their own", timings["own"], peer)
    yield compile_row(f"{pairs} pairs, {length} samples", timings["batched"])


def _walk(step: Any, params: Any, state: Any, measurements: list[Any]) -> Any:
    for measurement in measurements:
        state, info = step(params, state, measurement)
        info.position.block_until_ready()
    return state
