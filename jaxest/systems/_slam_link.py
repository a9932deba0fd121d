"""Link by link through the body: match, update, bring the points into the map."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxest.filters.kalman.gaussian import product
from jaxest.mapping import insert, likeliest
from jaxest.systems import _slam_body as bodies
from jaxest.systems._slam_body import Body
from jaxest.systems._slam_register import REACH, Carry, Config, Seen, rebased, register, subset
from jaxest.systems._slam_rows import Points, Pose, point_slope, world
from jaxest.systems._slam_tilt import BENT, Mounts, Turned, aimed, astray, filed, learned, swung, unknowns, widened
from jaxest.types import Array

LASTS = 25.0  # scans: an error of the link's that never changes counts as new that seldom
REST = 1e-9  # m or rad, that a link goes in a step at least
STILL = 500  # scans of a link that stands still tell as much as two


def walk(
    body: Body, config: Config, params: Any, start: Carry, reading: Array, noise: Array, points: Points, scans: Array,
    index: Array, doubt: Array, usual: Array,
) -> tuple[Carry, Seen]:  # fmt: skip
    """Update with each scanned link's points in turn, parents first.

    Args:
        body: the robot.
        config: sizes.
        params: the system's.
        start: belief and map.
        reading: (n,) encoders.
        noise: (n,) variance of each joint's reading, rad2 or m2, new at each step.
        points: of all links, (L, Z, ...).
        scans: (L,) how many of a link's scans tell as much as one, as `repeats` says.
        index: () int32, steps seen: it tells which zones' turn it is.
        doubt: (6,) variances by which a free root may be farther from its prediction than it walks.
        usual: () share of the first link's points that fitted the map so far.

    Returns:
        Belief and map after the last link, and what each saw.
    """
    roots = body.size - len(body.joints)
    parts = max(1, points.valid.shape[1] // config.points)
    turn = jnp.mod(index, parts)

    def link(carry: Carry, row: tuple[Array, Points, Array, Array]) -> tuple[Carry, Seen]:
        at, mine, count, alike = row
        here = widened(_pose(carry.links, at), len(carry.covariance))
        slope = jnp.concatenate([here.turn, here.travel])[:, roots : body.size]
        mount = None if carry.mounts is None else jax.tree.map(lambda x: x[at], carry.mounts)
        aim = mine if mount is None else aimed(mine, mount.ring[None] + mount.turn)
        turned = None if mount is None else Turned(at, body.size + 3 * at, mount.covariance, alike)
        spare = product(slope * noise[None], slope.T) + jnp.diag(_stray(params, mine, count, alike, mount))
        leads = (at == 0) & (index > 0)
        carry, seen, found = register(
            body, config, params, carry, here, aim, spare, parts, turn, doubt, leads, usual, turned
        )
        if mount is not None:
            mount = learned(jax.tree.map(lambda x: x[at], carry.mounts), *found)
            aim = aimed(mine, mount.ring[None] + mount.turn)
            carry = carry._replace(mounts=jax.tree.map(lambda x, new: x.at[at].set(new), carry.mounts, mount))
        carry = carry._replace(links=bodies.links(body, carry.mean, reading, body.scanned))
        here = widened(_pose(carry.links, at), len(carry.covariance))
        return _learn(config, params, carry, here, aim, seen, roots, at)

    sensors = jnp.asarray(body.rays.sensors, start.covariance.dtype)
    return jax.lax.scan(link, start, (jnp.arange(len(body.scanned)), points, sensors, scans))


def repeats(params: Any, links: bodies.Links, before: bodies.Links, index: Array) -> Array:
    """Say how many scans of each link (L,) tell as much about where it is as one whose errors are its own.

    From one place the map is wrong by the same in each scan: a link that goes a fraction of `renewal` in a step needs
    as many steps until its errors are others. At the first step it has seen none before.

    Args:
        params: the system's.
        links: the scanned links.
        before: the same at the step before.
        index: () int32, steps seen.
    """
    turned = jnp.sum((links.rotation - before.rotation) ** 2, axis=(1, 2)) / 2
    moved = jnp.sum((links.position - before.position) ** 2, axis=1)
    # A link at rest, as a fixed root is, has gone no way: the root of 0 has no derivative, and all would be NaN.
    gone, swept = (jnp.sqrt(jnp.maximum(x, REST**2)) for x in (moved, turned))
    gone = gone + REACH * swept
    return jnp.where(index == 0, 1, 1 + 2 * params.renewal / (gone + params.renewal / STILL))


def _stray(params: Any, points: Points, sensors: Array, scans: Array, mount: Mounts | None) -> Array:
    """Return the variances (6,) of a link's rotation and position that one scan leaves, however many its points."""
    share = params.stray * params.noise**2
    count = jnp.maximum(jnp.sum(points.valid), 1)
    far = jnp.sum(jnp.where(points.valid, points.reach**2, 0)) / count
    # Sensors that point elsewhere do so in every scan.
    tilt = LASTS * params.tilt**2 / sensors if mount is None else astray(mount.covariance, sensors)
    bent = 0 if mount is None else BENT * params.tilt**2
    second = share**2 + bent**2
    rotation = scans * (params.stray_rotation**2 + second) + tilt
    position = scans * (params.stray_position**2 + second * far)
    return jnp.concatenate([jnp.full(3, rotation), jnp.full(3, position)])


def _pose(links: bodies.Links, at: Array) -> Pose:
    return Pose(*(jax.lax.dynamic_index_in_dim(x, at, keepdims=False) for x in links))


def _learn(
    config: Config, params: Any, carry: Carry, pose: Pose, points: Points, seen: Seen, roots: int, at: Array
) -> tuple[Carry, Seen]:
    """Bring a link's points into the map, if the link is known well enough."""
    x = world(pose, points.local)
    slope = point_slope(pose, x)
    if carry.mounts is not None:
        slope = swung(slope, pose.rotation, points, roots + len(carry.mean.bias) + 3 * at)
    slope = slope[:, :, roots:]
    x = x - product(slope, unknowns(carry.mean.bias, carry.mounts) - carry.reference)
    where = product(pose.travel, product(carry.covariance, pose.travel.T))
    kept = jnp.trace(where) < params.admit**2
    ray, scatter = product(points.ray, pose.rotation.T), params.noise * points.reach
    voxel = None if config.central else likeliest(config.layout, carry.chart, x, ray, scatter)
    extra = slope.reshape(len(x), -1)
    if carry.mounts is not None:
        extra = jnp.concatenate([extra, filed(points, carry.mounts, at)], axis=1)
    chart = insert(
        config.layout,
        carry.chart,
        x,
        points.valid & kept,
        extra,
        filed=voxel,
        noise=scatter[:, None] * ray,
        central=config.central,
    )
    return carry._replace(chart=chart), seen._replace(kept=kept)


__all__ = ["Carry", "Config", "Seen", "rebased", "repeats", "subset", "walk"]
