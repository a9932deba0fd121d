"""How well the filters of the `deflection` benchmark know the posterior mean: speed is compared at equal accuracy."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.bench import deflection_peers as peers
from jaxest.io.report import Row
from jaxest.metrics import circular_error
from jaxest.sensors import Sensor, measurement_type
from jaxest.systems import deflection
from jaxest.types import Reading

SETTLE, STEPS = 10, 40  # steps from the wide prior that do not count, and that do
REFERENCE = 100_000

Filter = Callable[[], Any]
"""A step on the measurement of `still`; returns the mean (4,) rad."""


def still(sensors: tuple[Sensor, ...]) -> Any:
    """Return the measurement that every filter here sees at every step: the numbers of `deflection_peers`."""
    there, level = jnp.asarray(True), jnp.asarray([1.0, 0.0, 0.0, 0.0], jnp.float32)
    values = (jnp.asarray(peers.READ, jnp.float32), level, level, jnp.asarray(peers.TIP, jnp.float32))
    return measurement_type(sensors)(*(Reading(value, there) for value in values), dt=jnp.float32(0.1))


def ours(system: Any, measurement: Any, seed: int = 0) -> Callable[[], Any]:
    """Return a filter of a system of ours; its calls return infos."""
    params = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), system.default_params)
    key, step = jax.random.key(seed), jax.jit(system.step)
    held = {"state": system.init(params, key=key)}

    def advance() -> Any:
        held["state"], info = step(params, held["state"], measurement, key=key)
        return info

    return advance


def rows(
    robot: Any, sensors: tuple[Sensor, ...], filters: Mapping[str, Filter], count: int, small: bool
) -> Iterable[Row]:
    """Measure the error of each filter's mean.

    Args:
        robot: the packaged arm.
        sensors: the benchmark's.
        filters: by name, each with `count` particles.
        count: number of particles.
        small: a small reference and few steps.

    Yields:
        A row a filter: root mean square of the error over joints and steps, in deviations of the posterior, against a
        guided filter of 100,000 particles.
    """
    number, settle, steps = (1000, 2, 3) if small else (REFERENCE, SETTLE, STEPS)
    measurement = still(sensors)
    exact = ours(deflection.build(robot, sensors, particles=number, proposal=deflection.guided), measurement)
    infos = [exact() for _ in range(settle + 5)][settle:]
    centre = np.mean([np.asarray(info.mean, float) for info in infos], axis=0)
    deviation = np.sqrt(np.mean([np.diagonal(info.covariance) for info in infos], axis=0))
    blind = ours(deflection.build(robot, sensors, particles=count), measurement, seed=1)
    for name, step in {"jaxest, bootstrap": lambda: blind().mean, **filters}.items():
        found = np.array([np.asarray(step(), float) for _ in range(settle + steps)])[settle:]
        away = circular_error(found, centre) / deviation
        spread = float(np.std(np.sqrt(np.mean(away**2, axis=1))) / np.sqrt(steps))
        condition = f"{name}, {count} particles, against {number} guided ones"
        yield Row("error of the posterior mean", condition, float(np.sqrt(np.mean(away**2))), "sd", spread, steps)


__all__ = ["ours", "rows", "still"]
