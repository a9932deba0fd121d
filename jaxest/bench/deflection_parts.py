"""Where the time of the bootstrap filter's step goes, and how far it is above the floor of its arithmetic and bytes."""

from collections.abc import Iterable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.bench import work
from jaxest.bench.harness import Progress, Timing, candidate, compare, race
from jaxest.filters.particle.guided import picked
from jaxest.filters.particle.summary import weighted
from jaxest.filters.resampling import stratified
from jaxest.io.report import Row
from jaxest.sensors import Sensor
from jaxest.systems import _deflection_body as bodies
from jaxest.systems import deflection


def rows(
    robot: Any, sensors: tuple[Sensor, ...], problem: tuple[Any, Any, Any], count: int, progress: Progress, small: bool
) -> Iterable[Row]:
    """Time the parts of the step as programs of their own, in turn with the whole step.

    Args:
        robot: the packaged arm.
        sensors: the benchmark's.
        problem: system, parameters, measurements of two steps.
        count: number of particles.
        progress: hears what is being measured.
        small: few rounds.

    Yields:
        The step beside its floor (the longer of its arithmetic at the speed of a matrix product and its arguments and
        results at that of a copy, both measured just before), an empty program, and the parts.
    """
    progress("deflection: parts of the step")
    system, params, measurements = problem
    key, body = jax.random.key(0), bodies.body(robot, sensors, None, ())
    first, second = (jax.tree.map(lambda x, i=i: x[i], measurements) for i in range(2))

    def step(params: Any, state: Any, measurement: Any) -> Any:
        return system.step(params, state, measurement, key=key)

    state, _ = jax.jit(step)(params, system.init(params, key=key), first)
    walk, x, log_weights = deflection.von_mises(body.space), state.particles, state.log_weights

    def chosen(log_weights: Any, x: Any) -> Any:
        return jax.tree.map(partial(picked, stratified(key, log_weights).ancestors), x)

    def weighed(params: Any, x: Any, measurement: Any) -> Any:
        return jax.vmap(lambda x: bodies.log_likelihood(body, params, x, measurement))(x)

    def averaged(x: Any, log_weights: Any) -> Any:
        return weighted(body.space.manifold, x, jnp.exp(log_weights))

    candidates = [
        candidate("the step", jax.jit(step), params, state, second),
        candidate("an empty program", jax.jit(lambda x: x[:1] + 1), log_weights),
        candidate("draws", jax.jit(lambda p, m: walk.draw(p, m, key, count)), params, second),
        candidate("resampling", jax.jit(chosen), log_weights, x),
        candidate("kinematics and likelihoods", jax.jit(weighed), params, x, second),
        candidate("mean and covariance", jax.jit(averaged), x, log_weights),
    ]
    peak = work.peak(*((128, 1) if small else ()))
    found = race(candidates, repeats=2 if small else 15)
    done = work.count(step, params, state, second)
    whole = found["the step"]
    floor = Timing("floor", np.full(len(whole.seconds), peak.floor(done)), None)
    condition = f"bootstrap, {count} particles, {done.operations:.2g} operations and {done.bytes:.2g} bytes"
    yield compare("step above its floor", condition, whole, floor)
    for one in candidates[1:]:
        yield compare("part of the step", one.name, found[one.name], whole)


__all__ = ["rows"]
