"""Data drawn from the deflection filter's own model."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters import particle
from jaxest.systems import _deflection_body as bodies
from jaxest.systems import _deflection_walk as walks
from jaxest.systems._deflection_body import Body
from jaxest.types import Array, PyTree, Reading


def simulate(
    body: Body,
    record: Any,
    transition: particle.Transition,
    sag: bool,
    params: PyTree,
    *,
    key: Array,
    steps: int = 100,
    rate_hz: float = 50.0,
    missing: float = 0.1,
) -> tuple[Any, PyTree]:
    """Draw a random walk from the prior and what the sensors read, from the very densities that the filter assumes.

    Args:
        body: the robot and what looks at it.
        record: class of the measurements.
        transition: how joints wander.
        sag: must be False: readings that give under gravity have no such density.
        params: the filter's parameters; their dtype is that of the data.
        key: key of the whole draw.
        steps: number of measurements T, static.
        rate_hz: measurements per second.
        missing: share of the readings that are not there, of each sensor on its own.

    Returns:
        Measurements with leading axis T, and the states, leaves (T, ...). Joints that are not estimated are read at
        home.

    Raises:
        ValueError: there are no steps, or the system sags (`jaxest.simulate.deflection` bends a robot).
    """
    if steps < 1:
        raise ValueError(f"steps: got {steps}, expected at least 1")
    if sag:
        raise ValueError("sag: simulate a robot that bends with jaxest.simulate.deflection")
    dtype = jnp.result_type(*jax.tree.leaves(params))
    begin, walk, read, there = jax.random.split(key, 4)
    start = jax.tree.map(lambda x: x[0], walks.first(body.space, params, begin, 1))
    noise = transition.draw(params, None, walk, steps)

    def move(x: PyTree, v: Array) -> tuple[PyTree, PyTree]:
        x = body.space.manifold.retract(x, v)
        return x, x

    _, states = jax.lax.scan(move, start, noise)
    rest = jnp.asarray(body.robot.home[np.array([body.robot.topology.joint_q[j] for j in body.others], int)], dtype)
    blank = record(**dict.fromkeys(record._fields))
    if body.others:
        blank = blank._replace(others=Reading(rest, jnp.asarray(True)))

    def one(x: PyTree, key: Array) -> dict[str, Array]:
        seen = zip(body.looks, bodies.views(body, x, blank), jax.random.split(key, len(body.looks)), strict=True)
        return {look.name: look.kind.sample(k, getattr(params.sensors, look.name), view) for look, view, k in seen}

    values = jax.vmap(one)(states, jax.random.split(read, steps))
    valid = jax.random.uniform(there, (steps, len(body.looks)), dtype) >= missing
    readings = {look.name: Reading(values[look.name], valid[:, i]) for i, look in enumerate(body.looks)}
    if body.others:
        readings["others"] = Reading(jnp.broadcast_to(rest[None], (steps, *rest.shape)), jnp.ones(steps, bool))
    return record(**readings, dt=jnp.full(steps, 1 / rate_hz, dtype)), states
