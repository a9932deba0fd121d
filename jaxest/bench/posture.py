"""Posture from IMUs: the pair filter over an edge list, and whole steps of a gripper and a person's arm."""

from collections.abc import Iterable
from functools import partial
from typing import Any

import jax
import numpy as np

from jaxest import kinematics, models
from jaxest.bench import posture_loop
from jaxest.bench.harness import Candidate, Progress, candidate, compare, compile_row, race
from jaxest.filters import attitude, complementary, last, pair, run
from jaxest.io.report import Row
from jaxest.simulate import grasp
from jaxest.systems import posture

ARM = tuple(f"site:imu_{name}" for name in ("trunk", "upper_arm", "forearm", "hand"))
EDGES = ((6, 2), (2, 1), (1, 0), (2, 0), (6, 5), (5, 4), (4, 3), (5, 3))
"""Of the gripper's seven IMUs: palm to both fingers, along them, and each finger's redundant pair."""
RATE_HZ = 100.0


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time posture, float32, with magnetometers.

    The peers are loops in NumPy, float64: the same pair filter; and a complementary filter an IMU with two Gauss-Newton
    steps on MuJoCo's kinematics, which is what the system does with that filter (by default it has a better one).

    Args:
        peers: whether to run the loops.
        progress: hears what is being measured.
        small: few robots and samples.

    Yields:
        The time of a live step called from Python with NumPy readings and waited for; of one sample of one robot when
        many run at once; and the time to compile either.
    """
    robots = {name: kinematics.load(models.path(name)) for name in ("gripper", "human_arm")}
    gripper = posture.build(robots["gripper"], grasp.SITES, magnetic=True)
    init, step = pair.over(EDGES, len(grasp.SITES))
    gains = jax.tree.map(np.float32, complementary.Params(1.0, 0.01, 1.0, 1.0))
    samples = _samples(gripper, 20 if small else 200)
    loop = partial(posture_loop.pairs, samples, EDGES) if peers else None
    progress(f"pair filter, {len(EDGES)} edges")
    yield from _live("pair filter, 8 edges", step, gains, init(gains), samples, loop, small)
    yield from _batched("pair filter, 8 edges", step, init, gains, gripper, loop, small)
    progress("posture of the gripper, 7 IMUs")
    params = jax.tree.map(np.float32, gripper.default_params)
    yield from _live("gripper, 7 IMUs, ekf", gripper.step, params, gripper.init(params), samples, None, small)
    modules: dict[str, Any] = {"complementary": complementary, "ekf": attitude.ekf}
    for filter_name, module in modules.items():
        name = f"arm, 4 IMUs, {filter_name}"
        progress(name)
        system = posture.build(robots["human_arm"], ARM, magnetic=True, filter=module)
        params = jax.tree.map(np.float32, system.default_params)
        moving = _samples(system, 20 if small else 200)
        mine = partial(_arm_loop, moving) if peers else None
        yield from _live(name, system.step, params, system.init(params), moving, mine, small)
        if module is complementary:
            yield from _batched(name, system.step, system.init, params, system, mine, small)


def _live(
    name: str, step: Any, params: Any, state: Any, samples: Any, loop: Any, small: bool
) -> Iterable[Row]:  # fmt: skip
    one = [jax.tree.map(lambda x, i=i: x[i], samples) for i in range(len(samples.dt))]
    compiled, given = jax.jit(step), jax.device_put(params)
    first = candidate("live", compiled, given, state, one[0])
    candidates = [Candidate("live", partial(_walk, compiled, given, state, one), len(one), first.compile_s)]
    yield from _raced("live step", f"{name}, each step waited for", candidates, loop, len(one), small)


def _batched(
    name: str, step: Any, init: Any, params: Any, system: Any, loop: Any, small: bool
) -> Iterable[Row]:  # fmt: skip
    count, length = (2, 20) if small else (100, 200)
    given = jax.tree.map(np.float32, system.default_params)
    draw = jax.jit(jax.vmap(lambda key: system.simulate(given, key=key, steps=length, rate_hz=RATE_HZ)[0]))
    measurements = draw(jax.random.split(jax.random.key(1), count))

    def final(one: Any) -> Any:
        return run(step, params, init(params), one, history=last)[1].quaternion

    candidates = [candidate("batched", jax.jit(jax.vmap(final)), measurements, items=count * length)]
    items = 20 if small else 200
    yield from _raced("batched step", f"{name}, {count} robots at once", candidates, loop, items, small)


def _raced(
    metric: str, condition: str, candidates: list[Candidate], loop: Any, items: int, small: bool
) -> Iterable[Row]:  # fmt: skip
    ours = candidates[0].name
    if loop is not None:
        candidates = [*candidates, Candidate("loop", loop, items)]
    timings = race(candidates, repeats=2 if small else 10)
    peer = timings["loop"]._replace(name="NumPy, the same step by step") if loop is not None else None
    yield compare(metric, condition, timings[ours], peer)
    yield compile_row(condition, timings[ours])


def _samples(system: Any, count: int) -> Any:
    params = jax.tree.map(np.float32, system.default_params)
    draw = jax.jit(lambda key: system.simulate(params, key=key, steps=count, rate_hz=RATE_HZ)[0])
    return jax.tree.map(np.asarray, draw(jax.random.key(0)))


def _walk(step: Any, params: Any, state: Any, measurements: list[Any]) -> Any:
    for measurement in measurements:
        state, info = step(params, state, measurement)
        info.quaternion.block_until_ready()
    return state


def _arm_loop(samples: Any) -> Any:
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(models.path("human_arm")))
    return posture_loop.posture(model, [model.site(name.removeprefix("site:")).id for name in ARM], samples)
