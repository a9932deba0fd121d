"""Link by link through the body: match, update, bring the points into the map."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters.kalman import information_gain
from jaxest.filters.kalman.factors import reanchor
from jaxest.filters.kalman.gaussian import product, sandwich, symmetric
from jaxest.mapping import Layout, VoxelMap, carried, insert, shift
from jaxest.systems import _slam_body as bodies
from jaxest.systems._slam_body import Body, Mean
from jaxest.systems._slam_rows import Points, Pose, Sums, match, moved, point_slope, sums, world
from jaxest.types import Array

STEP = 5e-3  # m or rad: planes are looked for again when a link has moved by more
BEND = 1e-3  # rad or m: the map is bent at once when a bias has changed by more, and at the end of the step anyway
REACH = 1.0  # m, at which a rotation counts as a motion


class Config(NamedTuple):
    """Sizes and choices, static."""

    layout: Layout
    points: int
    """Zones of a link that take part in an update; others follow at the next steps."""
    rounds: int
    """Searches for planes in an update at most."""
    least: int
    """Inliers without which a link keeps its prediction."""
    central: bool
    """Whether voxels keep the point nearest to their centre."""


class Carry(NamedTuple):
    """What goes from link to link."""

    mean: Mean
    covariance: Array
    chart: VoxelMap
    reference: Array
    """(n,) biases at which the map's points stand."""


class Seen(NamedTuple):
    """What a link made of its points; leaves get a leading axis of L."""

    sums: Sums
    explained: Array
    """() chi-square of the rows that count, after the update."""
    rounds: Array
    """() int32, searches for planes."""
    settled: Array
    """() bool."""
    kept: Array
    """() bool, points went into the map."""


def walk(
    body: Body, config: Config, params: Any, start: Carry, reading: Array, noise: Array, points: Points, index: Array
) -> tuple[Carry, Seen]:
    """Update with each scanned link's points in turn, parents first.

    Args:
        body: the robot.
        config: sizes.
        params: the system's.
        start: belief and map.
        reading: (n,) encoders.
        noise: (n,) variance of each joint's reading, rad2 or m2, new at each step.
        points: of all links, (L, Z, ...).
        index: () int32, steps seen: it tells which zones' turn it is.

    Returns:
        Belief and map after the last link, and what each saw.
    """
    roots = body.size - len(body.joints)
    parts = max(1, points.valid.shape[1] // config.points)
    turn = jnp.mod(index, parts)

    def link(carry: Carry, row: tuple[Array, Points]) -> tuple[Carry, Seen]:
        at, mine = row
        here = _pose(bodies.links(body, carry.mean, reading, body.scanned), at)
        some = jax.tree.map(lambda x: subset(x, parts, turn), mine)
        slope = jnp.concatenate([here.turn, here.travel])[:, roots:]
        own = jnp.concatenate([jnp.full(3, params.jitter_rotation**2), jnp.full(3, params.jitter_position**2)])
        spare = product(slope * noise[None], slope.T) + jnp.diag(own.astype(slope.dtype))
        carry, seen = _register(body, config, params, carry, here, some, spare)
        here = _pose(bodies.links(body, carry.mean, reading, body.scanned), at)
        return _learn(config, params, carry, here, mine, seen, roots)

    return jax.lax.scan(link, start, (jnp.arange(len(body.scanned)), points))


def subset(x: Array, parts: int, turn: Array) -> Array:
    """Take each `parts`-th zone, beginning with `turn`."""
    whole = x.shape[0] - x.shape[0] % parts
    grouped = x[:whole].reshape(whole // parts, parts, *x.shape[1:])
    return jax.lax.dynamic_index_in_dim(grouped, turn, axis=1, keepdims=False)


def _pose(links: bodies.Links, at: Array) -> Pose:
    return Pose(*(jax.lax.dynamic_index_in_dim(x, at, keepdims=False) for x in links))


def _register(
    body: Body, config: Config, params: Any, carry: Carry, pose: Pose, points: Points, spare: Array
) -> tuple[Carry, Seen]:
    """Iterate plane search and update until the link stays where it is."""
    mean, covariance, chart, reference = carry
    roots = body.size - len(body.joints)

    def once(v: Array) -> tuple[Array, Array, Sums, Array]:
        offset = mean.bias + v[roots:] - reference
        rows = match(config.layout, chart, params, moved(pose, v), points, offset, roots)
        found = sums(rows, points, spare)
        enough = found.inliers >= config.least
        information = jnp.where(enough, found.information, 0)
        pull = jnp.where(enough, found.pull, 0)
        gained = information_gain(covariance, information, pull + product(information, v))
        step = gained.correction - v
        explained = found.square + jnp.sum(step * (product(information, step) - 2 * pull))
        return gained.correction, gained.covariance, found, explained

    def size(v: Array) -> Array:
        turned, travelled = product(pose.turn, v), product(pose.travel, v)
        return jnp.max(jnp.abs(travelled)) + REACH * jnp.max(jnp.abs(turned))

    def again(state: Any, _: None) -> tuple[Any, None]:
        result, last, count = state
        far = size(jax.lax.stop_gradient(result[0] - last)) > STEP
        new = jax.lax.cond(far, lambda: once(result[0]), lambda: result)
        return (new, jnp.where(far, result[0], last), count + far.astype(jnp.int32)), None

    zero = jnp.zeros(body.size, covariance.dtype)
    first = (once(zero), zero, jnp.int32(1))
    (result, last, count), _ = jax.lax.scan(again, first, None, length=config.rounds - 1)
    v, after, found, explained = result
    if body.root is not None:
        turn = reanchor(bodies.manifold(body), mean, v, bodies.retract(body, mean, v))
        after = symmetric(sandwich(turn, after))
    settled = size(v - last) <= 4 * STEP
    done = rebased(Carry(bodies.retract(body, mean, v), after, chart, reference))
    return done, Seen(found, explained, count, settled, jnp.bool_(True))


def _learn(
    config: Config, params: Any, carry: Carry, pose: Pose, points: Points, seen: Seen, roots: int
) -> tuple[Carry, Seen]:
    """Bring a link's points into the map, if the link is known well enough."""
    x = world(pose, points.local)
    slope = point_slope(pose, x)[:, :, roots:]
    x = x - product(slope, carry.mean.bias - carry.reference)
    where = product(pose.travel, product(carry.covariance, pose.travel.T))
    kept = jnp.trace(where) < params.admit**2
    chart = insert(
        config.layout, carry.chart, x, points.valid & kept, slope.reshape(len(x), -1), central=config.central
    )
    return carry._replace(chart=chart), seen._replace(kept=kept)


def rebased(carry: Carry, least: float = BEND) -> Carry:
    """Move the map's points to where the biases now put them, if those changed by `least` rad or m or more."""

    def bend() -> tuple[VoxelMap, Array]:
        slope = carried(carry.chart).reshape(carry.chart.point.shape[0], 3, -1)
        return shift(carry.chart, product(slope, carry.mean.bias - carry.reference)), carry.mean.bias

    far = jnp.max(jnp.abs(carry.mean.bias - carry.reference), initial=0) >= least
    chart, reference = jax.lax.cond(far, bend, lambda: (carry.chart, carry.reference))
    return carry._replace(chart=chart, reference=reference)


__all__ = ["Carry", "Config", "Seen", "rebased", "subset", "walk"]
