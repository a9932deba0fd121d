"""A robot that swings its joints in a room of boxes, all in JAX: for trying the system out, and for its tests."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.manifolds import quaternion
from jaxest.simulate.boxes import Boxes, distance
from jaxest.systems import _slam_body as bodies
from jaxest.systems._slam_body import Body, Mean
from jaxest.types import Array, ArrayLike, Reading


class Truth(NamedTuple):
    """What the measurements come from, with a leading time axis of T but for the bias."""

    joints: Array
    """(T, n) rad or m."""
    position: Array
    """(T, B, 3) m, of every body."""
    rotation: Array
    """(T, B, 3, 3), body to world."""
    bias: Array
    """(n,) rad or m."""


ROOM = Boxes((-1.5, -2.0, -1.2), (3.0, 1.7, 1.4), ((1.0, -1.5, -0.8), (0.6, 1.4, 0.3)), ((0.4,) * 3, (0.3, 0.2, 0.25)))
"""Walls about a robot that starts at the origin, and two boxes."""


def simulate(
    body: Body,
    measurement: Any,
    params: Any,
    *,
    key: Array,
    steps: int = 20,
    dt: float = 0.1,
    room: Boxes = ROOM,
    bias: ArrayLike = 0.05,
    amplitude: float = 0.3,
    hertz: float = 0.2,
    missing: float = 0.0,
    odometry: bool = True,
    roll: float = 0.0,
) -> tuple[Any, Truth]:
    """Draw readings of a robot that stands still or drifts slowly while its joints swing.

    Args:
        body: the robot.
        measurement: `Fixed` or `Free`.
        params: the system's; their noise is drawn.
        key: random key.
        steps: T.
        dt: s.
        room: the room; nothing keeps the robot from reaching through its walls.
        bias: () or (n,) rad or m, of the encoders.
        amplitude: rad or m, of each joint's sine wave.
        hertz: of the fastest one.
        missing: share of zones and of encoder readings that are not there.
        odometry: whether a free root has some.
        roll: rad/s, about its x, at which a free root begins to turn at half time.

    Returns:
        Measurements with a leading time axis, and the truth.
    """
    dtype = jnp.result_type(*jax.tree.leaves(params))
    n = len(body.joints)
    keys = jax.random.split(key, 8)
    rate = hertz * jax.random.uniform(keys[0], (n,), dtype, 0.4, 1.0)
    phase = 2 * jnp.pi * jax.random.uniform(keys[1], (n,), dtype)
    at = np.array([body.robot.topology.joint_q[j] for j in body.joints], int)
    start = jnp.asarray(body.robot.home[at], dtype)
    drift = 0.02 * jax.random.normal(keys[2], (6,), dtype)
    rays = [jnp.asarray(x, dtype).reshape(-1, 3) for x in (body.rays.origin, body.rays.direction)]
    owner = np.repeat(np.arange(len(body.scanned)), body.rays.index.shape[1])
    zone = np.argsort(body.rays.index.reshape(-1), kind="stable")[: body.readings]

    def stand(t: Array) -> Mean:
        home = bodies.home(body, dtype)
        if body.root is None:
            return home
        rolled = roll * jnp.maximum(t - dt * (steps // 2), 0)
        turned = quaternion.retract(home.quaternion, t * drift[3:] + rolled * jnp.array([1, 0, 0], dtype))
        return home._replace(position=home.position + t * drift[:3], quaternion=turned)

    def look(t: Array) -> Any:
        q = start + amplitude * jnp.sin(2 * jnp.pi * rate * t + phase)
        links = bodies.links(body, stand(t), q, body.links)
        turn, place = links.rotation[np.array(body.scanned)][owner], links.position[np.array(body.scanned)][owner]
        origin = place + jnp.einsum("nij,nj->ni", turn, rays[0])
        reach = distance(room, origin, jnp.einsum("nij,nj->ni", turn, rays[1]))[zone]
        return q, links, reach

    time = dt * jnp.arange(steps, dtype=dtype)
    q, links, reach = jax.lax.map(look, time)
    reach = reach * (1 + params.noise * jax.random.normal(keys[3], reach.shape, dtype))
    bias = jnp.broadcast_to(jnp.asarray(bias, dtype), (n,))
    reading = q + bias[None] + params.encoder * jax.random.normal(keys[4], q.shape, dtype)
    fields: dict[str, Any] = {
        "ranges": Reading(reach, jax.random.uniform(keys[5], reach.shape) >= missing),
        "joints": Reading(reading, jax.random.uniform(keys[6], q.shape) >= missing),
        "dt": jnp.full(steps, dt, dtype),
    }
    if body.root is not None:
        fields |= _odometry(params, jax.vmap(stand)(time), jax.vmap(stand)(time - dt), keys[7], odometry)
    return measurement(**fields), Truth(q, links.position, links.rotation, bias)


def _odometry(params: Any, now: Mean, before: Mean, key: Array, there: bool) -> dict[str, Reading]:
    """How the root moved, in its own axes before; nothing at the first step, where it starts."""
    white = jax.random.normal(key, (2, *now.position.shape), now.position.dtype)
    turned = jax.vmap(quaternion.local)(before.quaternion, now.quaternion)
    away = jax.vmap(lambda q, v: quaternion.rotate(quaternion.inverse(q), v))(
        before.quaternion, now.position - before.position
    )
    steps = now.position.shape[0]
    first = (jnp.arange(steps) > 0).astype(away.dtype)[:, None]
    valid = jnp.full(steps, there)
    travel, turn = first * away + params.travel * white[0], first * turned + params.turn * white[1]
    return {"travel": Reading(travel, valid), "turn": Reading(turn, valid)}


__all__ = ["ROOM", "Truth", "simulate"]
